// Client of live captures: a WebSocket to `/v1/live`, keypoints in, people out.

import { packKeypoints, unpackInstant } from "./packets.js";

// Browsers send no headers of a page's own with a WebSocket: the key is a subprotocol that is offered.
const [SUBPROTOCOL, KEY_SUBPROTOCOL] = ["multicap.live", "mc.key."];
// Bytes that wait in the browser, beyond which frames are left out: some seconds of a few cameras.
const MAX_WAITING_BYTES = 2 ** 20;

/** The service refused or ended a capture; `code` is of docs/problems.md. */
export class LiveRefusal extends Error {
  constructor({ code = null, detail, errors = [], hint = null }) {
    super(detail);
    Object.assign(this, { code, items: errors, hint });
  }
}

/**
 * Live capture of a page.
 *
 * Events, as `CustomEvent` with `detail`: `instant` (as `unpackInstant` gives it), `ended` (the message of the service), and
 * `refused` (a `LiveRefusal`). One of the last two comes last.
 */
export class LiveClient extends EventTarget {
  #socket;
  #ready;
  #isOver = false;
  notSent = 0; // frames that were left out because the connection is slow

  /**
   * Open a capture; `start` has the fields of the message `start` without `type` and `format`. Pages of other origins state the
   * address of the service, `wss://SERVICE/v1/live`, and a key.
   */
  constructor(start, { address = liveAddress(), key = null } = {}) {
    super();
    this.#socket = new WebSocket(address, key === null ? [] : [SUBPROTOCOL, `${KEY_SUBPROTOCOL}${key}`]);
    this.#socket.binaryType = "arraybuffer";
    this.#ready = new Promise((resolve, reject) => {
      this.addEventListener("ready", ({ detail }) => resolve(detail), { once: true });
      this.addEventListener("refused", ({ detail }) => reject(detail), { once: true });
    });
    this.#ready.catch(() => null); // the event `refused` tells of it as well
    this.#socket.addEventListener("open", () => this.#socket.send(JSON.stringify({ ...start, type: "start", format: "packed" })));
    this.#socket.addEventListener("message", ({ data }) => this.#read(data));
    this.#socket.addEventListener("close", ({ code, reason }) => this.#closed(code, reason));
  }

  /** Promise of the message `ready`. */
  get ready() {
    return this.#ready;
  }

  /** Send a camera's frame, as `packKeypoints` takes it; returns false if the connection is too slow for it. */
  send(frame) {
    if (this.#isOver || this.#socket.readyState !== WebSocket.OPEN) return false;
    if (this.#socket.bufferedAmount > MAX_WAITING_BYTES) {
      this.notSent += 1;
      return false;
    }
    this.#socket.send(packKeypoints(frame));
    return true;
  }

  /** Say that the capture is over; the last instants and `ended` still come. */
  end() {
    if (this.#socket.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify({ type: "end" }));
    else this.close();
  }

  /** Close the connection; what was to be kept is lost, and no event comes any more. */
  close() {
    this.#isOver = true;
    this.#socket.close();
  }

  #read(data) {
    if (this.#isOver) return;
    if (data instanceof ArrayBuffer) {
      this.#tell("instant", unpackInstant(data));
      return;
    }
    const { type, ...content } = JSON.parse(data);
    if (type === "problem") this.#last("refused", new LiveRefusal(content));
    else if (type === "ended") this.#last("ended", content);
    else this.#tell(type, content);
  }

  #closed(code, reason) {
    if (this.#isOver) return;
    this.#last("refused", new LiveRefusal({ code: reason || null, ...lost(code) }));
  }

  #last(type, detail) {
    this.#isOver = true;
    this.#tell(type, detail);
  }

  #tell(type, detail) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }
}

/** Address of the WebSocket of the service that sent the page. */
export function liveAddress() {
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/v1/live`;
}

/** Description of a connection that was closed without a message. Browsers don't tell pages why none was opened. */
function lost(code) {
  if (code === 1012) return { code: "live_stopped", detail: "The service is being restarted, and the capture has ended.", hint: "Begin again in a minute." };
  return { detail: "The connection to the service was lost, or was not opened.", hint: "The service may have as many live captures as it can compute. Begin again." };
}
