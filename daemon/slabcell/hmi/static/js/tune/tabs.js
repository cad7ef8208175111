// @ts-check
// Which panel is shown, and is any?  Tabs by mouse and by arrow keys, as WAI-ARIA has them; all of them fold away.

const SMALL = window.matchMedia("(max-height: 700px)");

/**
 * Let the tabs of a list choose their panels, and a button fold these away so that the picture is larger.
 * On a small screen they are folded until a tab is chosen.
 * @param {HTMLElement} list
 * @param {HTMLElement} fold
 * @param {HTMLElement} room has the class "folded" while no panel is shown
 */
export function startTabs(list, fold, room) {
  const tabs = /** @type {HTMLElement[]} */ ([...list.querySelectorAll('[role="tab"]')]);
  const unfold = (/** @type {boolean} */ open) => {
    room.classList.toggle("folded", !open);
    fold.setAttribute("aria-expanded", String(open));
  };
  const choose = (/** @type {HTMLElement} */ chosen) => {
    for (const tab of tabs) {
      const on = tab === chosen;
      tab.setAttribute("aria-selected", String(on));
      tab.tabIndex = on ? 0 : -1;
      const panel = document.getElementById(tab.getAttribute("aria-controls") ?? "");
      if (panel) panel.hidden = !on;
    }
    unfold(true);
  };
  for (const [index, tab] of tabs.entries()) {
    tab.addEventListener("click", () => choose(tab));
    tab.addEventListener("keydown", ({ key }) => {
      const to = { ArrowLeft: index - 1, ArrowRight: index + 1, Home: 0, End: tabs.length - 1 }[key];
      if (to === undefined) return;
      const next = tabs[(to + tabs.length) % tabs.length];
      next.focus();
      choose(next);
    });
  }
  fold.addEventListener("click", () => unfold(fold.getAttribute("aria-expanded") !== "true"));
  SMALL.addEventListener("change", () => unfold(!SMALL.matches));
  unfold(!SMALL.matches);
}
