// @ts-check
// Which parameters does somebody try?  Those of a recipe, and what was changed; nothing of it is the cell's yet.
// A draft stays in this tab of the browser until it is applied or discarded, also while other pages are looked at.
import { get } from "./ask.js";

const KEPT = "slabcell-draft";
const TABLES = new Set(["template", "gates", "segmentation", "blobs", "matching", "grasp"]);

/** One draft.  It tells of ``change`` (detail: key, by) and of ``load``. */
export class Draft extends EventTarget {
  base = "";
  slots = 0;
  /** @type {Record<string, any>} */
  parameters = {};
  /** @type {Record<string, any>} As the base has them. */
  before = {};
  /** @type {{name: string, parameters: Record<string, any>}} */
  active = { name: "", parameters: {} };

  /**
   * Begin with a recipe.
   * @param {string} name
   */
  async load(name) {
    const found = await get(`/tune/recipe?name=${encodeURIComponent(name)}`);
    if (!found) return;
    this.base = found.name;
    this.slots = found.slots;
    this.before = found.parameters;
    this.parameters = kept(name) ?? structuredClone(found.parameters);
    this.active = found.active;
    this.dispatchEvent(new CustomEvent("load"));
  }

  /** The recipe of the draft that is kept from before; empty for none. */
  static get kept() {
    return JSON.parse(sessionStorage.getItem(KEPT) ?? "{}").base ?? "";
  }

  /** Keep nothing of what was changed: it is the cell's now, or nobody wants it. */
  forget() {
    sessionStorage.removeItem(KEPT);
  }

  /** Look whether another recipe is active now. */
  async refresh() {
    const found = await get("/tune/active");
    if (!found?.name || found.name === this.active.name) return;
    const whole = await get(`/tune/recipe?name=${encodeURIComponent(found.name)}`);
    if (!whole) return;
    this.active = whole.active;
    this.dispatchEvent(new CustomEvent("load"));
  }

  /**
   * Return the value of a parameter.
   * @param {string} key
   * @param {Record<string, any>} [of]
   */
  get(key, of = this.parameters) {
    return key.split(".").reduce((value, name) => value?.[name], /** @type {any} */ (of));
  }

  /**
   * Change a parameter.
   * @param {string} key
   * @param {any} value
   * @param {unknown} [by] who changes it
   */
  set(key, value, by) {
    const names = key.split(".");
    const last = /** @type {string} */ (names.pop());
    const table = names.reduce((inner, name) => inner[name], this.parameters);
    if (same(table[last], value)) return;
    table[last] = value;
    if (this.touched) sessionStorage.setItem(KEPT, JSON.stringify({ base: this.base, parameters: this.parameters }));
    else this.forget();
    this.dispatchEvent(new CustomEvent("change", { detail: { key, by } }));
  }

  /**
   * Return whether a parameter, or one of a table, is another one than in the active recipe.
   * @param {string} key
   * @returns {boolean}
   */
  isChanged(key) {
    if (!TABLES.has(key)) return !same(this.get(key), this.get(key, this.active.parameters));
    const names = new Set([...Object.keys(this.parameters[key] ?? {}), ...Object.keys(this.active.parameters[key] ?? {})]);
    return [...names].some((name) => `${key}.${name}` !== "template.file" && this.isChanged(`${key}.${name}`));
  }

  /** Whether anything is otherwise than in the base. */
  get touched() {
    return !same(this.parameters, this.before);
  }

  /** What the cell is asked with. */
  get candidate() {
    return { base: this.base, parameters: this.parameters };
  }
}

/**
 * Return the parameters that were kept as a draft of a recipe, if any were.
 * @param {string} base
 */
function kept(base) {
  const found = JSON.parse(sessionStorage.getItem(KEPT) ?? "{}");
  return found.base === base ? found.parameters : null;
}

/**
 * @param {any} one
 * @param {any} other
 */
export function same(one, other) {
  return JSON.stringify(one ?? null) === JSON.stringify(other ?? null);
}
