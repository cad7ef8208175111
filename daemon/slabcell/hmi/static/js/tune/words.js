// @ts-check
// How does the page speak?  Words of the server, numbers as people of the page's language write them.

const root = /** @type {HTMLElement} */ (document.getElementById("tune"));
/** @type {Record<string, string>} */
const table = JSON.parse(root.dataset.words ?? "{}");
const german = document.documentElement.lang === "de";

/**
 * Return a word with its places filled in.
 * @param {string} key
 * @param {Record<string, string | number>} values
 */
export function word(key, values = {}) {
  let text = table[key] ?? key;
  for (const [name, value] of Object.entries(values)) text = text.replaceAll(`{${name}}`, String(value));
  return text;
}

/**
 * Return a number with its unit; what was not measured is a dash.
 * @param {number | null | undefined} value
 * @param {number} [digits] none: as many as it has
 * @param {string} [unit]
 */
export function number(value, digits, unit = "") {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const text = (digits === undefined ? String(value) : value.toFixed(digits)).replace("-", "−");
  const written = german ? text.replace(".", ",") : text;
  return unit === "°" ? written + unit : unit ? `${written}\u00a0${unit}` : written;
}

/** Labels of parameters by their keys. @type {Map<string, string>} */
const labels = new Map();
for (const { fields } of JSON.parse(root.dataset.form ?? "[]")) fields.forEach(learn);

/** @param {{key: string, label: string, fields: any[]}} field */
function learn({ key, label, fields }) {
  labels.set(key, label);
  fields.forEach(learn);
}

/**
 * Return what a parameter is called, by its key.
 * @param {string} key
 */
export function labelOf(key) {
  return labels.get(key) ?? key;
}

/**
 * Return what a choice of a parameter is called.
 * @param {string} name as recipes have it
 */
export function optionOf(name) {
  return table[`option.${name}`] ?? name;
}

/**
 * Return the value of a parameter as people read it.
 * @param {any} value
 * @param {string} [unit]
 * @param {string} [key] of the parameter
 * @returns {string}
 */
export function shown(value, unit = "", key = "") {
  if (value === null || value === undefined) return word("unset");
  if (typeof value === "boolean") return word(value ? "yes" : "no");
  if (typeof value === "number") return number(value, undefined, unit);
  if (Array.isArray(value) && value.length === 0) return word("unset");
  if (Array.isArray(value) && Array.isArray(value[0])) return word("points", { count: value.length });
  if (typeof value !== "object") return optionOf(String(value));
  return Object.entries(value)
    .map(([name, item]) => (Array.isArray(value) ? shown(item, "", key) : `${labels.get(`${key}.${name}`) ?? name} ${shown(item)}`))
    .join(Array.isArray(value) ? " · " : " ");
}

/**
 * Return an element of HTML.
 * @template {keyof HTMLElementTagNameMap} Name
 * @param {Name} name
 * @param {Record<string, string>} attributes
 * @param {(Node | string)[]} children
 * @returns {HTMLElementTagNameMap[Name]}
 */
export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/**
 * Return an element of the page by its id.
 * @template {HTMLElement} [Kind=HTMLElement]
 * @param {string} id
 * @returns {Kind}
 */
export function at(id) {
  return /** @type {Kind} */ (document.getElementById(id));
}

/**
 * Let a button be used or not; never while the link to the cell is lost.
 * @param {HTMLButtonElement} button
 * @param {boolean} on
 */
export function enable(button, on) {
  const lost = document.body.classList.contains("stale") && "needsCell" in button.dataset;
  button.disabled = !on || lost;
  if (on && lost) button.dataset.offWhileLost = "";
  else delete button.dataset.offWhileLost;
}
