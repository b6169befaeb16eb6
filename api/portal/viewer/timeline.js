// Time line: a slider for the play head, and below it heat strips of each person on the same scale.

import { VIEWER } from "../shared/strings/viewer.js";
import { el, iconButton } from "./dom.js";
import { badErrorPx, bucketErrorPx, decodeStrips, spotsOf } from "./motion/strips.js";

// Heights of the bands in pixels: sources, error, cameras, identity, contacts of the left foot over the right foot's.
const BANDS = { sources: 12, error: 6, cameras: 6, identity: 6, contacts: 6 };
const GAP = 1;
const HEIGHT = Object.values(BANDS).reduce((sum, height) => sum + height + GAP, -GAP);
const SOURCES = [["measured", "#35b3a2"], ["interpolated", "#e3b341"], ["predicted", "#e5704b"]];
const EMPTY = "#232a28";
const LEGEND = [
  ["measured", "#35b3a2"], ["interpolated", "#e3b341"], ["predicted", "#e5704b"], ["error", "#f0e14a"],
  ["cameras", "#5b3f8f"], ["identity", "#e0529c"], ["contacts", "#cfd8d3"],
];

export class Strips {
  #player;
  #description;
  #range;
  #head;
  #span; // range that is played
  #announce;
  #concerns; // places to look at that were not accepted, from the worst one on
  #place = -1; // number of the one that is looked at
  #current = null;
  #marked = null; // frame at which the pointer went down

