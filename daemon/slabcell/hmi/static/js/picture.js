// @ts-check
// How is a picture shown?  With its overlay as SVG in pixels of the picture, to zoom and to move by mouse, finger and keys.
//
// <slab-picture live> shows the camera; <slab-picture src="…" overlay="…"> a file and the JSON of what was found in it.
// The centre of the top-left pixel is 0, 0: the SVG's view box begins half a pixel before it.
import { duration } from "./ages.js";
import { watch } from "./live.js";

const SVG = "http://www.w3.org/2000/svg";
const MAX_SCALE = 16;
/** More refused blobs than these have their reason in their title only: their words would cover the picture. */
const MAX_NAMED = 20;

/** @typedef {[number, number]} Point */
/** @typedef {{slot: number, score: number, image: {u: number, v: number, angle_deg: number}, outline_px?: Point[]}} Part */
/** @typedef {{reason: string, detail: string, image: {u: number, v: number}, outline_px?: Point[]}} Rejected */
/** @typedef {{parts: Part[], rejected: Rejected[]}} Overlay */

/**
 * Return an SVG element.
 * @param {string} name
 * @param {Record<string, string | number>} attributes
 * @param {Node[]} children
 */
export function svg(name, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  element.append(...children);
  return element;
}

/** @param {Point[]} points */
export const outline = (points) => (points.length ? `M${points.map(([u, v]) => `${u} ${v}`).join("L")}Z` : "");

export class SlabPicture extends HTMLElement {
  #view = document.createElement("div");
  #stage = document.createElement("div");
  #image = document.createElement("img");
  #overlay = /** @type {SVGSVGElement} */ (svg("svg", { class: "overlay", role: "img" }));
  #said = document.createElement("span");
  #nothing = document.createElement("div");
  #size = { width: 0, height: 0 };
  #at = { x: 0, y: 0, scale: 1, fits: true };
  #taken_ms = 0;
  #url = "";
  #built = false;
  /** @type {Map<number, PointerEvent>} */
  #pointers = new Map();
  /** @type {(() => void)[]} */
  #ends = [];

  static get observedAttributes() {
    return ["src", "overlay"];
  }

