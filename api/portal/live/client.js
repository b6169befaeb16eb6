// Client of live captures: a WebSocket to `/v1/live`, keypoints in, people out.

import { LIVE } from "../shared/strings/live.js";

// Browsers send no headers of a page's own with a WebSocket: the key is a subprotocol that is offered.
const [SUBPROTOCOL, KEY_SUBPROTOCOL] = ["multicap.live", "mc.key."];
// Bytes that wait in the browser, beyond which frames are left out: some seconds of a few cameras.
const MAX_WAITING_BYTES = 2 ** 20;

/** The service refused or ended a capture; `code` is of docs/reference/problems.md. */
class LiveRefusal extends Error {
  constructor({ code = null, detail, errors = [], hint = null }) {
    super(detail);
    Object.assign(this, { code, items: errors, hint });
  }
}

/**
 * Live capture of a page.
 *
 * Events, as `CustomEvent` with `detail`: `instant` (as `unpackInstant` gives it), `status` and `notice` of cameras that the
 * service opens, `ended`, or `recorded` after `record_cameras` (messages of the service), and `refused` (a `LiveRefusal`). One of the last three comes last.
 */
export class LiveClient extends EventTarget {
  #socket;
  #ready;
  #isOver = false;
  notSent = 0; // frames that were left out because the connection is slow

  /**
   * Open a capture; `start` has the fields of the message `start` without `type` and `format`, or of `start_cameras` without
   * `format`. Pages of other origins state the
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
    this.#socket.addEventListener("open", () => this.#socket.send(JSON.stringify({ type: "start", ...start, ...(start.type === "record_cameras" ? {} : { format: "packed" }) })));
    this.#socket.addEventListener("message", ({ data }) => this.#read(data));
    this.#socket.addEventListener("close", ({ code, reason }) => this.#closed(code, reason));
  }

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
    else if (type === "ended" || type === "recorded") this.#last(type, content);
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

function liveAddress() {
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/v1/live`;
}

/** Description of a connection that was closed without a message. Browsers don't tell pages why none was opened. */
function lost(code) {
  if (code === 1012) return { code: "live_stopped", detail: LIVE.problems.stopped, hint: LIVE.problems.stoppedHint };
  return { detail: LIVE.problems.lost, hint: LIVE.problems.lostHint };
}

// Packed messages of live captures (docs/reference/live-protocol.md, "Packed messages"): keypoints to the service, instants from it.

const KEYPOINTS = "MCK1";
const INSTANT = "MCI1";
const [KEYPOINTS_HEAD_BYTES, INSTANT_HEAD_BYTES, PERSON_HEAD_BYTES, FLOAT_BYTES] = [20, 36, 8, 4];

/**
 * Packet of a camera's frame.
 *
 * `camera` is its place in `cameras` of the message `ready`, `timeS` is in seconds, and `people` has for each person x and
 * y in pixels and score of each point of the layout, in a row. Points with a number that is not finite count as not found.
 */
export function packKeypoints({ camera, timeS, people, numPoints }) {
  const packet = new ArrayBuffer(KEYPOINTS_HEAD_BYTES + people.length * numPoints * 3 * FLOAT_BYTES);
  const view = new DataView(packet);
  writeMagic(view, KEYPOINTS);
  [camera, people.length, numPoints, 0].forEach((value, place) => view.setUint16(4 + 2 * place, value, true));
  view.setFloat64(12, timeS, true);
  let place = KEYPOINTS_HEAD_BYTES;
  for (const person of people) {
    for (let point = 0; point < 3 * numPoints; point += 3) {
      const values = [person[point], person[point + 1], Math.min(1, person[point + 2])];
      const isFound = values.every(Number.isFinite) && values[2] > 0;
      for (const value of values) {
        view.setFloat32(place, isFound ? value : 0, true);
        place += FLOAT_BYTES;
      }
    }
  }
  return packet;
}

/**
 * Instant of a packet, an ArrayBuffer: `{ timeS, lagS, sequence, dropped, people }`.
 *
 * A person has `id`, `joints` (x, y and z in metres of each of `joints` of `ready`, NaN where unknown) and `skeleton`, which is
 * null until the bones are learnt: `root`, `rotations` (x, y, z, w), `boneLengths` and `joints` of `bones` of `ready`.
 */
export function unpackInstant(packet) {
  const view = new DataView(packet);
  if (packet.byteLength < INSTANT_HEAD_BYTES || readMagic(view) !== INSTANT) throw new Error(LIVE.problems.notInstant);
  const [numPeople, numJoints, numBones] = [4, 6, 8].map((offset) => view.getUint16(offset, true));
  const personBytes = PERSON_HEAD_BYTES + (3 * numJoints + 3 + 8 * numBones) * FLOAT_BYTES;
  if (packet.byteLength !== INSTANT_HEAD_BYTES + numPeople * personBytes) throw new Error(LIVE.problems.instantLength);
  const people = Array.from({ length: numPeople }, (_, number) => readPerson(view, INSTANT_HEAD_BYTES + number * personBytes, numJoints, numBones));
  return {
    timeS: view.getFloat64(12, true), lagS: view.getFloat32(20, true), sequence: view.getUint32(24, true),
    dropped: { input: view.getUint32(28, true), output: view.getUint32(32, true) }, people,
  };
}

function readPerson(view, start, numJoints, numBones) {
  let place = start + PERSON_HEAD_BYTES;
  const take = (count) => {
    const values = new Float32Array(count);
    for (let number = 0; number < count; number++, place += FLOAT_BYTES) values[number] = view.getFloat32(place, true);
    return values;
  };
  const joints = take(3 * numJoints);
  const skeleton = { root: take(3), rotations: take(4 * numBones), boneLengths: take(numBones), joints: take(3 * numBones) };
  return { id: view.getUint32(start, true), joints, skeleton: view.getUint32(start + 4, true) ? skeleton : null };
}

function writeMagic(view, text) {
  for (let place = 0; place < text.length; place++) view.setUint8(place, text.charCodeAt(place));
}

const readMagic = (view) => String.fromCharCode(...[0, 1, 2, 3].map((place) => view.getUint8(place)));
