// @ts-check
// What came of a run?  Slabs and refused blobs in tables, times at the stages, and one line that says how it went.
import { at, element, number, word } from "./words.js";

/** @typedef {import("./ask.js").Json} Json */

/**
 * Show what runs leave.
 * @param {import("./draft.js").Draft} draft
 * @param {import("./view.js").View} view
 */
export function startResults(draft, view) {
  const outcome = at("outcome");

  /**
   * @param {string} kind "good", "bad", "quiet"
   * @param {string} text
   */
  function say(kind, text) {
    const sign = { good: "✓ ", bad: "✗ ", quiet: "" }[kind] ?? "";
    outcome.replaceChildren(element("span", { class: kind }, sign + text));
  }

  /**
   * @param {string} id
   * @param {Json[]} items
   * @param {(item: Json) => string[]} cells
   * @param {(item: Json, index: number) => string} [selector] of what it is in the overlay
   */
  function fill(id, items, cells, selector) {
    const table = at(id);
    table.hidden = items.length === 0;
    const heads = [...table.querySelectorAll("th")].map((head) => head.className);
    const rows = items.map((item, index) => {
      const texts = cells(item);
      if (!selector) return element("tr", {}, ...texts.map((text, column) => element("td", { class: heads[column] }, text)));
      const which = selector(item, index);
      const first = element("button", { type: "button", class: "pick" }, texts[0]);
      first.addEventListener("click", () => view.choose(which));
      const row = element("tr", {}, element("td", { class: heads[0] }, first), ...texts.slice(1).map((text, column) => element("td", { class: heads[column + 1] }, text)));
      row.addEventListener("pointerenter", () => view.choose(which));
      first.addEventListener("focus", () => view.choose(which));
      for (const end of ["pointerleave", "focusout"]) row.addEventListener(end, () => view.choose(""));
      return row;
    });
    table.querySelector("tbody")?.replaceChildren(...rows);
  }

  return {
    say,
    /**
     * Show what came of a run.
     * @param {Json} preview
     * @param {number} display_ms from the request until it was drawn
     */
    take: (preview, display_ms) => {
      const { located, refusal, segmentation } = preview;
      const parts = located?.parts ?? [];
      const rejected = located?.rejected ?? [];
      const pose = (/** @type {Json} */ { x_mm, y_mm, a_deg }) => `${number(x_mm, 2)} · ${number(y_mm, 2)} · ${number(a_deg, 2, "°")}`;
      fill("parts", parts, (part) => [
        String(part.slot),
        number(part.score, 3),
        number(part.residual_mm, 3),
        `${number(Math.max(part.sigma.x_mm, part.sigma.y_mm), 3)} · ${number(part.sigma.a_deg, 3)}`,
        `${number(part.image.u, 1)} · ${number(part.image.v, 1)}`,
        pose(part.pick),
        pose(part.place),
      ], (part) => `[data-slot="${part.slot}"]`);
      fill("rejected", rejected, (blob) => [
        word(`reason.${blob.reason}`),
        `${number(blob.image.u, 1)} · ${number(blob.image.v, 1)}`,
        number(blob.area_mm2, 1),
        blob.detail,
      ], (_, index) => `[data-index="${index}"]`);
      fill("gates", located?.gates ?? [], ({ gate, value, limit, unit }) => [word(`gate.${gate}`), number(value, 1, unit), number(limit, undefined, unit)]);
      const none = at("no-results");
      none.hidden = parts.length + rejected.length > 0;
      none.textContent = word("no_parts");
      const times = located?.timing_ms ?? {};
      for (const button of /** @type {NodeListOf<HTMLButtonElement>} */ (document.querySelectorAll("#stages button"))) {
        const known = (button.dataset.times ?? "").split(" ").filter((name) => name in times);
        const sum = known.reduce((total, name) => total + times[name], 0);
        /** @type {HTMLElement} */ (button.querySelector(".ms")).textContent = known.length ? number(sum, 1, "ms") : "–";
      }
      if (!located) {
        say("bad", word("refused_picture", { detail: refusal }));
        return;
      }
      const line = word("found_line", { found: parts.length, slots: draft.slots, rejected: rejected.length });
      const time = word("time_line", { vision: number(times.total, 1, "ms"), display: number(display_ms, 0, "ms") });
      say(parts.length === draft.slots ? "good" : "bad", line);
      outcome.append(element("span", { class: "quiet small" }, ` ${time}; ${segmentation}`));
    },
  };
}
