// @ts-check
// What does the cell do right now?  One WebSocket to the HMI: beats, kinds of changes, camera pictures.
//
// Each kind of change becomes an event slab:KIND on the body, on which parts of a page reload themselves (hx-trigger).
// Without a beat for three seconds what is shown is old: the page is greyed, its age counts, its buttons are off.
import { duration } from "./ages.js";

const SILENCE_MS = 3000;
const RETRY_MS = 1000;

/** @typedef {{frame: string, width: number, height: number, age_s: number, overlay: object | null}} PictureDocument */
/** @typedef {(document: PictureDocument, jpeg: Blob) => void} Viewer */

/** @type {Set<Viewer>} */
const viewers = new Set();
/** @type {WebSocket | null} */
let socket = null;
/** @type {PictureDocument | null} */
let announced = null;
let beat_ms = performance.now();
let heard_ms = performance.now();
let up = true;
let tooMany = false;
let wasLost = false;

/**
 * Show every new camera picture with a viewer, while it is in the page.
 * @param {Viewer} viewer
 * @returns {() => void} ends it
 */
export function watch(viewer) {
  viewers.add(viewer);
  ask();
  return () => viewers.delete(viewer);
}

function ask() {
  if (viewers.size > 0 && socket?.readyState === WebSocket.OPEN) socket.send("picture");
}

/** @param {string} kind */
function tell(kind) {
  document.body.dispatchEvent(new CustomEvent(`slab:${kind}`, { bubbles: false }));
}

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const opened = new WebSocket(`${scheme}://${location.host}/live`);
  socket = opened;
  opened.binaryType = "blob";
  opened.addEventListener("open", ask);
  opened.addEventListener("message", (event) => {
    if (typeof event.data !== "string") {
      const document_ = announced;
      announced = null;
      if (document_) for (const viewer of [...viewers]) viewer(document_, event.data);
      requestAnimationFrame(ask);  // the credit for the next one: not before this one is drawn
      return;
    }
    const message = JSON.parse(event.data);
    if (message.picture) {
      announced = message.picture;
      return;
    }
    beat_ms = performance.now();
    up = message.beat;
    tooMany = false;
    if (up) heard_ms = beat_ms - 1000 * (message.age_s ?? 0);
    if (wasLost && up) {
      wasLost = false;
      tell("reset");
    }
    for (const kind of message.kinds) tell(kind);
    show();
  });
  opened.addEventListener("close", (event) => {
    tooMany = event.code === 1013;
    announced = null;
    if (event.code === 1008) tell("reset");  // the login ended: the next request leads to the login page
    setTimeout(connect, RETRY_MS);
  });
}

/** Grey the page or not, and turn off what cannot be done. */
function show() {
  const silent = performance.now() - beat_ms > SILENCE_MS;
  const lost = silent || !up;
  if (lost) wasLost = true;
  document.body.classList.toggle("stale", lost);
  const banner = document.getElementById("link-lost");
  if (banner) {
    banner.hidden = !lost;
    if (lost) {
      const words = banner.dataset;
      const what = banner.querySelector(".what");
      const age = banner.querySelector(".lost-age");
      if (what) what.textContent = (tooMany ? words.tooMany : silent ? words.pageLost : words.cellLost) ?? "";
      if (age) age.textContent = `(${duration((performance.now() - heard_ms) / 1000)})`;
    }
  }
  for (const element of /** @type {NodeListOf<HTMLButtonElement>} */ (document.querySelectorAll("button[data-needs-cell]"))) {
    if (lost && !element.disabled) {
      element.disabled = true;
      element.dataset.offWhileLost = "";
    } else if (!lost && "offWhileLost" in element.dataset) {
      element.disabled = false;
      delete element.dataset.offWhileLost;
    }
  }
}

/** Connect, and stay connected. */
export function startLive() {
  connect();
  setInterval(show, 500);
  document.body.addEventListener("htmx:afterSwap", show);
}