  connectedCallback() {
    if (!this.#built) this.#build();
    const resized = new ResizeObserver(() => this.#at.fits && this.fit());
    resized.observe(this.#view);
    this.#ends.push(() => resized.disconnect());
    if (this.hasAttribute("live")) {
      this.#ends.push(watch((document_, jpeg) => void this.#show(document_, jpeg)));
      const timer = setInterval(() => this.#tellAge(), 1000);
      this.#ends.push(() => clearInterval(timer));
    }
  }

  disconnectedCallback() {
    for (const end of this.#ends.splice(0)) end();
    if (this.#url) URL.revokeObjectURL(this.#url);
    this.#url = "";
  }

  attributeChangedCallback() {
    if (this.getAttribute("src")) void this.#load();
  }

  #build() {
    this.#built = true;
    this.#view.className = "view";
    this.#view.tabIndex = 0;
    this.#view.setAttribute("role", "group");
    this.#view.setAttribute("aria-label", this.dataset.label ?? "");
    this.#stage.className = "stage";
    this.#image.alt = "";
    this.#image.draggable = false;
    this.#nothing.className = "nothing";
    this.#nothing.textContent = this.dataset.none ?? "";
    this.#stage.append(this.#image, this.#overlay);
    this.#stage.hidden = true;
    this.#view.append(this.#stage, this.#nothing);
    const tools = document.createElement("div");
    tools.className = "tools";
    this.#said.className = "said";
    tools.append(
      this.#said,
      this.#tool("−", this.dataset.smaller, () => this.zoom(1 / 1.5)),
      this.#tool("+", this.dataset.larger, () => this.zoom(1.5)),
      this.#tool(this.dataset.fit ?? "", this.dataset.fit, () => this.fit()),
    );
    this.append(this.#view, tools);
    this.#listen();
  }

  /**
   * @param {string} text
   * @param {string | undefined} label
   * @param {() => void} action
   */
  #tool(text, label, action) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = text;
    button.setAttribute("aria-label", label ?? text);
    button.addEventListener("click", action);
    return button;
  }

  // Content

  /**
   * @param {import("./live.js").PictureDocument} document_
   * @param {Blob} jpeg
   */
  async #show(document_, jpeg) {
    const url = URL.createObjectURL(jpeg);
    const before = this.#url;
    this.#url = url;
    this.#taken_ms = performance.now() - 1000 * document_.age_s;
    this.#image.src = url;
    await this.#image.decode().catch(() => undefined);
    if (before) URL.revokeObjectURL(before);
    this.#resize(document_.width, document_.height);
    this.dataset.frame = document_.frame;  // who draws over it has to know which one it is
    this.draw(/** @type {Overlay | null} */ (document_.overlay));
    this.#tellAge();
  }

  async #load() {
    if (!this.#built) this.#build();
    const src = this.getAttribute("src") ?? "";
    const overlay = this.getAttribute("overlay");
    this.#image.src = src;
    const [found] = await Promise.all([
      overlay ? fetch(overlay).then((answer) => (answer.ok ? answer.json() : null)) : Promise.resolve(null),
      this.#image.decode().catch(() => undefined),
    ]);
    if (src !== this.getAttribute("src")) return;
    if (!this.#image.naturalWidth) return;
    this.#resize(this.#image.naturalWidth, this.#image.naturalHeight);
    this.draw(found);
  }

  /**
   * Show a file that may be reduced, of a picture of so many pixels; false if another one was asked for meanwhile.
   * @param {string} src
   * @param {{width: number, height: number}} size
   * @param {Overlay | null} overlay
   */
  async present(src, size, overlay) {
    if (!this.#built) this.#build();
    if (this.#image.getAttribute("src") !== src) {
      this.#image.src = src;
      await this.#image.decode().catch(() => undefined);
      if (this.#image.getAttribute("src") !== src) return false;
    }
    this.#resize(size.width, size.height);
    this.draw(overlay);
    return true;
  }

  /**
   * @param {number} width
   * @param {number} height
   */
  #resize(width, height) {
    this.#nothing.hidden = true;
    this.#stage.hidden = false;
    if (width === this.#size.width && height === this.#size.height) return;
    this.#size = { width, height };
    this.#stage.style.width = `${width}px`;
    this.#stage.style.height = `${height}px`;
    this.#overlay.setAttribute("viewBox", `-0.5 -0.5 ${width} ${height}`);
    this.fit();
  }

  /**
   * Draw what was found.
   * @param {Overlay | null} overlay
   */
  draw(overlay) {
    const text = this.#size.width / 36;
    const reasons = JSON.parse(this.dataset.reasons ?? "{}");
    const named = (overlay?.rejected.length ?? 0) <= MAX_NAMED;
    const groups = (overlay?.rejected ?? []).map((item, index) => {
      const reason = reasons[item.reason] ?? item.reason;
      const path = outline(item.outline_px ?? []);
      return svg(
        "g",
        { class: "rejected", "data-index": index },
        svg("title", {}, document.createTextNode(`${(this.dataset.rejected ?? "").replace("{reason}", reason)} ${item.detail}`)),
        svg("path", { class: "under", d: path }),
        svg("path", { d: path }),
        ...(named ? [svg("text", { x: item.image.u, y: item.image.v, "font-size": text * 0.7 }, document.createTextNode(reason))] : []),
      );
    });
    for (const part of overlay?.parts ?? []) {
      const path = outline(part.outline_px ?? []);
      const { u, v, angle_deg } = part.image;
      const angle = (-angle_deg * Math.PI) / 180;
      const title = (this.dataset.part ?? "").replace("{slot}", String(part.slot)).replace("{score}", part.score.toFixed(3));
      groups.push(
        svg(
          "g",
          { class: "part", "data-slot": part.slot },
          svg("title", {}, document.createTextNode(title)),
          svg("path", { class: "under", d: path }),
          svg("path", { d: path }),
          svg("line", { class: "axis", x1: u, y1: v, x2: u + 2 * text * Math.cos(angle), y2: v + 2 * text * Math.sin(angle) }),
          svg("circle", { cx: u, cy: v, r: text / 8, fill: "#fff" }),
          svg("text", { x: u, y: v - text, "font-size": text }, document.createTextNode(String(part.slot))),
        ),
      );
    }
    this.#overlay.setAttribute("aria-label", `${this.dataset.label ?? ""}: ${overlay?.parts.length ?? 0} ${this.dataset.found ?? ""}, ${overlay?.rejected.length ?? 0} ${this.dataset.refused ?? ""}`);
    this.#overlay.replaceChildren(...groups);
    this.dispatchEvent(new CustomEvent("slab:drawn"));
  }

  /** The SVG over the picture, for pages that draw into it. */
  get overlay() {
    return this.#overlay;
  }

  #tellAge() {
    if (!this.#taken_ms) return;
    const age = duration((performance.now() - this.#taken_ms) / 1000);
    this.#said.textContent = (this.dataset.taken ?? "{age}").replace("{age}", age);
  }

  // Zoom and move

  /** Show the whole picture. */
  fit() {
    const { clientWidth, clientHeight } = this.#view;
    const { width, height } = this.#size;
    if (!width || !clientWidth || !clientHeight) return;
    const scale = Math.min(clientWidth / width, clientHeight / height);
    this.#place({ scale, x: (clientWidth - width * scale) / 2, y: (clientHeight - height * scale) / 2, fits: true });
  }

  /**
   * Zoom about a point of the view, its middle if none is named.
   * @param {number} factor
   * @param {number} [x]
   * @param {number} [y]
   */
  zoom(factor, x = this.#view.clientWidth / 2, y = this.#view.clientHeight / 2) {
    const at = this.#at;
    const smallest = Math.min(this.#view.clientWidth / this.#size.width, this.#view.clientHeight / this.#size.height);
    const scale = Math.min(MAX_SCALE, Math.max(smallest, at.scale * factor));
    if (scale <= smallest) return this.fit();
    const by = scale / at.scale;
    return this.#place({ scale, x: x - (x - at.x) * by, y: y - (y - at.y) * by, fits: false });
  }

  /** @param {{x: number, y: number, scale: number, fits: boolean}} at */
  #place(at) {
    this.#at = at;
    this.#stage.style.transform = `translate(${at.x}px, ${at.y}px) scale(${at.scale})`;
    this.#stage.style.setProperty("--px", String(1 / at.scale));
    this.#image.style.imageRendering = at.scale > 2 ? "pixelated" : "auto";
  }

  #listen() {
    const view = this.#view;
    /** @param {MouseEvent} event */
    const place = (event) => {
      const box = view.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    view.addEventListener("wheel", (event) => {
      event.preventDefault();
      const [x, y] = place(event);
      this.zoom(Math.exp(-event.deltaY / 400), x, y);
    }, { passive: false });
    view.addEventListener("pointerdown", (event) => {
      if (event.defaultPrevented) return;
      view.setPointerCapture(event.pointerId);
      this.#pointers.set(event.pointerId, event);
    });
    view.addEventListener("pointermove", (event) => {
      const before = this.#pointers.get(event.pointerId);
      if (!before) return;
      const other = [...this.#pointers.values()].find((pointer) => pointer.pointerId !== event.pointerId);
      if (other) {
        const was = Math.hypot(before.clientX - other.clientX, before.clientY - other.clientY);
        const is = Math.hypot(event.clientX - other.clientX, event.clientY - other.clientY);
        const [x, y] = place(event);
        if (was > 0) this.zoom(is / was, x, y);
      } else if (!this.#at.fits) {
        this.#place({ ...this.#at, x: this.#at.x + event.clientX - before.clientX, y: this.#at.y + event.clientY - before.clientY });
      }
      this.#pointers.set(event.pointerId, event);
    });
    for (const end of ["pointerup", "pointercancel"]) {
      view.addEventListener(end, (event) => this.#pointers.delete(/** @type {PointerEvent} */ (event).pointerId));
    }
    view.addEventListener("dblclick", () => this.fit());
    view.addEventListener("keydown", (event) => {
      const step = 60;
      /** @type {Record<string, () => void>} */
      const keys = {
        "+": () => this.zoom(1.25),
        "-": () => this.zoom(0.8),
        "0": () => this.fit(),
        ArrowLeft: () => this.#place({ ...this.#at, x: this.#at.x + step }),
        ArrowRight: () => this.#place({ ...this.#at, x: this.#at.x - step }),
        ArrowUp: () => this.#place({ ...this.#at, y: this.#at.y + step }),
        ArrowDown: () => this.#place({ ...this.#at, y: this.#at.y - step }),
      };
      const action = keys[event.key];
      if (action && event.target === view) {
        event.preventDefault();
        action();
      }
    });
  }
}

customElements.define("slab-picture", SlabPicture);
