// Plots around the play head: reprojection error by camera and joint, joint angles, bends, speeds.

import { FIGURES } from "../shared/strings/viewer.js";
import uPlot from "../vendor/uPlot.esm.js";
import { el } from "./dom.js";
import { angleGroups, ANGLES, bendDeg, speedMS, SPEEDS } from "./motion/kinematics.js";

const HALF_WINDOW_S = 4;
const HEIGHT_PX = 230;
// Distinct on a dark ground, also for people who do not see red and green apart (Okabe and Ito 2008, brightened).
const TINTS = ["#56b4e9", "#e69f00", "#2fc79a", "#f0e442", "#e07a3f", "#d98cc0", "#9fb4ff", "#c9c9c9", "#7ad3f7", "#ffb347"];
const UNITS = { cameras: "px", joints: "px", angles: "°", speeds: "m/s" };
const KINDS = Object.fromEntries(Object.entries(UNITS).map(([kind, unit]) => [kind, { label: FIGURES.plots[kind], unit }]));

export class Plots {
  #store;
  #player;
  #plot = null;
  #window = null;
  #kind;
  #kinds;
  #person = 0;
  #place;
  #swatch = el("span", { class: "look-swatch", "aria-hidden": "true" }); // colour of the person
  #resizing;
  #closing = new AbortController();
  #listening = { signal: this.#closing.signal };

