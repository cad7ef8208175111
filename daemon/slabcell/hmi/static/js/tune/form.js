// @ts-check
// Which parameters are there to change?  A form of each table of the recipe, made from what the server says of its fields.
import { at, element, enable, number, optionOf, shown, word } from "./words.js";

/** @typedef {import("./draft.js").Draft} Draft */
/**
 * @typedef {{key: string, name: string, label: string, help: string, kind: string, unit: string, optional: boolean,
 *   minimum: number | null, maximum: number | null, above: boolean, choices: string[], least: number, most: number | null,
 *   default: any, fields: Field[], begin?: () => any[]}} Field `begin` gives the first entries of an empty list
 */
/** @typedef {{read: () => any, write: (value: any) => void}} Place where a value is */

let ids = 0;

/**
 * Build every form, and keep it as the draft is.
 * @param {Draft} draft
 * @param {(field: Field, room: HTMLElement) => void} extra adds to a field what only the page knows
 */
export function startForm(draft, extra) {
  /** @type {{table: string, fields: Field[]}[]} */
  const tables = JSON.parse(at("tune").dataset.form ?? "[]");
  /** @type {Map<string, {field: Field, room: HTMLElement}>} */
  const rooms = new Map();
  for (const { table, fields } of tables) {
    const form = at(`fields-${table}`);
    form.addEventListener("submit", (event) => event.preventDefault());
    for (const field of fields) {
      const room = element("div", { class: "field", "data-key": field.key });
      form.append(room);
      rooms.set(field.key, { field, room });
    }
  }
  const build = (/** @type {string} */ key) => {
    const known = rooms.get(key);
    if (!known) return;
    const focused = known.room.contains(document.activeElement) ? document.activeElement?.getAttribute("data-at") : null;
    const place = { read: () => draft.get(key), write: (/** @type {any} */ value) => draft.set(key, value, known.room) };
    known.room.replaceChildren(...control(known.field, place), reset(known.field, draft));
    extra(known.field, known.room);
    mark(known.field, known.room, draft);
    if (focused) /** @type {HTMLElement | null} */ (known.room.querySelector(`[data-at="${focused}"]`))?.focus();
  };
  draft.addEventListener("load", () => [...rooms.keys()].forEach(build));
  draft.addEventListener("change", (event) => {
    const { key, by } = /** @type {CustomEvent} */ (event).detail;
    const found = [...rooms.keys()].find((name) => key === name || key.startsWith(`${name}.`));
    const known = found ? rooms.get(found) : undefined;
    if (!found || !known) return;
    if (by === known.room && !["points", "tables", "table"].includes(known.field.kind)) mark(known.field, known.room, draft);
    else build(found);
  });
}

/**
 * @param {Field} field
 * @param {Draft} draft
 */
function reset(field, draft) {
  const button = element("button", { type: "button", class: "reset", "data-at": "reset" });
  button.addEventListener("click", () => {
    draft.set(field.key, structuredClone(draft.get(field.key, draft.active.parameters) ?? null));
  });
  return button;
}

/**
 * Say whether a field is otherwise than in the active recipe.
 * @param {Field} field
 * @param {HTMLElement} room
 * @param {Draft} draft
 */
function mark(field, room, draft) {
  const changed = draft.isChanged(field.key);
  room.classList.toggle("is-changed", changed);
  const button = /** @type {HTMLButtonElement} */ (room.querySelector(":scope > .reset"));
  button.hidden = !changed;
  button.textContent = word("reset", { value: shown(draft.get(field.key, draft.active.parameters), field.unit, field.key) });
}

/**
 * Return what changes a value.
 * @param {Field} field
 * @param {Place} place
 * @param {string} [where] where it is inside of its field
 * @returns {HTMLElement[]}
 */
function control(field, place, where = "0") {
  switch (field.kind) {
    case "flag":
      return flag(field, place, where);
    case "points":
      return list(field, place, where, pointRow);
    case "tables":
      return list(field, place, where, tableRow);
    case "table":
      return inner(field, place, where);
    default:
      return simple(field, place, where);
  }
}

/**
 * @param {Field} field
 * @param {Place} place
 * @param {string} where
 */
