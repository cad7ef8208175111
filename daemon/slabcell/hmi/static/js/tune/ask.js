// @ts-check
// How does the page ask the HMI?  JSON there and back; what fails is said where all messages are.
import { say } from "../messages.js";

/** @typedef {Record<string, any>} Json */

const form = JSON.parse(document.body.getAttribute("hx-headers") ?? "{}");

/**
 * Have something done; null if it failed, which was said then.
 * @param {string} path
 * @param {Json | Blob} content
 * @returns {Promise<Json | null>}
 */
export async function post(path, content) {
  const file = content instanceof Blob;
  const headers = { ...form, "HX-Request": "true", "Content-Type": file ? "application/octet-stream" : "application/json" };
  return answered(fetch(path, { method: "POST", headers, body: file ? content : JSON.stringify(content) }));
}

/**
 * Read something; null if it failed, which was said then.
 * @param {string} path
 * @returns {Promise<Json | null>}
 */
export async function get(path) {
  return answered(fetch(path, { headers: { "HX-Request": "true" } }));
}

/** @param {Promise<Response>} asked */
async function answered(asked) {
  try {
    const answer = await asked;
    if (answer.ok) return await answer.json();
    const login = answer.headers.get("hx-redirect");
    if (login) location.assign(login);
    const said = JSON.parse(answer.headers.get("hx-trigger") ?? "{}")["slab:say"];
    say("failed", said?.text ?? `${answer.status} ${answer.statusText}`);
  } catch {
    say("failed", document.getElementById("link-lost")?.dataset.pageLost ?? "");
  }
  return null;
}

/**
 * Wait for a task of the cell; null if it cannot be asked for any more.
 * @param {string} name
 * @param {(task: Json) => void} progress
 */
export async function follow(name, progress) {
  for (;;) {
    const task = await get(`/tune/tasks/${name}`);
    if (!task) return null;
    progress(task);
    if (task.state !== "running") return task;
    await new Promise((done) => setTimeout(done, 500));
  }
}
