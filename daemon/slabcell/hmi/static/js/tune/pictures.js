// @ts-check
// On which pictures?  The sets that are kept, graded pictures and cycles: to choose one, to run all, to keep and to grade.
import { say } from "../messages.js";
import { follow, get, post } from "./ask.js";
import { at, element, enable, number, word } from "./words.js";

/** @typedef {import("./ask.js").Json} Json */
/** @typedef {{name: string, kind: string, pictures: {picture: string, name: string}[]}} PictureSet */

/**
 * Show the pictures, and run what is chosen.
 * @param {import("./draft.js").Draft} draft
 * @param {{run: () => void, source: (name: string) => void, everywhere: () => boolean}} page
 */
export function startPictures(draft, page) {
  const sets = /** @type {HTMLSelectElement} */ (at("set"));
  const chooser = /** @type {HTMLSelectElement} */ (at("picture"));
  /** @type {PictureSet[]} */
  let known = [];
  /** @type {Map<string, Json>} What came of each picture in the last run over many. */
  let rows = new Map();
  /** What was run last, as requests call it. */
  let last = "";
  let task = "";

  const chosenSet = () => known[Number(sets.value)] ?? { name: "", kind: "", pictures: [] };
  const title = (/** @type {PictureSet} */ { kind, name }) => word(`set.${kind}`, { name });
  const button = (/** @type {string} */ id) => /** @type {HTMLButtonElement} */ (at(id));

  async function load() {
    const found = await get(`/tune/sets?recipe=${encodeURIComponent(draft.base)}`);
    if (!found) return;
    const before = known[Number(sets.value)];
    const picture = chooser.value;
    known = found.sets;
    sets.replaceChildren(...known.map((one, index) => element("option", { value: String(index) }, `${title(one)} (${one.pictures.length})`)));
    const again = known.findIndex((one) => one.kind === before?.kind && (one.name === before.name || one.kind !== "stored"));
    sets.value = String(Math.max(0, again));
    chooser.replaceChildren(...known.filter((one) => one.pictures.length).map((one) => {
      const group = element("optgroup", { label: title(one) });
      group.append(...one.pictures.map((item) => element("option", { value: item.picture }, item.name)));
      return group;
    }));
    if (picture) chooser.value = picture;
    if (!chooser.value && chooser.options.length) chooser.selectedIndex = 0;
    show();
  }

  function show() {
    const { pictures } = chosenSet();
    at("no-pictures").hidden = pictures.length > 0;
    at("picture-rows").replaceChildren(...pictures.map(({ picture, name }) => {
      const open = element("button", { type: "button", class: "pick" }, name);
      open.addEventListener("click", () => choose(picture));
      const done = rows.get(picture);
      const found = done ? `${done.slots.length === draft.slots ? "✓" : "✗"} ${done.slots.length} / ${draft.slots}` : "";
      const cells = done
        ? [found, done.rejected.map((/** @type {string} */ reason) => word(`reason.${reason}`)).join(", "), number(done.worst_residual_mm, 3), number(done.timing_ms.total, 1), done.refusal]
        : ["", "", "", "", ""];
      const row = element("tr", { class: picture === last ? "chosen" : "" }, element("td", {}, open));
      cells.forEach((text, column) => row.append(element("td", { class: [0, 2, 3].includes(column) ? "number" : "" }, text)));
      return row;
    }));
    enable(button("run-all"), pictures.length > 0 && !task);
    enable(button("forget"), last.startsWith("set:"));
    enable(button("grade"), last.startsWith("cycle:"));
    enable(button("keep"), last !== "");
  }

  /** @param {string} picture */
  function choose(picture) {
    page.source("set");
    chooser.value = picture;
    page.run();
  }

  /** @param {number} by */
  function step(by) {
    const count = chooser.options.length;
    if (!count) return;
    chooser.selectedIndex = (chooser.selectedIndex + by + count) % count;
    page.run();
  }

  async function runAll() {
    const { pictures } = chosenSet();
    const begun = await post("/tune/run", { ...draft.candidate, everywhere: page.everywhere(), pictures: pictures.map((item) => item.picture) });
    if (!begun) return;
    if (begun.problem) {
      at("run-all-said").textContent = word(begun.busy ? "busy" : "problem", { detail: begun.problem });
      return;
    }
    task = begun.task;
    at("stop-all").hidden = false;
    show();
    const done = await follow(task, ({ done: count, total, doing }) => {
      at("run-all-said").textContent = word("checking", { done: count, total, doing }).replace(/^.*?: /, "");
    });
    task = "";
    at("stop-all").hidden = true;
    at("run-all-said").textContent = done?.problem ? word("problem", { detail: done.problem }) : "";
    if (done?.result) rows = new Map(done.result.pictures.map((/** @type {Json} */ row) => [row.picture, row]));
    show();
  }

  /**
   * Have something done with the picture that was run last, and say what came of it.
   * @param {string} path
   * @param {Json} content
   * @param {(done: Json) => string} words
   */
  async function act(path, content, words) {
    const done = await post(path, content);
    if (!done) return null;
    say(done.problem ? "failed" : "done", done.problem ?? words(done));
    if (!done.problem) await load();
    return done.problem ? null : done;
  }

  sets.addEventListener("change", show);
  chooser.addEventListener("change", () => page.run());
  at("previous").addEventListener("click", () => step(-1));
  at("next").addEventListener("click", () => step(1));
  at("run-all").addEventListener("click", () => void runAll());
  at("stop-all").addEventListener("click", () => void post("/tune/cancel", { task }));
  at("keep").addEventListener("click", () => {
    const [set, name] = ["keep-set", "keep-name"].map((id) => /** @type {HTMLInputElement} */ (at(id)));
    if (set.reportValidity() && name.reportValidity()) {
      void act("/tune/keep", { set: set.value, name: name.value, picture: last }, (done) => word("kept", { name: done.picture }));
    }
  });
  at("grade").addEventListener("click", () => void act("/tune/grade", { recipe: draft.base, cycle: Number(last.slice(6)) }, (done) => done.detail));
  at("forget").addEventListener("click", () => {
    const [set, file] = last.slice(4).split("/");
    void act("/tune/forget", { set, file }, (done) => done.detail);
  });
  at("upload").addEventListener("change", async (event) => {
    const input = /** @type {HTMLInputElement} */ (event.target);
    const file = input.files?.[0];
    input.value = "";
    const done = file ? await post("/tune/upload", file) : null;
    if (!done) return;
    if (done.problem) {
      say("failed", done.problem);
      return;
    }
    chooser.append(element("option", { value: done.picture }, file?.name ?? done.picture));
    choose(done.picture);
  });
  draft.addEventListener("load", () => {
    rows = new Map();
    void load();
  });
  document.body.addEventListener("slab:kept", () => void load());

  return {
    /** The picture that is chosen among those that are stored. */
    get chosen() {
      return chooser.value;
    },
    /**
     * Take the name of the picture that was run.
     * @param {string} picture
     */
    take: (picture) => {
      last = picture;
      show();
    },
  };
}