function simple(field, place, where) {
  const id = `field-${(ids += 1)}`;
  const input = field.kind === "choice" ? choice(field) : element("input", { autocomplete: "off" });
  input.id = id;
  input.setAttribute("aria-describedby", `${id}-help`);
  input.dataset.at = where;
  if (input instanceof HTMLInputElement) {
    const isNumber = field.kind === "number" || field.kind === "integer";
    input.type = isNumber ? "number" : "text";
    if (isNumber) {
      input.step = field.kind === "integer" ? "1" : "any";
      if (field.minimum !== null) input.min = String(field.minimum);
      if (field.maximum !== null) input.max = String(field.maximum);
    }
    input.required = !field.optional;
  }
  input.value = text(field, place.read());
  input.addEventListener("change", () => {
    const value = parsed(field, input);
    const wrong = value === undefined;
    input.setAttribute("aria-invalid", String(wrong));
    if (!wrong) place.write(value);
  });
  const unit = field.unit ? [element("span", { class: "unit", "aria-hidden": "true" }, field.unit)] : [];
  return [
    element("label", { for: id }, field.label, ...(field.unit ? [element("span", { class: "away" }, ` ${field.unit}`)] : [])),
    element("div", { class: "input" }, input, ...unit),
    element("p", { class: "help", id: `${id}-help` }, [field.help, range(field)].filter(Boolean).join("; ")),
  ];
}

/** @param {Field} field */
function choice(field) {
  const names = field.optional ? ["", ...field.choices] : field.choices;
  return element("select", {}, ...names.map((name) => element("option", { value: name }, name ? optionOf(name) : word("unset"))));
}

/**
 * Return the range of a number in words.
 * @param {Field} field
 */
function range({ minimum, maximum, above, unit }) {
  const from = minimum === null ? "" : number(minimum, undefined, unit);
  const to = maximum === null ? "" : number(maximum, undefined, unit);
  if (minimum !== null && maximum !== null && !above) return word("range", { from, to });
  return [minimum === null ? "" : word(above ? "above" : "from", { from }), maximum === null ? "" : word("to", { to })]
    .filter(Boolean)
    .join(", ");
}

/**
 * @param {Field} field
 * @param {any} value
 */
function text(field, value) {
  if (value === null || value === undefined) return "";
  return field.kind === "numbers" ? value.join(", ") : String(value);
}

/**
 * Return the value that was filled in; undefined if it is none.
 * @param {Field} field
 * @param {HTMLInputElement | HTMLSelectElement} input
 */
function parsed(field, input) {
  if (!input.checkValidity()) return undefined;
  const value = input.value.trim();
  if (value === "") return field.optional ? null : undefined;
  if (field.kind === "choice" || field.kind === "text") return value;
  if (field.kind !== "numbers") {
    const found = Number(value);
    return field.above && found === field.minimum ? undefined : found;
  }
  const found = value.split(/[\s,;]+/).filter(Boolean).map(Number);
  return found.every(Number.isInteger) && found.length >= field.least ? found : undefined;
}

/**
 * @param {Field} field
 * @param {Place} place
 * @param {string} where
 */
function flag(field, place, where) {
  const id = `field-${(ids += 1)}`;
  const input = element("input", { type: "checkbox", id, "aria-describedby": `${id}-help`, "data-at": where });
  input.checked = Boolean(place.read());
  input.addEventListener("change", () => place.write(input.checked));
  return [element("label", { class: "check" }, input, field.label), element("p", { class: "help", id: `${id}-help` }, field.help)];
}

/**
 * Return the fields of a table that may be missing as a whole.
 * @param {Field} field
 * @param {Place} place
 * @param {string} where
 */
function inner(field, place, where) {
  const value = place.read();
  const group = element("fieldset", {}, element("legend", {}, field.label), element("p", { class: "help" }, field.help));
  if (value === null || value === undefined) group.append(element("p", { class: "quiet" }, word("unset")));
  else group.append(...members(field, place, where));
  return [group];
}

/**
 * Return the fields of one table.
 * @param {Field} field
 * @param {Place} place
 * @param {string} where
 */
function members(field, place, where) {
  return field.fields.flatMap((one, index) => {
    const read = () => place.read()?.[one.name];
    const write = (/** @type {any} */ value) => place.write({ ...place.read(), [one.name]: value });
    return control(one, { read, write }, `${where}-${index}`);
  });
}

