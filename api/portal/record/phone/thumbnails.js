// Small pictures of the phone's camera for the host, which never hold up the recording.

const EVERY_MS = 700;
const LONG_SIDE_PX = 240;
const QUALITY = 0.55;
const MAX_BYTES = 30_000;

/** Size of a small picture. */
export function smallSize(width, height) {
  const scale = LONG_SIDE_PX / Math.max(width, height);
  return [Math.max(1, Math.round(scale * width)), Math.max(1, Math.round(scale * height))];
}

/** Sends pictures of a `<video>` until it is stopped. `send(blob)` may refuse one; it is then left out. */
export class Thumbnails {
  #timer = 0;
  #canvas = document.createElement("canvas");
  numSkipped = 0;

  constructor(video, frames, send) {
    Object.assign(this, { video, frames, send });
    this.#timer = setInterval(() => this.#take(), EVERY_MS);
  }

  stop() {
    clearInterval(this.#timer);
  }

  #take() {
    const { videoWidth: width, videoHeight: height } = this.video;
    if (width === 0 || document.hidden) return;
    if (this.frames.isLate) {
      this.numSkipped += 1;
      return;
    }
    const [across, down] = smallSize(width, height);
    if (this.#canvas.width !== across || this.#canvas.height !== down) Object.assign(this.#canvas, { width: across, height: down });
    this.#canvas.getContext("2d").drawImage(this.video, 0, 0, across, down);
    this.#canvas.toBlob((blob) => { if (blob && blob.size <= MAX_BYTES) this.send(blob); }, "image/jpeg", QUALITY);
  }
}
