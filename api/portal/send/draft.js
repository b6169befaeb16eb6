// The capture that is being put together, kept over a reload: all but the files, which the browser does not keep.

const KEY = "multicap.draft";

export const FACTS = ["name", "size", "modified", "kind", "numFrames", "camera", "isUsed", "isJoined", "offset_s", "rate", "url", "sent", "isSent"];

export function emptyDraft(kept = {}) {
  return { name: "", calibrationId: null, clock: "declared", frameRate_hz: null, layout: null, spec: {}, rows: [], wasSending: false, request: null, sessionId: null, ...kept };
}

export function loadDraft() {
  const stored = storedDraft();
  return stored?.rows ? { ...emptyDraft(), ...stored, rows: stored.rows.map((row) => rowOf(row)) } : emptyDraft();
}

function storedDraft() {
  try {
    return JSON.parse(localStorage.getItem(KEY));
  } catch {
    return null; // storage is off, or holds something else
  }
}

export function saveDraft(draft) {
  const rows = draft.rows.map((row) => Object.fromEntries(FACTS.map((fact) => [fact, row[fact]])));
  try {
    localStorage.setItem(KEY, JSON.stringify({ ...draft, rows }));
  } catch { /* storage is off or full: the draft does not outlive the page */ }
}

// Row of the table of files. `file` is null after a reload, until the same file is chosen again.
export function rowOf(facts, file = null) {
  return {
    camera: null, isUsed: true, isJoined: false, offset_s: 0, rate: null, url: null, sent: 0, isSent: false, ...facts,
    file, preview: facts.kind === "video" && file?.type.startsWith("video/") ? URL.createObjectURL(file) : null, hasFailed: false, isActive: false,
  };
}

// A row may have the name of a file with its folders before.
export const isSame = (row, file) => row.name.endsWith(file.name) && row.size === file.size && row.modified === file.lastModified;