/**
 * Return the rows of a list, to add to and to remove from.
 * @param {Field} field
 * @param {Place} place
 * @param {string} where
 * @param {(field: Field, place: Place, number: number, where: string) => HTMLElement[]} row
 */
function list(field, place, where, row) {
  /** @type {any[]} */
  const items = place.read() ?? [];
  const write = (/** @type {any[]} */ changed) => {
    if (changed.length >= Math.max(field.least, field.optional ? 1 : 0)) place.write(changed);
    else if (field.optional) place.write(null);
  };
  const group = element(
    "fieldset",
    {},
    element("legend", {}, field.label, ...(field.unit ? [` (${field.unit})`] : [])),
    element("p", { class: "help" }, field.help),
  );
  items.forEach((_, index) => {
    const of = {
      read: () => (place.read() ?? [])[index],
      write: (/** @type {any} */ value) => write(items.map((item, other) => (other === index ? value : item))),
    };
    const what = `${field.kind === "points" ? word("corner", { number: index + 1 }) : `${field.label} ${index + 1}`}`;
    const remove = element("button", { type: "button", "aria-label": word("remove", { what }), "data-at": `${where}-x${index}` }, "×");
    remove.addEventListener("click", () => write(items.filter((_item, other) => other !== index)));
    enable(remove, field.optional || field.least === 0 || items.length > field.least);
    group.append(element("div", { class: `item ${field.kind}` }, ...row(field, of, index, `${where}-${index}`), remove));
  });
  const add = element("button", { type: "button", class: "add", "data-at": `${where}-add` }, field.kind === "points" ? word("add_point") : word("add"));
  enable(add, field.most === null || items.length < field.most);
  add.addEventListener("click", () => {
    const changed = items.length === 0 && field.begin ? field.begin() : [...items, fresh(field, items)];
    while (changed.length < field.least) changed.push(fresh(field, changed));
    write(changed);
  });
  group.append(element("div", { class: "row" }, add));
  return [group];
}

/**
 * @param {Field} field
 * @param {Place} place
 * @param {number} index
 * @param {string} where
 */
function pointRow(field, place, index, where) {
  const inPicture = field.key.endsWith(".roi");
  return (inPicture ? ["u", "v"] : ["x", "y"]).map((axis, side) => {
    const label = word("point", { what: field.label, number: index + 1, axis });
    const input = element("input", { type: "number", step: "any", required: "", "aria-label": label, "data-at": `${where}-${side}` });
    input.value = String(place.read()?.[side] ?? 0);
    input.addEventListener("change", () => {
      input.setAttribute("aria-invalid", String(!input.checkValidity()));
      if (!input.checkValidity()) return;
      const point = [...place.read()];
      point[side] = Number(input.value);
      place.write(point);
    });
    return element("span", { class: "axis" }, element("span", { "aria-hidden": "true" }, axis), input);
  });
}

/**
 * @param {Field} field
 * @param {Place} place
 * @param {number} _
 * @param {string} where
 */
function tableRow(field, place, _, where) {
  return [element("div", { class: "members" }, ...members(field, place, where))];
}

/**
 * Return one more entry of a list.
 * @param {Field} field
 * @param {any[]} before
 */
function fresh(field, before) {
  if (field.kind === "points") {
    const last = before.at(-1) ?? [0, 0];
    return [[last[0] + 10, last[1]], [last[0], last[1] + 10]][before.length % 2];
  }
  return Object.fromEntries(field.fields.map((one) => [one.name, start(one)]));
}

/**
 * Return the value with which a field of a new table begins.
 * @param {Field} field
 * @returns {any}
 */
function start(field) {
  if (field.default !== null && field.default !== undefined) return field.default;
  if (field.name === "min") return 0;
  if (field.optional) return null;
  if (field.kind === "choice") return field.choices[0];
  if (field.kind === "points") return [[0, 0], [10, 0], [0, 10]];
  if (field.kind === "numbers") return [0];
  return field.kind === "flag" ? false : field.kind === "text" ? "" : (field.minimum ?? 0) + (field.above ? 1 : 0);
}
