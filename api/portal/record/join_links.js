// Links by which phones join, which the service tells once: this browser keeps them for its own recordings.

const KEY = "multicap.recordings";
const MAX_KEPT = 20;

function kept() {
  try {
    return JSON.parse(localStorage.getItem(KEY)) ?? {};
  } catch {
    return {};
  }
}

/** Link of a recording, as the service made it; null if this browser has none, or it has ended. */
export function joinOf(recordingId) {
  const join = kept()[recordingId];
  return join && new Date(join.expires_at) > new Date() ? join : null;
}

/** Keep a link; null forgets it. */
export function keepJoin(recordingId, join) {
  const { [recordingId]: _, ...others } = kept();
  const entries = [...Object.entries(others), ...(join ? [[recordingId, join]] : [])];
  try {
    localStorage.setItem(KEY, JSON.stringify(Object.fromEntries(entries.slice(-MAX_KEPT))));
  } catch { /* storage is off: a reload needs another link */ }
}

/** Whether an address can be opened on this machine alone. */
export const isOfThisMachine = (url) => ["localhost", "127.0.0.1", "[::1]"].includes(new URL(url).hostname);
