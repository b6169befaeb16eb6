// Controls of the report: play head, keyboard, strips.

const take = JSON.parse(document.getElementById("take").textContent);
const one = (identifier) => document.getElementById(identifier);
const scene = new Scene(one("scene"), take);
if (one("humans")) scene.showsHumans = one("humans").checked;
const lastFrame = Math.max(0, take.num_frames - 1);
let frame = 0;
let isPlaying = false;
let playedAt = 0;

function show(wanted) {
  frame = Math.min(Math.max(wanted, 0), lastFrame);
  const shown = Math.round(frame);
  const source = take.first_source_frame === 0 ? "" : ` (${take.first_source_frame + shown} of the source)`;
  const text = `${(take.start_time_s + frame / take.frame_rate_hz).toFixed(2)} s, frame ${shown}${source}`;
  one("head").value = shown;
  one("head").setAttribute("aria-valuetext", text);
  one("clock").textContent = text;
  scene.draw(frame);
  strips.forEach((strip) => strip.draw(frame));
}

function setPlaying(wanted) {
  isPlaying = wanted && lastFrame > 0;
  one("play").textContent = isPlaying ? "Pause" : "Play";
  if (!isPlaying) return;
  if (frame >= lastFrame) frame = 0;
  playedAt = performance.now();
  requestAnimationFrame(step);
}

function step(now) {
  if (!isPlaying) return;
  const elapsedS = Math.max(0, now - playedAt) / 1000;
  playedAt = now;
  show(frame + elapsedS * Number(one("speed").value) * take.frame_rate_hz);
  if (frame >= lastFrame) setPlaying(false);
  else requestAnimationFrame(step);
}

function seek(wanted) {
  setPlaying(false);
  show(wanted);
}

/** Heat strip of a person: sources of the joints, error, cameras and identity over time. */
class Strip {
  constructor(element, person) {
    const { columns, people, frames_per_bucket: length } = take.strips;
    const bytes = Uint8Array.from(atob(people[person]), (letter) => letter.charCodeAt(0));
    const size = bytes.length / columns.length;
    this.columns = Object.fromEntries(columns.map((name, number) => [name, bytes.subarray(number * size, (number + 1) * size)]));
    Object.assign(this, { size, person: take.people[person], length, canvas: element.querySelector("canvas") });
    const who = element.querySelector(".who");
    who.textContent = this.person.name;
    who.title = this.person.name;
    who.style.setProperty("--tint", this.person.color);
    this.canvas.setAttribute("aria-label", `${this.person.name}. ${this.canvas.getAttribute("aria-label")}`);
    this.canvas.addEventListener("click", (event) => {
      const { left, width } = this.canvas.getBoundingClientRect();
      seek(Math.round((event.clientX - left) / width * take.num_frames - 0.5));
    });
    new ResizeObserver(() => { this.picture = null; this.draw(frame); }).observe(this.canvas);
  }

  draw(at) {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (width === 0) return;
    const context = this.canvas.getContext("2d");
    if (!this.picture) {
      this.picture = document.createElement("canvas");
      for (const one of [this.canvas, this.picture]) Object.assign(one, { width, height });
      this.#paint(this.picture.getContext("2d"), width);
    }
    context.drawImage(this.picture, 0, 0);
    context.fillStyle = "#ffffff";
    context.fillRect(Math.round((at + 0.5) / take.num_frames * width) - 1, 0, 2, height);
  }

