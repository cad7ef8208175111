// @ts-check
// Where is looked?  The region of interest over the picture: drawn with the mouse or a finger, moved by its corners, with
// keys too.  Its numbers stand in the form.
import { svg } from "../picture.js";
import { at, element, word } from "./words.js";

/** @typedef {[number, number]} Point */

const KEY = "segmentation.roi";
const CLOSE_PX = 14;
const DRAG_PX = 6;
const INSET = 0.1;

/**
 * Keep the region over the picture as the draft has it.
 * @param {import("./draft.js").Draft} draft
 * @param {import("./view.js").View} view
 * @param {() => boolean} wanted whether its corners can be moved now
 */
export function startRoi(draft, view, wanted) {
  const region = svg("path", { class: "roi" });
  const corners = svg("g", { class: "corners" });
  const screen = svg("rect", { class: "screen", x: -0.5, y: -0.5 });
  const begun = svg("path", { class: "roi begun" });
  view.drawing.append(region, corners);
  /** @type {Point[]} */
  let drawn = [];
  /** @type {{at: Point, x: number, y: number} | null} */
  let pressed = null;

  const points = () => /** @type {Point[]} */ (draft.get(KEY) ?? []);
  const path = (/** @type {Point[]} */ list, closed = true) => (list.length ? `M${list.map((point) => point.join(" ")).join("L")}${closed ? "Z" : ""}` : "");
  const bounded = (/** @type {Point} */ [u, v]) =>
    /** @type {Point} */ ([Math.min(Math.max(u, 0), view.size.width - 1), Math.min(Math.max(v, 0), view.size.height - 1)]);

  function draw() {
    const flat = view.picture.dataset.buffer === "undistorted";  // there it would lie elsewhere
    const list = flat || !view.size.width ? [] : points();
    region.setAttribute("d", path(list));
    const movable = wanted() && !flat ? list : [];
    while (corners.childElementCount > movable.length) corners.lastElementChild?.remove();
    while (corners.childElementCount < movable.length) corners.append(corner(corners.childElementCount));
    movable.forEach(([u, v], index) => {
      const group = corners.children[index];
      for (const circle of group.children) {
        circle.setAttribute("cx", String(u));
        circle.setAttribute("cy", String(v));
      }
      group.setAttribute("aria-label", `${word("corner", { number: index + 1 })}: u ${u}, v ${v}`);
    });
  }

  /** @param {number} index */
  function corner(index) {
    const group = svg("g", { class: "corner", tabindex: 0, role: "button" }, svg("circle", { class: "reach" }), svg("circle", { class: "dot" }));
    let held = false;
    group.addEventListener("pointerdown", (event) => {
      const pointer = /** @type {PointerEvent} */ (event);
      pointer.preventDefault();
      pointer.stopPropagation();
      group.focus();
      group.setPointerCapture(pointer.pointerId);
      held = true;
    });
    group.addEventListener("pointermove", (event) => {
      if (held) move(index, view.pixel(/** @type {PointerEvent} */ (event)));
    });
    for (const end of ["pointerup", "pointercancel"]) group.addEventListener(end, () => (held = false));
    group.addEventListener("keydown", (event) => {
      const { key, shiftKey } = /** @type {KeyboardEvent} */ (event);
      const step = shiftKey ? 10 : 1;
      /** @type {Record<string, Point>} */
      const steps = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
      if (key === "Delete" || key === "Backspace") {
        const rest = points().filter((_, other) => other !== index);
        draft.set(KEY, rest.length < 3 ? null : rest);
      } else if (steps[key]) {
        const [u, v] = points()[index];
        move(index, [u + steps[key][0], v + steps[key][1]]);
      } else return;
      event.preventDefault();
      event.stopPropagation();
    });
    return group;
  }

  /**
   * @param {number} index
   * @param {Point} to
   */
  function move(index, to) {
    draft.set(KEY, points().map((point, other) => (other === index ? bounded(to) : point)));
  }

  // Drawing anew

  function start() {
    drawn = [];
    pressed = null;
    screen.setAttribute("width", String(view.size.width));
    screen.setAttribute("height", String(view.size.height));
    view.drawing.append(screen, begun);
    begun.setAttribute("d", "");
    at("legend").textContent = word("drawing");
    document.addEventListener("keydown", keys, true);
  }

  function end() {
    screen.remove();
    begun.remove();
    at("legend").textContent = "";
    document.removeEventListener("keydown", keys, true);
  }

  /** @param {Point[]} list */
  function finish(list) {
    end();
    if (list.length >= 3) draft.set(KEY, list.map(bounded));
  }

  /** @param {KeyboardEvent} event */
  function keys(event) {
    if (event.key === "Escape") end();
    else if (event.key === "Enter" && drawn.length >= 3) finish(drawn);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  const rectangle = (/** @type {Point} */ [u, v], /** @type {Point} */ [u1, v1]) => /** @type {Point[]} */ ([[u, v], [u1, v], [u1, v1], [u, v1]]);
  const far = (/** @type {PointerEvent} */ event) => pressed !== null && Math.hypot(event.clientX - pressed.x, event.clientY - pressed.y) > DRAG_PX;
  screen.addEventListener("pointerdown", (event) => {
    const pointer = /** @type {PointerEvent} */ (event);
    pointer.preventDefault();
    screen.setPointerCapture(pointer.pointerId);
    pressed = { at: view.pixel(pointer), x: pointer.clientX, y: pointer.clientY };
  });
  screen.addEventListener("pointermove", (event) => {
    const pointer = /** @type {PointerEvent} */ (event);
    const here = view.pixel(pointer);
    if (pressed && drawn.length === 0 && far(pointer)) begun.setAttribute("d", path(rectangle(pressed.at, here)));
    else if (drawn.length) begun.setAttribute("d", path([...drawn, here], false));
  });
  screen.addEventListener("pointerup", (event) => {
    const pointer = /** @type {PointerEvent} */ (event);
    const here = view.pixel(pointer);
    if (pressed && drawn.length === 0 && far(pointer)) {
      finish(rectangle(pressed.at, here));
    } else if (pressed) {
      const scale = view.drawing.getScreenCTM()?.a ?? 1;
      const first = drawn[0];
      if (drawn.length >= 3 && Math.hypot(here[0] - first[0], here[1] - first[1]) * scale < CLOSE_PX) finish(drawn);
      else drawn = [...drawn, here];
    }
    pressed = null;
  });

  draft.addEventListener("change", (event) => {
    if (/** @type {CustomEvent} */ (event).detail.key === KEY) draw();
  });
  draft.addEventListener("load", draw);
  view.picture.addEventListener("slab:shown", draw);

  return {
    draw,
    /** Return the corners with which a region begins that is not drawn: a little inside of the picture. */
    begin: () => {
      const { width, height } = view.size.width ? view.size : { width: 1000, height: 1000 };
      const [u, v] = [Math.round(width * INSET), Math.round(height * INSET)];
      return rectangle([u, v], [width - 1 - u, height - 1 - v]);
    },
    /**
     * Add what draws it to its field of the form.
     * @param {HTMLElement} room
     */
    tools: (room) => {
      const pencil = element("button", { type: "button", "data-at": "draw" }, word("draw"));
      pencil.addEventListener("click", () => view.size.width && start());
      const none = element("button", { type: "button", "data-at": "none" }, word("clear_points"));
      none.disabled = points().length === 0;
      none.addEventListener("click", () => draft.set(KEY, null));
      room.querySelector("fieldset > .row")?.prepend(pencil, none);
    },
  };
}
