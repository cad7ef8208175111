// @ts-check
// What would change, does it pass, and shall it be?  The way of a draft into the cell, and back.
import { follow, post } from "./ask.js";
import { at, element, enable, labelOf, shown, word } from "./words.js";

/** @typedef {import("./ask.js").Json} Json */

/**
 * Show the changes of a draft, check them, apply them.
 * @param {import("./draft.js").Draft} draft
 * @param {(name: string) => void} begin begins anew with a recipe
 */
export function startChanges(draft, begin) {
  const [check, apply, undo, discard] = ["check", "apply", "undo", "discard"].map((id) => /** @type {HTMLButtonElement} */ (at(id)));
  const verdict = at("verdict");
  const graded = at("graded");
  /** The parameters that were checked, and as which recipe; what may be applied, if it passed. */
  let checked = { name: "", parameters: "", base: "", passed: false };
  let busy = false;
  /** @type {number | undefined} */
  let timer;

  const current = () => JSON.stringify(draft.parameters);
  const isChecked = () => checked.name !== "" && checked.base === draft.base && checked.parameters === current();

  async function compare() {
    const done = await post("/tune/compare", draft.candidate);
    if (!done) return;
    const table = at("differences");
    const none = at("no-differences");
    const changes = done.changes ?? [];
    table.hidden = changes.length === 0;
    none.hidden = changes.length > 0;
    none.textContent = done.problem ?? (done.template_changed ? word("template_changed") : word("no_changes", { name: done.active }));
    none.className = done.problem ? "bad" : "empty";
    const rows = changes.map((/** @type {Json} */ item) => element(
      "tr",
      {},
      element("td", {}, labelOf(item.key), " ", element("span", { class: "quiet small" }, item.key)),
      element("td", { class: "number" }, shown(item.active, item.unit, item.key)),
      element("td", { class: "number" }, shown(item.candidate, item.unit, item.key)),
      element("td", {}, back(item)),
    ));
    if (done.template_changed && changes.length) rows.unshift(element("tr", {}, element("td", { colspan: "4" }, word("template_changed"))));
    table.querySelector("tbody")?.replaceChildren(...rows);
    const count = document.querySelector("#tab-changes .count");
    if (count) count.textContent = changes.length ? ` ${changes.length}` : "";
  }

  /** @param {Json} item */
  function back(item) {
    const button = element("button", { type: "button", class: "pick", "aria-label": `${labelOf(item.key)}: ${word("reset", { value: shown(item.active, item.unit, item.key) })}` }, "↺");
    button.addEventListener("click", () => draft.set(item.key, structuredClone(draft.get(item.key, draft.active.parameters) ?? null)));
    return button;
  }

  function show() {
    enable(check, !busy);
    discard.hidden = !draft.touched;
    enable(apply, !busy && checked.passed && isChecked() && checked.name !== draft.active.name);
    if (checked.name && !isChecked() && !busy) {
      verdict.replaceChildren(element("span", { class: "quiet" }, word("check_again")));
      graded.replaceChildren();
    }
  }

  async function run() {
    busy = true;
    const [parameters, base] = [current(), draft.base];
    checked = { name: "", parameters, base, passed: false };
    graded.replaceChildren();
    show();
    const begun = await post("/tune/check", { ...draft.candidate, changed: draft.touched });
    const done = begun?.task ? await follow(begun.task, ({ done: count, total, doing }) => {
      verdict.textContent = word("checking", { done: count, total, doing });
    }) : null;
    busy = false;
    const problem = begun?.problem ?? done?.problem ?? "";
    if (problem) verdict.replaceChildren(element("span", { class: begun?.busy ? "" : "bad" }, begun?.busy ? word("busy", { detail: problem }) : `✗ ${word("problem", { detail: problem })}`));
    else if (begun && done?.result) judge(begun.name, done.result, parameters, base);
    else verdict.textContent = "";
    show();
  }

  /**
   * @param {string} name
   * @param {Json} result
   * @param {string} parameters
   * @param {string} base
   */
  function judge(name, result, parameters, base) {
    /** @type {{bundle: string, problems: string[]}[]} */
    const pictures = result.pictures;
    checked = { name, parameters, base, passed: result.passed && pictures.length > 0 };
    const failed = pictures.filter((item) => item.problems.length);
    const said = pictures.length === 0 ? "passed_nothing" : result.passed ? "passed" : "not_passed";
    const text = word(said, { name, pictures: pictures.length, failed: failed.length });
    verdict.replaceChildren(element("strong", { class: said === "passed" ? "good" : said === "not_passed" ? "bad" : "warn" }, `${said === "passed" ? "✓" : said === "not_passed" ? "✗" : "!"} ${text}`));
    graded.replaceChildren(...pictures.map((item) => element("li", { class: item.problems.length ? "bad" : "" }, `${item.problems.length ? "✗" : "✓"} ${item.bundle}${item.problems.length ? `: ${item.problems.join("; ")}` : ""}`)));
  }

  /** @param {string} name */
  async function activate(name) {
    const before = draft.active.name;
    busy = true;
    show();
    const done = await post("/tune/apply", { name });
    busy = false;
    if (done && !done.problem) {
      verdict.replaceChildren(element("strong", { class: "good" }, `✓ ${word("applied")}: ${done.detail}`));
      undo.hidden = false;
      undo.textContent = word("undo", { name: before });
      undo.value = before;
      checked = { name: "", parameters: "", base: "", passed: false };
      draft.forget();
      begin(name);
    } else if (done) {
      verdict.replaceChildren(element("span", { class: done.busy ? "" : "bad" }, done.busy ? word("busy", { detail: done.problem }) : `✗ ${done.problem}`));
    }
    show();
  }

  check.addEventListener("click", () => void run());
  discard.addEventListener("click", () => {
    draft.forget();
    begin(draft.base);
  });
  undo.addEventListener("click", () => void activate(undo.value));
  at("apply-form").addEventListener("submit", (event) => {
    event.preventDefault();
    if (!apply.disabled) void activate(checked.name);
  });
  const later = () => {
    show();
    window.clearTimeout(timer);
    timer = window.setTimeout(() => void compare(), 300);
  };
  draft.addEventListener("change", later);
  draft.addEventListener("load", later);
}
