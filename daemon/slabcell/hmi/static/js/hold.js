// @ts-check
// Is it meant?  A form marked data-hold is sent only when its button was held for a second, by pointer or by key.

const HOLD_MS = 1000;

/** Begin to listen. */
export function startHolding() {
  /** @type {number | undefined} */
  let timer;
  /** @type {HTMLButtonElement | null} */
  let held = null;

  /** @param {Event} event */
  const button = (event) => {
    const target = event.target instanceof Element ? event.target.closest("button[data-hold]") : null;
    return target instanceof HTMLButtonElement && !target.disabled ? target : null;
  };
  const release = () => {
    clearTimeout(timer);
    held?.classList.remove("holding");
    held = null;
  };
  /** @param {Event} event */
  const press = (event) => {
    const found = button(event);
    if (!found || held) return;
    held = found;
    found.classList.add("holding");
    timer = window.setTimeout(() => {
      const form = found.form;
      release();
      form?.requestSubmit();
    }, HOLD_MS);
  };
  document.addEventListener("pointerdown", press);
  for (const end of ["pointerup", "pointercancel", "blur"]) document.addEventListener(end, release, true);
  document.addEventListener("keydown", (event) => {
    if ((event.key === "Enter" || event.key === " ") && button(event)) {
      event.preventDefault();
      if (!event.repeat) press(event);
    }
  });
  document.addEventListener("keyup", release);
  // A mere click does nothing: the button is of type "button".
}
