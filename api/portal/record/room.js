// Connection to a recording: a WebSocket to `/v1/recordings/ID/connect` that is opened again whenever it is lost.

const AGAIN_MS = [500, 1000, 2000, 5000];
const SUBPROTOCOL = "multicap.recording";
const LINK_SUBPROTOCOL = "mc.link.";
const MAX_WAITING_BYTES = 100_000; // in the browser, beyond which pictures are left out

/**
 * Connection of a phone, with the secret of its link, or of a host, by the browser's session.
 *
 * Events, as `CustomEvent` with `detail`: `open`; `message` (an object); `bytes` (an ArrayBuffer); `away` whenever the connection is
 * lost or is not to be had, with `{ code, reason }` of the WebSocket.
 */
export class RoomConnection extends EventTarget {
  #socket = null;
  #numFailures = 0;
  #timer = 0;
  #isClosed = false;

  constructor(recordingId, secret = null) {
    super();
    this.address = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/v1/recordings/${encodeURIComponent(recordingId)}/connect`;
    this.protocols = [SUBPROTOCOL, ...(secret === null ? [] : [`${LINK_SUBPROTOCOL}${secret}`])];
    this.#open();
    addEventListener("online", this.#now);
  }

  get isOpen() {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  /** Send a message; false if there is no connection. */
  send(message) {
    if (this.isOpen) this.#socket.send(JSON.stringify(message));
    return this.isOpen;
  }

  /** Send a picture, unless others still wait. */
  sendPicture(blob) {
    if (this.isOpen && this.#socket.bufferedAmount < MAX_WAITING_BYTES) this.#socket.send(blob);
  }

  /** Connect again. */
  again() {
    this.#numFailures = 0;
    this.#socket.close();
  }

  close() {
    this.#isClosed = true;
    clearTimeout(this.#timer);
    removeEventListener("online", this.#now);
    this.#socket.close();
  }

  #now = () => {
    if (this.#socket.readyState !== WebSocket.CLOSED) return;
    clearTimeout(this.#timer);
    this.#open();
  };

  #open() {
    this.#socket = new WebSocket(this.address, this.protocols);
    this.#socket.binaryType = "arraybuffer";
    this.#socket.addEventListener("open", () => this.#tell("open"));
    this.#socket.addEventListener("message", ({ data }) => (typeof data === "string" ? this.#hear(JSON.parse(data)) : this.#tell("bytes", data)));
    this.#socket.addEventListener("close", ({ code, reason }) => {
      if (this.#isClosed) return;
      this.#timer = setTimeout(() => this.#open(), AGAIN_MS[Math.min(this.#numFailures, AGAIN_MS.length - 1)]);
      this.#numFailures += 1;
      this.#tell("away", { code, reason });
    });
  }

  // The service refuses by a message: only another one tells that it is there.
  #hear(message) {
    if (message.type !== "problem") this.#numFailures = 0;
    this.#tell("message", message);
  }

  #tell(type, detail) {
    if (!this.#isClosed) this.dispatchEvent(new CustomEvent(type, { detail }));
  }
}

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
export function keptJoin(recordingId) {
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

/** True if an address can be opened on this machine alone. */
export const isOfThisMachine = (url) => ["localhost", "127.0.0.1", "[::1]"].includes(new URL(url).hostname);

// Names of phones and takes as the service takes them: on one line, without invisible characters and slashes.

const MAX_LENGTH = 64;

/** Name that was typed, as it can be sent; empty if nothing of it can. */
export function cleanName(text, maxLength = MAX_LENGTH) {
  const name = text.replace(/[\s\p{Z}]+/gu, " ").replace(/\p{C}/gu, "").replace(/[/\\]/g, "-").trim();
  return /^[ .]*$/.test(name) ? "" : [...name].slice(0, maxLength).join("").trim();
}