  /** `isShown` says whether a person is shown at first; `signal` ends that the strips follow the play head. */
  constructor(description, player, { announce, onperson, editor, isShown = () => true, signal }) {
    this.#description = description;
    this.#player = player;
    this.#announce = announce;
    this.spots = description.people.map((_, person) => spotsOf(description, person));
    this.#concerns = description.concerns;
    this.#range = el("input", {
      type: "range", class: "look-range", min: 0, step: 1,
      "aria-label": VIEWER.head, oninput: () => { player.pause(); player.seek(Number(this.#range.value)); },
    });
    this.#span = el("div", { class: "look-span", "aria-hidden": "true" });
    this.#head = el("div", { class: "look-head", "aria-hidden": "true" });
    const rows = description.people.map((person, number) => this.#row(person, number, onperson, isShown(number)));
    this.element = el("div", { class: "look-timeline" },
      el("div", { class: "look-line" }, el("span", { class: "look-line-name" }), el("div", { class: "look-track" }, this.#span, this.#range),
        el("div", { class: "look-spots" }, iconButton("previous", VIEWER.previousConcern, () => this.goToConcern(-1)), iconButton("next", VIEWER.nextConcern, () => this.goToConcern(1)),
          editor === null ? null : iconButton("right", VIEWER.accept, () => this.accept(editor)))),
      el("div", { class: "look-rows", role: "group", "aria-label": VIEWER.quality }, rows, this.#head),
      rows.length === 0 ? el("p", { class: "look-quiet" }, VIEWER.empty) : this.#legend());
    for (const type of ["time", "change"]) player.addEventListener(type, () => this.draw(), { signal });
    this.draw();
  }

  draw() {
    const { frame, frameTimeS, numFrames, span, hasSpan } = this.#player;
    this.#range.max = Math.max(0, numFrames - 1);
    this.#range.value = frame;
    this.#range.setAttribute("aria-valuetext", VIEWER.headAt(frame, frameTimeS.toFixed(2)));
    this.#span.hidden = !hasSpan;
    this.#span.style.setProperty("--from", span.from / numFrames);
    this.#span.style.setProperty("--to", (span.to + 1) / numFrames);
    this.#head.style.setProperty("--place", numFrames > 1 ? (frame + 0.5) / numFrames : 0.5);
  }

  /** Go to the next or the previous place to look at, from the worst one on. */
  goToConcern(step) {
    const count = this.#concerns.length;
    if (count === 0) return this.#announce(VIEWER.noConcern);
    this.#place = (Math.max(this.#place, step < 0 ? 0 : -1) + step + count) % count;
    const { person: id, camera, start_frame: from, message } = this.#concerns[this.#place];
    this.#player.pause();
    this.#player.seekTime(this.#description.start_time_s + from / this.#description.frame_rate_hz);
    const name = this.#description.people.find((person) => person.id === id)?.name;
    return this.#announce(VIEWER.concernAt(name ?? camera, from, message, this.#place + 1, count));
  }

  /** Say that the place that is looked at is right: make an edit of it, and go to the next one. */
  accept(editor) {
    const concern = this.#concerns[this.#place];
    if (concern === undefined || editor === null) return;
    const { first_frame: first } = this.#description;
    const { person, camera, kind, start_frame: start, stop_frame: stop } = concern;
    this.#concerns = this.#concerns.filter((other) => other !== concern);
    this.#place -= 1;
    this.goToConcern(1);
    editor.add({ action: "accept", person, camera, kind, start_frame: first + start, stop_frame: first + stop });
  }

  #row(person, number, onperson, isShown) {
    const strips = decodeStrips(this.#description, number);
    const canvas = el("canvas", {
      class: "look-strip", height: HEIGHT, width: strips.measured.length, role: "img",
      "aria-label": this.#summary(number), title: VIEWER.stripTitle,
    });
    paint(canvas.getContext("2d"), this.#description, strips, person, badErrorPx(this.#description, number));
    this.#listen(canvas);
    const swatch = el("input", { type: "checkbox", checked: isShown, "aria-label": VIEWER.showPerson(person.name), onchange: () => onperson(number, swatch.checked) });
    const name = el("label", { class: "look-line-name" }, swatch, el("span", { class: "look-swatch" }), el("span", { class: "look-ellipsis" }, person.name));
    name.style.setProperty("--tint", person.color);
    return el("div", { class: "look-line" }, name,
      el("div", { class: "look-track" }, canvas),
      el("span", { class: "look-count", title: VIEWER.spots }, String(this.spots[number].length)));
  }

  #summary(number) {
    const { name, coverage } = this.#description.people[number];
    return VIEWER.strip(name, coverage === null ? null : Math.round(100 * coverage), this.spots[number].length);
  }

  #listen(canvas) {
    const seek = (event) => {
      const { left, width } = canvas.getBoundingClientRect();
      const frame = Math.min(this.#player.numFrames - 1, Math.max(0, Math.floor(((event.clientX - left) / width) * this.#player.numFrames)));
      this.#player.pause();
      this.#player.seek(frame);
      this.#marked ??= frame;
      if (event.shiftKey) this.#player.setSpan({ from: Math.min(this.#marked, frame), to: Math.max(this.#marked, frame) });
    };
    canvas.addEventListener("pointerdown", (event) => {
      this.#current = event.pointerId;
      this.#marked = null;
      canvas.setPointerCapture(event.pointerId);
      seek(event);
    });
    canvas.addEventListener("pointermove", (event) => { if (this.#current === event.pointerId) seek(event); });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { this.#current = null; });
  }

  #legend() {
    return el("ul", { class: "look-legend", "aria-label": VIEWER.colours }, LEGEND.filter(([name]) => name !== "cameras" || this.#description.cameras.length).map(([name, color]) => {
      const item = el("li", {}, el("span", { class: "look-swatch" }), VIEWER.legend[name]);
      item.style.setProperty("--tint", color);
      return item;
    }));
  }
}

/** Paint a person's bands, a pixel a bucket; the page stretches them. */
function paint(context, description, strips, person, limitPx) {
  const length = description.strips.frames_per_bucket;
  const [first, last] = [person.start_frame, person.start_frame + person.num_frames - 1].map((frame) => Math.floor(frame / length));
  const numCameras = Math.max(1, description.cameras.length);
  for (let bucket = 0; bucket < strips.measured.length; bucket++) {
    if (bucket < first || bucket > last) continue;
    let top = 0;
    context.fillStyle = EMPTY;
    context.fillRect(bucket, 0, 1, HEIGHT);
    for (const [name, color] of SOURCES) {
      const height = (BANDS.sources * strips[name][bucket]) / 255;
      context.fillStyle = color;
      context.fillRect(bucket, top, 1, height);
      top += height;
    }
    top = BANDS.sources + GAP;
    const errorPx = bucketErrorPx(description, strips, bucket);
    if (!Number.isNaN(errorPx)) fill(context, bucket, top, BANDS.error, ramp("#2b4a45", "#f0e14a", errorPx / limitPx));
    top += BANDS.error + GAP;
    if (description.cameras.length) fill(context, bucket, top, BANDS.cameras, ramp("#5b3f8f", "#4c9bd6", (strips.cameras[bucket] - 1) / Math.max(1, numCameras - 1)));
    top += BANDS.cameras + GAP;
    fill(context, bucket, top, BANDS.identity, ramp("#e0529c", "#33403d", strips.identity[bucket] / 255));
  }
  context.fillStyle = "#cfd8d3";
  for (const [side, , start, count] of person.contacts) {
    context.fillRect(start / length, HEIGHT - BANDS.contacts + (side * BANDS.contacts) / 2, count / length, BANDS.contacts / 2 - 1);
  }
}

function fill(context, x, y, height, style) {
  context.fillStyle = style;
  context.fillRect(x, y, 1, height);
}

export function ramp(from, to, share) {
  const clipped = Math.min(1, Math.max(0, share));
  const part = (color, place) => parseInt(color.slice(place, place + 2), 16);
  const mixed = [1, 3, 5].map((place) => Math.round(part(from, place) + clipped * (part(to, place) - part(from, place))));
  return `rgb(${mixed.join(" ")})`;
}
