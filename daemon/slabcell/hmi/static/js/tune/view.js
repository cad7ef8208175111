// @ts-check
// What did a stage see?  The buffers of a preview, each with what belongs over it, as SVG in pixels of the picture.
import { SlabPicture, outline, svg } from "../picture.js";
import { get } from "./ask.js";
import { at, word } from "./words.js";

/** @typedef {import("./ask.js").Json} Json */
/** @typedef {[number, number]} Point */

/** @type {Record<string, string>} */
const FILES = { input: "input.png", undistorted: "undistorted.png", mask: "mask.png", blobs: "blobs.png", contours: "input.png", residuals: "input.png" };
/** The longest whisker, in parts of the picture's width. */
const WHISKER = 0.02;

/** The picture of the page. */
export class View {
  picture = /** @type {SlabPicture} */ (/** @type {unknown} */ (document.querySelector("slab-picture#tried")));
  /** Over the overlay: what a buffer adds, and what is drawn by hand. */
  drawing = /** @type {SVGSVGElement} */ (svg("svg", { class: "overlay drawing" }));
  #layer = svg("g", { class: "layer" });
  /** @type {Json | null} */
  #preview = null;
  /** @type {Map<string, Json | null>} */
  #read = new Map();
  size = { width: 0, height: 0 };

  constructor() {
    this.drawing.append(this.#layer);
    this.picture.append(at("legend"));
    for (const id of ["buffer", "overlay"]) at(id).addEventListener("change", () => void this.show());
  }

  /** Which buffer is shown. */
  get buffer() {
    return /** @type {keyof typeof FILES} */ (/** @type {HTMLSelectElement} */ (at("buffer")).value);
  }

  /** @param {string} name */
  set buffer(name) {
    /** @type {HTMLSelectElement} */ (at("buffer")).value = name;
    void this.show();
  }

  /**
   * Take what a run left.
   * @param {Json} preview
   */
  async take(preview) {
    this.#preview = preview;
    this.#read.clear();
    this.size = { width: preview.width, height: preview.height };
    await this.show();
  }

  /** Show the buffer that is chosen. */
  async show() {
    const preview = this.#preview;
    if (!preview) return;
    const buffer = this.buffer;
    const there = preview.buffers.some((/** @type {Json} */ item) => item.name === FILES[buffer]);
    const path = `/tune/previews/${preview.preview}/${there ? FILES[buffer] : "input.png"}`;
    const overlay = buffer === "undistorted" ? await this.file("undistorted.json") : preview.located;
    const wanted = /** @type {HTMLInputElement} */ (at("overlay")).checked;
    const more = buffer === "contours" || buffer === "residuals" ? await this.file(`${buffer}.json`) : null;
    if (!(await this.picture.present(path, this.size, wanted ? overlay : null)) || preview !== this.#preview) return;
    const stage = this.picture.overlay.parentElement;
    if (this.drawing.parentElement !== stage) stage?.append(this.drawing);
    this.drawing.setAttribute("viewBox", `-0.5 -0.5 ${this.size.width} ${this.size.height}`);
    const [layers, said] = buffer === "contours" ? contours(more) : buffer === "residuals" ? residuals(more, this.size.width) : [[], ""];
    this.#layer.replaceChildren(...layers);
    at("legend").textContent = there ? said : word("not_reached");
    this.picture.dataset.buffer = there ? buffer : "input";
    this.picture.dataset.preview = preview.preview;
    this.picture.dispatchEvent(new CustomEvent("slab:shown"));
  }

  /**
   * Return a JSON file of the preview; null if there is none.
   * @param {string} name
   */
  async file(name) {
    const preview = this.#preview;
    if (!preview?.buffers.some((/** @type {Json} */ item) => item.name === name)) return null;
    if (!this.#read.has(name)) this.#read.set(name, await get(`/tune/previews/${preview.preview}/${name}`));
    return this.#read.get(name) ?? null;
  }

  /**
   * Return where a pointer is in the picture.
   * @param {MouseEvent} event
   * @returns {Point}
   */
  pixel(event) {
    const matrix = this.drawing.getScreenCTM();
    if (!matrix) return [0, 0];
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
    return [Math.round(point.x * 10) / 10, Math.round(point.y * 10) / 10];
  }

  /**
   * Mark a slab or a refused blob.
   * @param {string} which a selector in the overlay; empty for none
   */
  choose(which) {
    for (const group of this.picture.overlay.querySelectorAll("g")) group.classList.toggle("chosen", which !== "" && group.matches(which));
  }
}

/**
 * @param {Json | null} found
 * @returns {[SVGElement[], string]}
 */
function contours(found) {
  const blobs = found?.blobs ?? [];
  const paths = blobs.map((/** @type {Json} */ blob) => {
    const path = svg("path", { class: blob.touches_rim ? "contour at-rim" : "contour", d: outline(blob.outline_px) });
    path.append(svg("title", {}, document.createTextNode(`${blob.blob}: ${blob.area_px} px²`)));
    return path;
  });
  return [paths, ""];
}

/**
 * Draw how far from each slab's outline its edges were measured: a whisker outward or inward, a cross where was none.
 * @param {Json | null} found
 * @param {number} width
 * @returns {[SVGElement[], string]}
 */
function residuals(found, width) {
  /** @type {{pixels: Point[], outward_mm: (number | null)[]}[]} */
  const parts = found?.parts ?? [];
  const worst = Math.max(0.02, ...parts.flatMap((part) => part.outward_mm.map((value) => Math.abs(value ?? 0))));
  const long = (width * WHISKER) / worst;
  const groups = parts.map(({ pixels, outward_mm }) => {
    const turn = Math.sign(pixels.reduce((sum, [u, v], index) => sum + cross([u, v], pixels[(index + 1) % pixels.length]), 0)) || 1;
    const marks = pixels.map(([u, v], index) => {
      const value = outward_mm[index];
      if (value === null) return svg("path", { class: "no-edge", d: `M${u - 4} ${v - 4}L${u + 4} ${v + 4}M${u - 4} ${v + 4}L${u + 4} ${v - 4}` });
      const [before, after] = [pixels.at(index - 1) ?? [u, v], pixels[(index + 1) % pixels.length]];
      const along = [after[0] - before[0], after[1] - before[1]];
      const length = Math.hypot(along[0], along[1]) || 1;
      const [x, y] = [(turn * along[1] * value * long) / length, (-turn * along[0] * value * long) / length];
      const mark = svg("line", { class: value < 0 ? "inward" : "outward", x1: u, y1: v, x2: u + x, y2: v + y });
      mark.append(svg("title", {}, document.createTextNode(`${value.toFixed(3)} mm`)));
      return mark;
    });
    return svg("g", { class: "residuals" }, ...marks);
  });
  return [groups, parts.length ? `${word("whiskers", { times: Math.round(long) })} ${word("no_edge")}` : ""];
}

/**
 * @param {Point} one
 * @param {Point} other
 */
function cross(one, other) {
  return one[0] * other[1] - one[1] * other[0];
}
