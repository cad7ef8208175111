// @ts-check
// Where on the pattern is a finding?  A click on it, in the list or on the picture, shows its place; files are sent here.
import { say } from "./messages.js";

const view = /** @type {HTMLElement} */ (document.getElementById("view"));
const headers = JSON.parse(document.body.getAttribute("hx-headers") ?? "{}");

/**
 * Show one finding, or the whole pattern.
 * @param {string} number of the finding; empty for none
 */
function focus(number) {
  const pattern = view.querySelector("svg.pattern");
  /** @type {string | undefined} */
  let box;
  for (const button of /** @type {NodeListOf<HTMLElement>} */ (view.querySelectorAll("button[data-finding]"))) {
    const chosen = button.dataset.finding === number;
    button.setAttribute("aria-pressed", String(chosen));
    if (chosen) {
      box = button.dataset.box;
      button.scrollIntoView({ block: "nearest" });
    }
  }
  for (const mark of view.querySelectorAll("g[data-finding]")) {
    mark.classList.toggle("chosen", mark.getAttribute("data-finding") === number);
  }
  const whole_box = pattern?.getAttribute("data-whole") ?? "";
  pattern?.setAttribute("viewBox", box ?? whole_box);
  // Marks stay as large as they are, whatever is shown.
  const widths = [box ?? whole_box, whole_box].map((text) => Number(text.split(" ")[2]));
  const scale = widths[0] / widths[1];
  for (const flag of view.querySelectorAll("svg.pattern .flag")) {
    const [x, y] = ["cx", "cy"].map((name) => Number(flag.firstElementChild?.getAttribute(name)) * (1 - scale));
    flag.setAttribute("transform", `translate(${x} ${y}) scale(${scale})`);
  }
  const whole = /** @type {HTMLButtonElement | null} */ (view.querySelector("#whole"));
  if (whole) whole.disabled = box === undefined;
}

view.addEventListener("click", (event) => {
  const target = event.target instanceof Element ? event.target : null;
  if (target?.closest("#whole")) focus("");
  const found = target?.closest("[data-finding]");
  if (found) focus(found.getAttribute("data-finding") ?? "");
});
view.addEventListener("keydown", (event) => {
  if (event.key === "Escape") focus("");
});

let wasSent = false;
view.addEventListener("htmx:beforeSwap", (event) => {
  // The recipe that was asked for when the page was loaded comes too late once a file was sent.
  const detail = /** @type {CustomEvent} */ (event).detail;
  if (wasSent && detail.target === view) detail.shouldSwap = false;
});

const form = /** @type {HTMLFormElement | null} */ (document.getElementById("send"));
form?.addEventListener("change", (event) => {
  const file = event.target instanceof HTMLInputElement ? event.target.files?.[0] : undefined;
  const name = document.getElementById("file-name");
  if (name && file) name.textContent = `${file.name} · ${Math.ceil(file.size / 1024)} KiB`;
});
form?.addEventListener("submit", (event) => {
  event.preventDefault();
  void send(form);
});

/**
 * Send the chosen file as it is, and show what is found about it.
 * @param {HTMLFormElement} from
 */
async function send(from) {
  const fields = new FormData(from);
  const file = fields.get("file");
  if (!(file instanceof File)) return;
  if (file.size > Number(from.dataset.most)) {
    say("failed", from.dataset.tooLarge ?? "");
    return;
  }
  const query = new URLSearchParams({ file: file.name.slice(-100) });
  for (const name of ["unit", "layers", "recipe"]) query.set(name, String(fields.get(name) ?? ""));
  const button = /** @type {HTMLButtonElement} */ (from.querySelector("button"));
  button.disabled = true;
  wasSent = true;
  try {
    const sent = { ...headers, "HX-Request": "true", "Content-Type": "application/octet-stream" };
    const answer = await fetch(`/templates/check?${query}`, { method: "POST", headers: sent, body: file });
    if (answer.ok) {
      view.innerHTML = await answer.text();
      /** @type {any} */ (window).htmx.process(view);
      view.focus();
    } else {
      const said = JSON.parse(answer.headers.get("hx-trigger") ?? "{}")["slab:say"];
      say("failed", said?.text ?? `${answer.status} ${answer.statusText}`);
    }
  } catch {
    say("failed", document.getElementById("link-lost")?.dataset.pageLost ?? "");
  } finally {
    button.disabled = false;
  }
}