  /** `kind` is the plot that is shown first. */
  constructor(store, player, { kind = "cameras" } = {}) {
    this.#kind = kind;
    this.#store = store;
    this.#player = player;
    const { people, angle_names: angleNames = [] } = store.description;
    const groups = angleGroups(angleNames).map(({ name, angles }) => [`angles-${name}`, { label: FIGURES.anglesOf(name), unit: "°", angles }]);
    this.#kinds = { ...KINDS, ...Object.fromEntries(groups) };
    const choose = (label, values, onchange) => el("label", { class: "look-choice" }, `${label} `,
      el("select", { class: "look-select", "aria-label": label, onchange }, values.map(([value, text]) => el("option", { value }, text))));
    this.#place = el("div", { class: "look-plot" });
    this.element = el("div", { class: "look-plots" },
      el("div", { class: "look-choices" },
        this.#swatch, choose(FIGURES.person, people.map(({ name }, number) => [number, name]), (event) => this.#choose({ person: Number(event.target.value) })),
        choose(FIGURES.plot, Object.entries(this.#kinds).map(([kind, { label }]) => [kind, label]), (event) => this.#choose({ kind: event.target.value }))),
      this.#place);
    this.#showTint();
    this.#resizing = new ResizeObserver(() => this.#fit());
    this.#resizing.observe(this.#place);
    if (!(kind in this.#kinds)) this.#kind = "cameras";
    this.element.querySelectorAll("select")[1].value = this.#kind;
    player.addEventListener("time", () => this.draw(), this.#listening);
    store.addEventListener("load", () => this.draw(true), this.#listening);
  }

  /** Draw what is around the play head, if the plot can be seen. */
  draw(isNew = false) {
    if (this.#place.clientWidth === 0 || this.#store.description.people.length === 0) return;
    const { frame, rateHz, numFrames } = this.#player;
    const half = Math.round(HALF_WINDOW_S * rateHz);
    const isInside = this.#window && frame > this.#window.from + half / 2 && frame < this.#window.to - half / 2;
    if (isNew || !this.#plot || (!isInside && this.#window.center !== frame)) {
      this.#window = { center: frame, from: Math.max(0, frame - half), to: Math.min(numFrames, frame + half + 1) };
      this.#fill();
    }
    this.#point(frame);
  }

  get kind() {
    return this.#kind;
  }

  close() {
    this.#closing.abort();
    this.#resizing.disconnect();
    this.#plot?.destroy();
  }

  #choose({ kind = this.#kind, person = this.#person }) {
    [this.#kind, this.#person] = [kind, person];
    this.#showTint();
    this.#plot?.destroy();
    this.#plot = null;
    this.draw(true);
  }

  #showTint() {
    this.#swatch.style.setProperty("--tint", this.#store.description.people[this.#person]?.color ?? "transparent");
  }

  #fill() {
    const { from, to } = this.#window;
    const frames = Array.from({ length: to - from }, (_, row) => from + row);
    const series = this.#series();
    const data = [frames, ...series.map(({ value }) => frames.map((frame) => {
      const found = value(frame);
      return Number.isFinite(found) ? found : null;
    }))];
    if (this.#plot) this.#plot.setData(data);
    else this.#plot = this.#make(series, data);
  }

  /** Lines of the plot: a label each, and a value for a frame (NaN where there is none). */
  #series() {
    const { description, records } = this.#store;
    const here = (frame) => this.#store.place(this.#person, frame);
    const bone = (name) => description.skeleton.names.indexOf(name);
    if (this.#kind === "cameras") {
      return description.cameras.map(({ name }, camera) => ({ label: name, value: (frame) => ifHere(here(frame), (place) => records.cameraErrorPx(place, camera)) }));
    }
    if (this.#kind === "joints") {
      // Fingers would fill the legend.
      const joints = description.joint_names.map((name, joint) => [name, joint]).filter(([name]) => !/(thumb|index|middle|ring|pinky)/.test(name));
      return joints.map(([name, joint]) => ({ label: name.replaceAll("_", " "), value: (frame) => ifHere(here(frame), (place) => records.jointErrorPx(place, joint)) }));
    }
    const { angles } = this.#kinds[this.#kind];
    if (angles) {
      return angles.map(({ label, number }) => ({ label, value: (frame) => ifHere(here(frame), (place) => records.angleDeg(place, number)) }));
    }
    const [before, after] = [0, 1].map(() => new Float32Array(3 * records.numBones));
    const at = (frame, out) => this.#store.positions(this.#person, frame, "skeleton", out);
    if (this.#kind === "angles") {
      return ANGLES.map(({ label, from, at: middle, to }) => ({
        label, value: (frame) => (at(frame, after) ? bendDeg(after, bone(from), bone(middle), bone(to)) : NaN),
      }));
    }
    const seconds = 2 / description.frame_rate_hz;
    return SPEEDS.map(([name, label]) => ({
      label, value: (frame) => (at(frame - 1, before) && at(frame + 1, after) ? speedMS(before, after, bone(name), seconds) : NaN),
    }));
  }

  #make(series, data) {
    const { label, unit } = this.#kinds[this.#kind];
    const text = getComputedStyle(this.#place).color;
    const grid = { stroke: "rgb(128 140 136 / 0.18)", width: 1 };
    const axis = { stroke: text, grid, ticks: grid, font: "12px system-ui, sans-serif" };
    const plot = new uPlot({
      width: this.#place.clientWidth, height: HEIGHT_PX,
      scales: { x: { time: false }, y: { range: (_, low, high) => [Math.min(0, low ?? 0), Math.max(1, (high ?? 1) * 1.08)] } },
      axes: [{ ...axis, values: (_, all) => all.map((frame) => (Number.isInteger(frame) ? String(frame) : "")) }, { ...axis, label: FIGURES.axis(label, unit), labelSize: 22, size: 46, labelFont: axis.font }],
      series: [{ label: FIGURES.frame }, ...series.map((line, number) => ({
        label: line.label, stroke: TINTS[number % TINTS.length], width: 1.5, dash: number >= TINTS.length ? [4, 3] : [], points: { show: false },
        value: (_, value) => (value === null ? FIGURES.unknown : `${value.toFixed(unit === "°" ? 0 : 1)} ${unit}`),
      }))],
      cursor: { y: false, drag: { x: false, y: false }, bind: { mousemove: () => null, mouseleave: () => null } },
      legend: { live: true },
    }, data, this.#place);
    plot.over.addEventListener("click", (event) => {
      const { left } = plot.over.getBoundingClientRect();
      this.#player.pause();
      this.#player.seek(Math.round(plot.posToVal(event.clientX - left, "x")));
    });
    return plot;
  }

  #point(frame) {
    this.#plot?.setCursor({ left: this.#plot.valToPos(frame, "x"), top: 0 });
  }

  #fit() {
    if (this.#place.clientWidth === 0) return;
    if (!this.#plot) return this.draw(true);
    // Its own legend changes the height of the place, never its width.
    if (this.#plot.width !== this.#place.clientWidth) this.#plot.setSize({ width: this.#place.clientWidth, height: HEIGHT_PX });
    return this.draw();
  }
}

function ifHere(place, value) {
  return place === null ? NaN : value(place);
}
