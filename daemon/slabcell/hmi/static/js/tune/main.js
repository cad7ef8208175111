// @ts-check
// Tune: parameters are tried on pictures.  What belongs to what, and when something is run.
import "../picture.js";
import { post } from "./ask.js";
import { startChanges } from "./changes.js";
import { Draft } from "./draft.js";
import { startForm } from "./form.js";
import { startHistogram } from "./histogram.js";
import { startPictures } from "./pictures.js";
import { startResults } from "./results.js";
import { startRoi } from "./roi.js";
import { startTabs } from "./tabs.js";
import { View } from "./view.js";
import { at, enable, word } from "./words.js";

const AFTER_A_CHANGE_MS = 350;
const BETWEEN_LIVE_MS = 300;
const STEADY_MS = 1000;

const draft = new Draft();
const view = new View();
const base = /** @type {HTMLSelectElement} */ (at("base"));
const runButton = /** @type {HTMLButtonElement} */ (at("run"));
const isOn = (/** @type {string} */ id) => /** @type {HTMLInputElement} */ (at(id)).checked;
const stages = /** @type {HTMLButtonElement[]} */ ([...document.querySelectorAll("#stages button")]);
const sources = /** @type {HTMLButtonElement[]} */ ([...document.querySelectorAll("#source button")]);
let stage = "segment";
let source = "last";
let running = false;
/** @type {"" | "new" | "same"} What has to be run when the present run has ended: a new picture, or the same again. */
let wanted = "";
/** @type {number | undefined} */
let timer;

const results = startResults(draft, view);
const histogram = startHistogram(draft, view);
const roi = startRoi(draft, view, () => stage === "segment");
const pictures = startPictures(draft, { run: () => void run("new"), source: choose, everywhere: () => isOn("everywhere") });
startForm(draft, (field, room) => {
  if (field.key !== "segmentation.roi") return;
  field.begin = roi.begin;
  roi.tools(room);
});
startChanges(draft, (name) => void begin(name));
startTabs(at("tabs"), at("fold"), at("tune"));

/**
 * Run the vision on the picture that is chosen; one run at a time.
 * @param {"new" | "same"} which a new picture where they are live, or the same again
 */
async function run(which) {
  if (running) {
    wanted = wanted === "new" ? "new" : which;
    return;
  }
  if (!draft.base || (source === "set" && !pictures.chosen)) return;
  running = true;
  enable(runButton, false);
  results.say("quiet", word("running"));
  const began_ms = performance.now();
  const picture = source === "set" ? pictures.chosen : "latest";
  const live = source === "live" && which === "new";
  const done = await post("/tune/preview", { ...draft.candidate, picture, live, everywhere: isOn("everywhere") });
  if (done?.problem) {
    results.say(done.busy ? "quiet" : "bad", word(done.busy ? "busy" : "problem", { detail: done.problem }));
  } else if (done) {
    await view.take(done);
    results.take(done, performance.now() - began_ms);
    await histogram.take();
    pictures.take(picture);
  } else {
    results.say("quiet", word("none_yet"));
  }
  running = false;
  enable(runButton, true);
  at("tune").dataset.runs = String(Number(at("tune").dataset.runs ?? 0) + 1);
  const next = wanted;
  wanted = "";
  if (next) void run(next);
  else if (source === "live" && isOn("repeat") && !document.body.classList.contains("stale")) {
    timer = window.setTimeout(() => void run("new"), BETWEEN_LIVE_MS);
  }
}

/**
 * Choose where pictures come from.
 * @param {string} name
 */
function choose(name) {
  source = name;
  for (const button of sources) button.setAttribute("aria-pressed", String(button.value === name));
  at("from-set").hidden = name !== "set";
  at("repeat-label").hidden = name !== "live";
}

/** @param {string} name */
function show(name) {
  stage = name;
  for (const button of stages) button.setAttribute("aria-pressed", String(button.value === name));
  for (const form of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll(".fields"))) form.hidden = form.dataset.stage !== name;
  roi.draw();
}

function mark() {
  for (const button of stages) {
    const sign = button.querySelector(".mark");
    if (sign instanceof HTMLElement) sign.hidden = !draft.isChanged(button.dataset.table ?? "");
  }
}

/**
 * Begin with a recipe, and see what it makes of the picture.
 * @param {string} name
 */
async function begin(name) {
  await draft.load(name);
  await run("same");
}

for (const button of stages) {
  button.addEventListener("click", () => {
    show(button.value);
    view.buffer = button.dataset.buffer ?? "input";
  });
}
for (const button of sources) button.addEventListener("click", () => choose(button.value));
base.addEventListener("change", () => void begin(base.value));
runButton.addEventListener("click", () => void run("new"));
at("everywhere").addEventListener("change", () => void run("same"));
at("repeat").addEventListener("change", () => isOn("repeat") && void run("new"));
draft.addEventListener("load", () => {
  mark();
  for (const name of [draft.base, draft.active.name]) {
    if (![...base.options].some((option) => option.value === name)) base.append(new Option(name, name));
  }
  base.value = draft.base;
  for (const option of base.options) option.text = option.value + (option.value === draft.active.name ? " ✓" : "");
});
draft.addEventListener("change", () => {
  mark();
  window.clearTimeout(timer);
  if (isOn("auto")) timer = window.setTimeout(() => void run("same"), AFTER_A_CHANGE_MS);
});
/** @type {number | undefined} */
let looking;
for (const kind of ["state", "reset"]) {
  document.body.addEventListener(`slab:${kind}`, () => {
    window.clearTimeout(looking);
    looking = window.setTimeout(() => void draft.refresh(), STEADY_MS);
  });
}
view.buffer = "mask";
void begin([...base.options].some((option) => option.value === Draft.kept) ? Draft.kept : base.value);
