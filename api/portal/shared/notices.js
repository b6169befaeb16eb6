// Notifications of the browser about jobs that end while the page is in the background, once they are asked for.

import { hasEnded, jobState } from "./jobs.js";
import { address } from "./page.js";

const KEY = "multicap.notices";
const running = new Set(); // ids of jobs that were seen at work

/** True if the browser can notify: not of pages without TLS, nor if it was forbidden. */
export const canNotify = () => isSecureContext && "Notification" in globalThis && Notification.permission !== "denied";

/** True if notifications were asked for. */
export function notifies() {
  try {
    return canNotify() && Notification.permission === "granted" && localStorage.getItem(KEY) === "on";
  } catch {
    return false; // storage is off
  }
}

/** Begin or stop to notify; the browser asks whether it may. */
export async function setNotices(isOn) {
  if (isOn && await Notification.requestPermission() !== "granted") return;
  localStorage.setItem(KEY, isOn ? "on" : "off");
}

/** Notify of the jobs that have ended since the last call. */
export function noticeEnds(jobs) {
  for (const job of jobs) {
    if (!hasEnded(job)) running.add(job.id);
    else if (running.delete(job.id) && notifies() && document.hidden) {
      const notice = new Notification(job.session_name, { body: jobState(job).words, tag: job.id });
      notice.addEventListener("click", () => { window.focus(); location.hash = address("jobs", job.id); notice.close(); });
    }
  }
}
