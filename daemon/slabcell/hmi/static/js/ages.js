// @ts-check
// How old is what is shown?  Counts on every <time data-age-s>, from the moment it came into the page.

/** @type {WeakMap<HTMLElement, {shown: string, came_ms: number}>} */
const came = new WeakMap();

/**
 * Return a duration as the server writes it: two units at most.
 * @param {number} seconds
 * @returns {string}
 */
export function duration(seconds) {
  const german = document.documentElement.lang === "de";
  const whole = Math.floor(seconds);
  const two = (/** @type {number} */ value) => String(value).padStart(2, "0");
  const space = "\u00a0";
  if (seconds < 10) return `${seconds.toFixed(1).replace(".", german ? "," : ".")}${space}s`;
  if (whole < 60) return `${whole}${space}s`;
  if (whole < 3600) return `${Math.floor(whole / 60)}${space}min ${two(whole % 60)}${space}s`;
  if (whole < 86400) return `${Math.floor(whole / 3600)}${space}h ${two(Math.floor((whole % 3600) / 60))}${space}min`;
  return `${Math.floor(whole / 86400)}${space}${german ? "Tg." : "d"} ${Math.floor((whole % 86400) / 3600)}${space}h`;
}

function tick() {
  const now_ms = performance.now();
  for (const element of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("time[data-age-s]"))) {
    const shown = element.dataset.ageS ?? "0";
    let known = came.get(element);
    if (!known || known.shown !== shown) {
      known = { shown, came_ms: now_ms };
      came.set(element, known);
    }
    const text = duration(Number(shown) + (now_ms - known.came_ms) / 1000);
    if (element.textContent !== text) element.textContent = text;
  }
}

/** Begin to count. */
export function startAges() {
  setInterval(tick, 1000);
}
