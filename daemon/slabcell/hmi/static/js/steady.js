// @ts-check
// Does a part of the page stay as it is while somebody uses it?  What has not changed is not put in anew, and nothing is
// taken away under a finger: a click on a button that is replaced between press and release would be lost.

/** Begin to listen. */
export function startSteady() {
  /** @type {WeakMap<Element, string>} What was put into an element last. */
  const shown = new WeakMap();
  /** @type {Node | null} */
  let pressed = null;
  let missed = false;

  document.addEventListener("pointerdown", (event) => {
    pressed = event.target instanceof Node ? event.target : null;
  });
  const released = () => {
    // The click comes after the release.
    setTimeout(() => {
      pressed = null;
      if (missed) document.body.dispatchEvent(new CustomEvent("slab:reset"));
      missed = false;
    });
  };
  document.addEventListener("pointerup", released);
  document.addEventListener("pointercancel", released);

  document.body.addEventListener("htmx:beforeSwap", (event) => {
    const detail = /** @type {CustomEvent} */ (event).detail;
    if (!detail.shouldSwap || !(detail.target instanceof Element)) return;
    const text = detail.xhr.responseText;
    if (text !== "" && shown.get(detail.target) === text) {
      detail.shouldSwap = false;
    } else if (pressed !== null && detail.target.contains(pressed)) {
      detail.shouldSwap = false;
      missed = true;
    } else {
      shown.set(detail.target, text);
    }
  });
}
