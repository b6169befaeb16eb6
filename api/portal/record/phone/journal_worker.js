// Worker that keeps recordings in the browser's own file system (OPFS), so that neither a reload nor a dead network loses them.
//
// A part of a take is a folder with `video`, the bytes so far, and `journal`, a line of JSON a fact. Handles for synchronous access
// write in place and flush: what was appended is there after the tab was killed. Pages have no such handles, workers have.

import { PHONE } from "../../shared/strings/phone.js";
import { parseJournal } from "./journal.js";

const FOLDER = "multicap-takes";
const open = new Map(); // handles by key, of the parts that are recorded now
const encoder = new TextEncoder();

async function root() {
  return (await navigator.storage.getDirectory()).getDirectoryHandle(FOLDER, { create: true });
}

async function openHandle(folder, name) {
  return (await folder.getFileHandle(name, { create: true })).createSyncAccessHandle();
}

function write(handle, bytes) {
  const at = handle.getSize();
  const written = handle.write(bytes, { at });
  if (written < bytes.byteLength) {
    handle.truncate(at);
    throw new Error(PHONE.storageFull);
  }
  handle.flush();
}

// Write a line; of a part that is not recorded any more the journal is opened for it alone.
async function note(key, fact) {
  const line = encoder.encode(`${JSON.stringify(fact)}\n`);
  const handles = open.get(key);
  if (handles) return write(handles.journal, line);
  const journal = await openHandle(await (await root()).getDirectoryHandle(key), "journal");
  try {
    write(journal, line);
  } finally {
    journal.close();
  }
}

const ACTIONS = {
  async begin({ key, fact }) {
    const folder = await (await root()).getDirectoryHandle(key, { create: true });
    open.set(key, { video: await openHandle(folder, "video"), journal: await openHandle(folder, "journal") });
    await note(key, fact);
  },
  // The bytes first: a line tells only of bytes that are there.
  async append({ key, bytes, fact }) {
    write(open.get(key).video, new Uint8Array(bytes));
    await note(key, fact);
  },
  async note({ key, fact }) {
    await note(key, fact);
  },
  async end({ key, fact }) {
    await note(key, fact);
    for (const handle of Object.values(open.get(key))) handle.close();
    open.delete(key);
  },
  async list() {
    const found = [];
    for await (const [key, folder] of (await root()).entries()) {
      const [journal, video] = await Promise.all(["journal", "video"].map((name) => folder.getFileHandle(name).then((handle) => handle.getFile(), () => null)));
      found.push({ key, isOpen: open.has(key), numBytes: video?.size ?? 0, facts: parseJournal(journal ? await journal.text() : "") });
    }
    return found;
  },
  async remove({ key }) {
    for (const handle of Object.values(open.get(key) ?? {})) handle.close();
    open.delete(key);
    await (await root()).removeEntry(key, { recursive: true }).catch(() => null);
  },
};

// One after the other: pieces are appended in the order in which they come.
let last = Promise.resolve();
addEventListener("message", ({ data: { id, action, ...rest } }) => {
  last = last.then(() => ACTIONS[action](rest)).then((answer) => postMessage({ id, answer }), (error) => postMessage({ id, error: error.message }));
});
