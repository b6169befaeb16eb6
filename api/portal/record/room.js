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

  /** Connect anew. */
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
