// Picture of a camera: a still of its video or an image, in which points are marked, with a magnifier.

import { html, nothing, svg } from "../shared/lit.js";
import { SCENE } from "../shared/strings/scene.js";

const [GLASS_PX, GLASS_RADIUS] = [192, 12]; // side of the magnifier, and pixels of the picture on either side of its middle
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const LARGE_STEP = 10;

const heard = (element, event) => new Promise((resolve, reject) => {
  element.addEventListener(event, resolve, { once: true });
  element.addEventListener("error", reject, { once: true });
});

// Still of a file: `canvas` has its pixels. It throws if the browser can't show the file.
export class Still {
  canvas = document.createElement("canvas");
  time_s = 0;
  duration_s = 0; // of a video

  constructor(file, camera) {
    this.camera = camera;
    this.isVideo = !file.type.startsWith("image/");
    this.source = document.createElement(this.isVideo ? "video" : "img");
    Object.assign(this.source, { muted: true, preload: "auto", src: URL.createObjectURL(file) });
  }

  async load() {
    await heard(this.source, this.isVideo ? "loadeddata" : "load");
    const { videoWidth, videoHeight, naturalWidth, naturalHeight, duration } = this.source;
    this.size = this.isVideo ? [videoWidth, videoHeight] : [naturalWidth, naturalHeight];
    this.duration_s = this.isVideo && Number.isFinite(duration) ? duration : 0;
    [this.canvas.width, this.canvas.height] = this.size;
    this.#copy();
  }

  async seek(time) {
    this.time_s = time;
    this.source.currentTime = time;
    await heard(this.source, "seeked");
    this.#copy();
  }

  #copy() {
    this.canvas.getContext("2d").drawImage(this.source, 0, 0);
  }

  close() {
    URL.revokeObjectURL(this.source.src);
    this.source.removeAttribute("src");
  }
}

const clamp = (pixel, size) => pixel.map((value, axis) => Math.min(Math.max(value, 0), size[axis] - 1));

// Picture with its marks. `marks` are changed, and `changed()` hears of it; `undo()` undoes a change; `fits` has the projections of the last calibration
// by name of the point.
export class MarkedPicture {
  #glass = Object.assign(document.createElement("canvas"), { width: GLASS_PX, height: GLASS_PX, className: "glass" });
  #isPressed = false;

  constructor(marks, changed, undo) {
    Object.assign(this, { marks, changed, undo });
    this.#glass.setAttribute("aria-hidden", "true");
  }

  #pixel({ clientX, clientY, currentTarget }, { size }) {
    const box = currentTarget.getBoundingClientRect();
    const share = [(clientX - box.left) / box.width, (clientY - box.top) / box.height];
    // The middle of the first pixel is 0.
    return clamp(share.map((value, axis) => Math.round(10 * (value * size[axis] - 0.5)) / 10), size);
  }

  #look(still, pixel) {
    const context = this.#glass.getContext("2d");
    const [left, top] = pixel.map((value) => value + 0.5 - GLASS_RADIUS);
    this.#glass.classList.toggle("left", left > still.size[0] / 2); // it does not hide the place
    context.imageSmoothingEnabled = false;
    context.fillRect(0, 0, GLASS_PX, GLASS_PX);
    context.drawImage(still.canvas, left, top, 2 * GLASS_RADIUS, 2 * GLASS_RADIUS, 0, 0, GLASS_PX, GLASS_PX);
    for (const [color, width] of [["#000", 3], ["#fff", 1]]) {
      Object.assign(context, { strokeStyle: color, lineWidth: width });
      context.beginPath();
      for (const [from, to] of [[0, 0.42], [0.58, 1]].map((ends) => ends.map((share) => share * GLASS_PX))) {
        context.moveTo(from, GLASS_PX / 2);
        context.lineTo(to, GLASS_PX / 2);
        context.moveTo(GLASS_PX / 2, from);
        context.lineTo(GLASS_PX / 2, to);
      }
      context.stroke();
    }
  }

  #press(event, still) {
    if (event.button !== 0) return;
    event.currentTarget.setPointerCapture(event.pointerId);
    this.#isPressed = true;
    this.marks.place(still.camera, this.#pixel(event, still));
    this.changed();
  }

  #drag(event, still) {
    const pixel = this.#pixel(event, still);
    this.#look(still, pixel);
    if (!this.#isPressed) return;
    this.marks.move(still.camera, pixel);
    this.changed();
  }

  #key(event, still) {
    const { marks } = this;
    const held = marks.of(still.camera).get(marks.held);
    const step = STEPS[event.key];
    if (step && held) marks.move(still.camera, clamp(held.map((value, axis) => value + step[axis] * (event.shiftKey ? LARGE_STEP : 1)), still.size));
    else if (event.key === "Enter") marks.place(still.camera, held ?? still.size.map((side) => Math.round(side / 2)));
    else if (event.key === "Delete" || event.key === "Backspace") marks.remove(still.camera);
    else if (event.key === "z" && (event.ctrlKey || event.metaKey)) this.undo();
    else if (!step) return;
    event.preventDefault();
    this.changed();
  }

  #mark(name, pixel, fit, reach) {
    const [x, y] = pixel.map((value) => value + 0.5);
    const [u, v] = fit?.projected_px.map((value) => value + 0.5) ?? [];
    return svg`<g class="mark ${name === this.marks.held ? "held" : ""}">
      ${fit ? svg`<path d="M${x} ${y}L${u} ${v}" /><circle cx=${u} cy=${v} r=${reach / 3} />` : nothing}
      <path d="M${x - reach} ${y}h${reach * 0.7}m${reach * 0.6} 0h${reach * 0.7}M${x} ${y - reach}v${reach * 0.7}m0 ${reach * 0.6}v${reach * 0.7}" />
      <text x=${x + reach * 0.4} y=${y - reach * 0.4} font-size=${reach}>${name}</text></g>`;
  }

  draw(still, fits) {
    const { camera, size, canvas } = still;
    const held = this.marks.of(camera).get(this.marks.held);
    if (held && !this.#isPressed) this.#look(still, held);
    return html`<div class="plate"><div class="still" tabindex="0" role="application" aria-label=${SCENE.picture(camera)} aria-describedby="scene-keys"
        @pointerdown=${(event) => this.#press(event, still)} @pointermove=${(event) => this.#drag(event, still)}
        @pointerup=${() => { this.#isPressed = false; }} @pointercancel=${() => { this.#isPressed = false; }}
        @keydown=${(event) => this.#key(event, still)}>${canvas}
      <svg viewBox="0 0 ${size[0]} ${size[1]}" aria-hidden="true">${this.marks.marked(camera).map(({ name }) =>
        this.#mark(name, this.marks.of(camera).get(name), fits?.get(name), Math.max(...size) / 50))}</svg></div>
      ${this.#glass}</div>`;
  }
}