  #paint(context, width) {
    const { columns: { measured, interpolated, predicted, error, cameras, identity } } = this;
    const { error_step_px: stepPx, unknown_error: unknown } = take.strips;
    context.fillStyle = "#232a28";
    context.fillRect(0, 0, width, this.canvas.height);
    const mostCameras = Math.max(2, take.cameras.length);
    for (let bucket = 0; bucket < this.size; bucket++) {
      const first = bucket * this.length;
      if (first + this.length <= this.person.start_frame || first >= this.person.start_frame + this.person.num_frames) continue;
      const left = first / take.num_frames * width;
      const across = Math.max(1, Math.min(this.length, take.num_frames - first) / take.num_frames * width + 0.5);
      let top = 12;
      for (const [column, color] of [[measured, "#35b3a2"], [interpolated, "#e3b341"], [predicted, "#e5704b"]]) {
        const high = 12 * column[bucket] / 255;
        top -= high;
        context.fillStyle = color;
        context.fillRect(left, top, across, high);
      }
      const badness = error[bucket] === unknown ? null : Math.min(1, error[bucket] * stepPx / 25);
      if (badness !== null) this.#band(context, left, 13, across, [240, 225, 74], badness);
      this.#band(context, left, 20, across, [91, 63, 143], 1 - Math.min(1, cameras[bucket] / mostCameras));
      this.#band(context, left, 27, across, [224, 82, 156], Math.min(1, (255 - identity[bucket]) / 60));
    }
  }

  #band(context, left, top, across, color, strength) {
    const mixed = color.map((value, channel) => Math.round([35, 42, 40][channel] + strength * (value - [35, 42, 40][channel])));
    context.fillStyle = `rgb(${mixed.join(" ")})`;
    context.fillRect(left, top, across, 6);
  }
}

const strips = [...document.querySelectorAll(".strip")].map((element, person) => new Strip(element, person));

// Orbit by one finger or the mouse, zoom by the wheel or two fingers.
const fingers = new Map();
const canvas = one("scene");
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, [event.clientX, event.clientY]);
});
for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
canvas.addEventListener("pointermove", (event) => {
  const before = fingers.get(event.pointerId);
  if (!before || scene.view.camera) return;
  const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
  const was = fingers.size === 2 ? spread() : 0;
  fingers.set(event.pointerId, [event.clientX, event.clientY]);
  const [across, down] = [event.clientX - before[0], event.clientY - before[1]];
  if (fingers.size === 2) zoom(was / Math.max(1, spread()));
  else if (event.buttons & 2 || event.shiftKey) scene.view.pan(across, down);
  else turn(-across / 150, down / 200);
  scene.draw();
});
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  zoom(Math.exp(event.deltaY / 600));
  scene.draw();
}, { passive: false });

function turn(yaw, pitch) {
  scene.view.yaw += yaw;
  scene.view.pitch = Math.min(1.5, Math.max(-0.4, scene.view.pitch + pitch));
}

function zoom(factor) {
  scene.view.distance = Math.min(60, Math.max(0.6, scene.view.distance * factor));
}

const KEYS = {
  " ": () => setPlaying(!isPlaying),
  ArrowLeft: (event) => seek(Math.round(frame) - (event.shiftKey ? 10 : 1)),
  ArrowRight: (event) => seek(Math.round(frame) + (event.shiftKey ? 10 : 1)),
  Home: () => seek(0),
  End: () => seek(lastFrame),
  f: () => fit(),
  a: () => turn(-0.1, 0), d: () => turn(0.1, 0), w: () => turn(0, 0.08), s: () => turn(0, -0.08),
  q: () => zoom(0.9), e: () => zoom(1.1),
};
document.addEventListener("keydown", (event) => {
  const act = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!act || event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select, button, .scroll")) return;
  event.preventDefault();
  act(event);
  scene.draw();
});

function fit() {
  one("view").value = "";
  scene.fit(frame);
  scene.draw();
}

one("play").addEventListener("click", () => setPlaying(!isPlaying));
one("head").addEventListener("input", () => seek(Number(one("head").value)));
one("humans")?.addEventListener("change", ({ target }) => { scene.showsHumans = target.checked; scene.draw(); });
one("fit").addEventListener("click", fit);
one("view").addEventListener("change", (event) => {
  scene.view.camera = event.target.value === "" ? null : take.cameras[Number(event.target.value)];
  scene.draw();
});
for (const button of document.querySelectorAll(".go")) {
  button.addEventListener("click", () => {
    seek(Number(button.dataset.frame));
    one("scene").scrollIntoView({ block: "nearest" });
  });
}

const crowded = take.people.length ? Math.round(take.people.reduce((sum, { start_frame: first, num_frames: length }) => sum + first + length / 2, 0) / take.people.length) : 0;
scene.fit(crowded);
show(Math.min(crowded, lastFrame));
