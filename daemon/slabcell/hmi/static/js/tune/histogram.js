// @ts-check
// How many pixels have which grey, and where do the parameters cut?  The handles are sliders: by mouse, finger and keys.
import { svg } from "../picture.js";
import { at, element, number, word } from "./words.js";

/** @typedef {import("./draft.js").Draft} Draft */
/** @typedef {{counts: number[], level: number | null, light: boolean, low: number, high: number, grey_per_level: number}} Histogram */
/** @typedef {{name: string, level: (of: Histogram) => number, value: (of: Histogram, level: number) => number, key: string, unit: string}} Handle */

const LEVELS = 256;
/** Where the label of a handle stands, so that none covers another. @type {Record<string, {row: number, side: string}>} */
const LABELS = {
  threshold: { row: 0, side: "free" },
  low: { row: 0, side: "right" },
  high: { row: 0, side: "left" },
  level: { row: 1, side: "free" },
  soft_low: { row: 2, side: "left" },
  soft_high: { row: 2, side: "right" },
};

/**
 * Show the histogram of each run, with the handles that the method has.
 * @param {Draft} draft
 * @param {import("./view.js").View} view
 */
export function startHistogram(draft, view) {
  const room = at("histogram");
  /** @type {Histogram | null} */
  let found = null;
  const plot = svg("svg", { viewBox: `0 0 ${LEVELS} 100`, preserveAspectRatio: "none", role: "img", "aria-label": word("pixels") });
  const bars = svg("path", { class: "bars" });
  const band = svg("rect", { class: "band", y: 0, height: 100 });
  const cut = svg("line", { class: "cut", y1: 0, y2: 100 });
  plot.append(band, bars, cut);
  const field = element("div", { class: "plot" });
  const handles = element("div", { class: "handles" });
  field.append(plot, handles);
  const said = element("span", { class: "said" });
  const take = element("button", { type: "button" }, word("take_level"));
  room.append(field, element("div", { class: "row" }, said, take));
  take.addEventListener("click", () => {
    if (!found || found.level === null) return;
    draft.set("segmentation.threshold", Math.round((found.level - (found.grey_per_level === 1 ? 0.5 : 0)) * found.grey_per_level));
    draft.set("segmentation.method", "fixed");
  });

  function draw() {
    if (!found) return;
    const most = Math.sqrt(Math.max(...found.counts)) || 1;
    const tops = found.counts.map((count, grey) => `${grey} ${(100 - (96 * Math.sqrt(count)) / most).toFixed(1)}h1`);
    bars.setAttribute("d", `M0 100L${tops.join("L")}L${LEVELS} 100Z`);
    const dynamic = draft.get("segmentation.method").startsWith("dynamic");
    const { low, high } = range(found, draft);
    band.setAttribute("x", String(low));
    band.setAttribute("width", String(dynamic ? Math.max(high - low, 0) : 0));
    const level = cutOf(found, draft);
    cut.setAttribute("visibility", level === null ? "hidden" : "visible");
    for (const end of ["x1", "x2"]) cut.setAttribute(end, String(level ?? 0));
    said.textContent = level === null ? word("no_level") : word("level_found", { level: number(level, 1) });
    take.hidden = level === null || draft.get("segmentation.method") === "fixed";
    place();
  }

  function place() {
    const wanted = handlesOf(draft);
    while (handles.childElementCount > wanted.length) handles.lastElementChild?.remove();
    while (handles.childElementCount < wanted.length) handles.append(slider(handles.childElementCount));
    wanted.forEach((handle, index) => {
      if (!found) return;
      const made = /** @type {HTMLElement} */ (handles.children[index]);
      const level = Math.min(Math.max(handle.level(found), 0), LEVELS);
      made.style.left = `${(100 * level) / LEVELS}%`;
      made.dataset.key = handle.key;
      made.dataset.handle = handle.name;
      made.setAttribute("aria-label", word(`handle.${handle.name}`));
      made.setAttribute("aria-valuenow", level.toFixed(1));
      made.setAttribute("aria-valuetext", `${word("grey", { level: number(level, 0) })}, ${number(draft.get(handle.key), undefined, handle.unit)}`);
      const label = /** @type {HTMLElement} */ (made.firstElementChild);
      label.textContent = `${word(`handle.${handle.name}`)} ${number(draft.get(handle.key), undefined, handle.unit)}`;
      const { row, side } = LABELS[handle.name];
      label.classList.toggle("left", side === "left" || (side === "free" && level > LEVELS / 2));
      label.style.top = `${1.2 * row}rem`;
    });
  }

  /** @param {number} index */
  function slider(index) {
    const made = element("div", { class: "handle", role: "slider", tabindex: "0", "aria-valuemin": "0", "aria-valuemax": String(LEVELS - 1) }, element("span", {}));
    const to = (/** @type {number} */ level) => {
      const handle = handlesOf(draft)[index];
      if (!found || !handle) return;
      draft.set(handle.key, handle.value(found, Math.min(Math.max(level, 0), LEVELS - 1)));
    };
    let held = false;
    made.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      made.focus();
      made.setPointerCapture(event.pointerId);
      held = true;
    });
    made.addEventListener("pointermove", (event) => {
      const box = field.getBoundingClientRect();
      if (held) to((LEVELS * (event.clientX - box.left)) / box.width);
    });
    for (const end of ["pointerup", "pointercancel"]) made.addEventListener(end, () => (held = false));
    made.addEventListener("keydown", (event) => {
      const handle = handlesOf(draft)[index];
      if (!found || !handle) return;
      /** @type {Record<string, number>} */
      const steps = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10, Home: -LEVELS, End: LEVELS };
      const step = steps[event.key];
      if (step === undefined) return;
      event.preventDefault();
      // Where no pixel has the next grey the parameter stays what it is: go on to where it changes.
      const [before, level] = [draft.get(handle.key), handle.level(found)];
      for (let by = step; Math.abs(by) <= LEVELS && draft.get(handle.key) === before; by += Math.sign(step)) to(level + by);
    });
    return made;
  }

  draft.addEventListener("change", (event) => {
    if (/** @type {CustomEvent} */ (event).detail.key.startsWith("segmentation.")) draw();
  });
  draft.addEventListener("load", draw);
  return {
    /** Take what a run left. */
    take: async () => {
      found = /** @type {Histogram | null} */ (await view.file("histogram.json"));
      room.classList.toggle("none", !found);
      draw();
    },
  };
}

