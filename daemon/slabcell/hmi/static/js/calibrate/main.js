// @ts-check
// Where is the board, now?  Takes pictures on request or on and on, and draws what was found over them, in their pixels.
import { outline, SlabPicture, svg } from "../picture.js";
import { say } from "../messages.js";

/** @typedef {{frame: string, found: boolean, points: [number, number, number][], problem: string, note: string}} Seen */

const PAUSE_MS = 600;

const form = JSON.parse(document.body.getAttribute("hx-headers") ?? "{}");
const picture = /** @type {SlabPicture | null} */ (document.getElementById("board-picture"));
const said = document.getElementById("said");
const step = /** @type {HTMLFormElement | null} */ (document.getElementById("step"));
const watch = document.getElementById("watch");
/** @type {Seen | null} */
let seen = null;
let looking = false;

/**
 * Ask for JSON; null if it was refused, which was said then, or "later" if it may come right by itself.
 * @param {string} path
 * @param {RequestInit} [how]
 * @param {boolean} [patient] say nothing of what may come right by itself
 */
async function ask(path, how = {}, patient = false) {
  try {
    const answer = await fetch(path, { ...how, headers: { ...form, "HX-Request": "true", ...how.headers } });
    if (answer.ok) return await answer.json();
    const login = answer.headers.get("hx-redirect");
    if (login) location.assign(login);
    if (patient && answer.status === 503) return "later";
    say("failed", JSON.parse(answer.headers.get("hx-trigger") ?? "{}")["slab:say"]?.text ?? String(answer.status));
  } catch {
    say("failed", document.getElementById("link-lost")?.dataset.pageLost ?? "");
  }
  return null;
}

/**
 * Take a picture and find the board; false if that was refused.
 * @param {boolean} [patient]
 */
async function look(patient = false) {
  if (!step || !said || looking) return true;
  looking = true;
  const fields = new URLSearchParams();
  for (const [name, value] of new FormData(step)) fields.set(name, String(value));
  const found = /** @type {Seen | null | "later"} */ (await ask("/calibrate/look", { method: "POST", body: fields }, patient));
  looking = false;
  if (!found || found === "later") return found === "later";
  seen = found;
  const words = JSON.parse(said.dataset.words ?? "{}");
  said.textContent = found.found
    ? `✓ ${words.points_found.replace("{points}", String(found.points.length))} ${found.note}`
    : `✗ ${words.not_found}${found.problem}`;
  said.dataset.found = String(found.found);
  draw();
  return true;
}

/** Draw the board's points, row by row, and where earlier views were. */
function draw() {
  if (!picture) return;
  picture.overlay.querySelectorAll(".board, .earlier").forEach((old) => old.remove());
  const hulls = JSON.parse(document.getElementById("hulls")?.dataset.hulls ?? "[]");
  const earlier = svg("g", { class: "earlier" });
  for (const hull of hulls) earlier.append(svg("path", { d: outline(hull) }));
  picture.overlay.append(earlier);
  if (!seen?.found || picture.dataset.frame !== seen.frame) return;
  const board = svg("g", { class: "board" });
  board.append(svg("path", { class: "under", d: `M${seen.points.map(([, u, v]) => `${u} ${v}`).join("L")}` }));
  board.append(svg("path", { d: `M${seen.points.map(([, u, v]) => `${u} ${v}`).join("L")}` }));
  for (const [number, u, v] of seen.points) {
    board.append(svg("circle", { cx: u, cy: v, r: number === 0 ? 9 : 5, class: number === 0 ? "first" : "" }));
  }
  picture.overlay.append(board);
}

async function keepLooking() {
  while (watch?.getAttribute("aria-pressed") === "true") {
    const possible = !document.hidden && !document.body.classList.contains("stale");
    if (possible && !(await look(true))) watch.setAttribute("aria-pressed", "false");
    await new Promise((done) => setTimeout(done, PAUSE_MS));
  }
}

picture?.addEventListener("slab:drawn", draw);
document.getElementById("look")?.addEventListener("click", () => void look());
step?.addEventListener("submit", (event) => {
  event.preventDefault();
  void look();
});
watch?.addEventListener("click", () => {
  const on = watch.getAttribute("aria-pressed") !== "true";
  watch.setAttribute("aria-pressed", String(on));
  if (on) void keepLooking();
});

document.getElementById("from-robot")?.addEventListener("click", async () => {
  const found = await ask("/calibrate/robot-pose", { method: "POST", body: new URLSearchParams() });
  if (found) fill(found.pose);
});

/** @param {number[]} pose */
function fill(pose) {
  const field = /** @type {HTMLInputElement | null} */ (document.getElementById("pose"));
  if (field) field.value = pose.map((value) => value.toFixed(3)).join("; ");
}

document.body.addEventListener("htmx:afterSwap", (event) => {
  const target = /** @type {CustomEvent} */ (event).detail.target;
  if (target?.id === "views") draw();
  if (target?.id === "result") target.scrollIntoView({ block: "start" });
  if (target?.id === "simulated") {
    const flange = target.querySelector(".sim")?.dataset.flange;
    if (flange) fill(JSON.parse(flange));
    if (document.getElementById("look")) void look();
  }
});

document.getElementById("upload")?.addEventListener("change", async (event) => {
  const field = /** @type {HTMLInputElement} */ (event.target);
  const file = field.files?.[0];
  if (!file) return;
  const headers = { "Content-Type": "application/json" };
  const done = await ask("/calibrate/upload", { method: "POST", headers, body: file });
  if (done) say("done", done.said);
  field.value = "";
});
