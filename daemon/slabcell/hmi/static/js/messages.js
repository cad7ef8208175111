// @ts-check
// What came of what was asked for?  Shows the server's answer, until it is closed or after a time.

const STAYS_MS = 8000;

/**
 * Show a message; a failure stays until it is closed.
 * @param {string} kind "done" or "failed"
 * @param {string} text
 */
export function say(kind, text) {
  const room = document.getElementById("messages");
  if (!room) return;
  const message = document.createElement("div");
  message.className = `message ${kind}`;
  if (kind === "failed") message.setAttribute("role", "alert");
  const words = document.createElement("span");
  words.textContent = text;
  const close = document.createElement("button");
  close.type = "button";
  close.textContent = room.dataset.close ?? "×";
  close.addEventListener("click", () => message.remove());
  message.append(words, close);
  room.append(message);
  while (room.childElementCount > 4) room.firstElementChild?.remove();
  if (kind !== "failed") setTimeout(() => message.remove(), STAYS_MS);
}

/** Begin to listen. */
export function startMessages() {
  document.body.addEventListener("slab:say", (event) => {
    const { kind, text } = /** @type {CustomEvent} */ (event).detail;
    say(kind, text);
  });
  document.body.addEventListener("htmx:sendError", () => {
    const banner = document.getElementById("link-lost");
    say("failed", banner?.dataset.pageLost ?? "");
  });
}