/**
 * Return the share of pixels that are darker than a grey, in percent.
 * @param {Histogram} found
 * @param {number} level
 */
function below(found, level) {
  const whole = found.counts.reduce((sum, count) => sum + count, 0) || 1;
  return (100 * found.counts.slice(0, Math.round(level)).reduce((sum, count) => sum + count, 0)) / whole;
}

/**
 * Return the range between the tails, as `slabcell.vision.thresholds.dynamic_range` has it.
 * @param {Histogram} found
 * @param {Draft} draft
 */
function range(found, draft) {
  const whole = found.counts.reduce((sum, count) => sum + count, 0) || 1;
  const [low_share, high_share] = [draft.get("segmentation.low_tail_percent") / 100, 1 - draft.get("segmentation.high_tail_percent") / 100];
  let [sum, low, high] = [0, 0, 0];
  for (const count of found.counts) {
    sum += count;
    if (sum / whole < low_share) low += 1;
    if (sum / whole < high_share) high += 1;
  }
  return { low, high: Math.max(high, low + 1) };
}

/**
 * Return where the draft cuts: as its parameters say, or as the last run found it.
 * @param {Histogram} found
 * @param {Draft} draft
 */
function cutOf(found, draft) {
  const method = draft.get("segmentation.method");
  const threshold = draft.get("segmentation.threshold");
  if (method === "fixed") return threshold === null ? null : threshold / found.grey_per_level + (found.grey_per_level === 1 ? 0.5 : 0);
  if (method.startsWith("dynamic")) return levelOf(found, draft);
  return found.level;
}

/**
 * @param {Histogram} found
 * @param {Draft} draft
 */
function levelOf(found, draft) {
  const { low, high } = range(found, draft);
  return low + ((high - low) * draft.get("segmentation.level_percent")) / 100;
}

/**
 * Return the handles that the method of a draft has.
 * @param {Draft} draft
 * @returns {Handle[]}
 */
function handlesOf(draft) {
  const method = draft.get("segmentation.method");
  const tenth = (/** @type {number} */ value) => Math.round(Math.min(Math.max(value, 0), 100) * 100) / 100;
  if (method === "fixed") {
    return [
      {
        name: "threshold",
        key: "segmentation.threshold",
        unit: "",
        level: (found) => cutOf(found, draft) ?? LEVELS / 2,
        value: (found, level) => Math.round((level - (found.grey_per_level === 1 ? 0.5 : 0)) * found.grey_per_level),
      },
    ];
  }
  if (!method.startsWith("dynamic")) return [];
  /** @type {Handle[]} */
  const handles = [
    {
      name: "low",
      key: "segmentation.low_tail_percent",
      unit: "%",
      level: (found) => range(found, draft).low,
      value: (found, level) => Math.min(tenth(below(found, level) + 0.005), 99 - draft.get("segmentation.high_tail_percent")),
    },
    {
      name: "level",
      key: "segmentation.level_percent",
      unit: "%",
      level: (found) => levelOf(found, draft),
      value: (found, level) => {
        const { low, high } = range(found, draft);
        return tenth((100 * (level - low)) / (high - low));
      },
    },
    {
      name: "high",
      key: "segmentation.high_tail_percent",
      unit: "%",
      level: (found) => range(found, draft).high,
      value: (found, level) => Math.min(tenth(100 - below(found, level)), 99 - draft.get("segmentation.low_tail_percent")),
    },
  ];
  if (method === "dynamic_soft") {
    const half = (/** @type {Histogram} */ found) => {
      const { low, high } = range(found, draft);
      return Math.max(0.5, ((high - low) * draft.get("segmentation.softness_percent")) / 200);
    };
    for (const side of [-1, 1]) {
      handles.push({
        name: side < 0 ? "soft_low" : "soft_high",
        key: "segmentation.softness_percent",
        unit: "%",
        level: (found) => levelOf(found, draft) + side * half(found),
        value: (found, level) => {
          const { low, high } = range(found, draft);
          return tenth((200 * Math.max(0, side * (level - levelOf(found, draft)))) / (high - low));
        },
      });
    }
  }
  return handles;
}
