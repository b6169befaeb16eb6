// Controls of the viewer: play head, range, layout, view, and shapes of people.

import { VIEWER } from "../shared/strings/viewer.js";
import { clockText, el, icon, iconButton } from "./dom.js";
import { SPEEDS } from "./player.js";

export function transport(player) {
  const play = iconButton("play", VIEWER.play, () => player.toggle(), { class: "look-button look-icon look-play" });
  const loop = iconButton("loop", VIEWER.loop, () => player.setLooping(!player.isLooping), { "aria-pressed": "true" });
  const speed = el("select", { class: "look-select", "aria-label": VIEWER.speed, onchange: () => player.setSpeed(Number(speed.value)) },
    SPEEDS.map((value) => el("option", { value, selected: value === 1 }, VIEWER.times(value))));
  const where = el("output", { class: "look-where" });
  const element = el("div", { class: "look-transport", role: "group", "aria-label": VIEWER.playing },
    iconButton("start", VIEWER.first, () => { player.pause(); player.seek(0); }),
    iconButton("back", VIEWER.back, () => player.step(-1)),
    play,
    iconButton("forward", VIEWER.forward, () => player.step(1)),
    iconButton("end", VIEWER.last, () => { player.pause(); player.seek(player.numFrames - 1); }),
    loop, speed, where);
  const showState = () => {
    const label = player.isPlaying ? VIEWER.pause : VIEWER.play;
    play.replaceChildren(icon(player.isPlaying ? "pause" : "play"));
    play.setAttribute("aria-label", label);
    play.title = label;
    loop.setAttribute("aria-pressed", String(player.isLooping));
    speed.value = String(player.speed);
  };
  const showPlace = () => {
    const [time, total] = [player.frame, player.numFrames - 1].map((frame) => clockText(frame / player.rateHz));
    where.textContent = VIEWER.place(time, total, player.frame, player.numFrames, player.firstSourceFrame === 0 ? null : player.firstSourceFrame + player.frame);
  };
  // Screen readers read a changing output again and again: not while it runs.
  player.addEventListener("change", () => { showState(); where.setAttribute("aria-live", player.isPlaying ? "off" : "polite"); });
  player.addEventListener("time", showPlace);
  showState();
  showPlace();
  return element;
}

/** Controls beside the play head: range, frame rate, layout, full screen and keys. */
export function viewerTools(viewer) {
  const { player, description: { cameras, frame_rate_hz: rateHz } } = viewer;
  const mark = (label, title, onclick, isHidden = false) => el("button", { type: "button", class: "look-button", title, "aria-label": title, hidden: isHidden, onclick }, label);
  const all = mark(VIEWER.all, VIEWER.allFrames, () => player.setSpan());
  const trim = mark(VIEWER.trim, VIEWER.trimTitle, () => viewer.trim());
  const rate = el("select", { class: "look-select", "aria-label": VIEWER.rate, onchange: () => viewer.setRate(rate.value === "" ? null : Number(rate.value)) },
    el("option", { value: "" }, VIEWER.captureRate(rateHz)), el("option", { value: viewer.fileRateHz }, VIEWER.fileRate(viewer.fileRateHz)));
  const layouts = [["both", VIEWER.layouts.both], ["scene", VIEWER.layouts.scene], ...cameras.map(({ name }) => [`camera:${name}`, VIEWER.layouts.camera(name)])];
  const layout = el("select", { class: "look-select look-layout", "aria-label": VIEWER.layout, title: VIEWER.layoutTitle, onchange: () => viewer.setLayout(layout.value) },
    layouts.map(([value, label]) => el("option", { value }, label)));
  const showSpan = () => { all.hidden = !player.hasSpan; trim.hidden = viewer.editor === null || !player.hasSpan; };
  player.addEventListener("change", showSpan);
  showSpan();
  const element = el("div", { class: "look-tools" },
    el("div", { class: "look-bar", role: "group", "aria-label": VIEWER.range },
      mark(VIEWER.from, VIEWER.rangeFrom, () => player.setSpan({ from: player.frame })), mark(VIEWER.to, VIEWER.rangeTo, () => player.setSpan({ to: player.frame })), all, trim),
    viewer.fileRateHz === null || viewer.fileRateHz === rateHz ? null : rate,
    viewer.wall === null || cameras.length === 0 ? null : layout,
    document.fullscreenEnabled ? iconButton("fill", VIEWER.fill, () => viewer.fillScreen()) : null,
    mark("?", VIEWER.keys, () => viewer.sheet.showModal()));
  return { element, showLayout: (value) => { layout.value = value; } };
}

// Controls over the 3D view: what is shown, from where, and the keys.

const DIRECTIONS = [["fit", null], ["top", "top"], ["front", "front"], ["side", "side"]];
const LAYERS = [["body", true], ["skeleton", false], ["trails", true], ["contacts", true], ["forces", true], ["mass", false], ["cameras", true], ["names", true]];

/** `onoptions` is called with what is to be shown whenever that changes; `shapes` is the choice of what people look like. */
export function viewControls(viewer, shapes, onoptions) {
  const options = Object.fromEntries(LAYERS.map(([name, isShown]) => [name, isShown]));
  const layers = LAYERS.map(([name]) => {
    const box = el("input", { type: "checkbox", checked: options[name], onchange: () => { options[name] = box.checked; onoptions(options); } });
    const isMissing = name === "forces" && viewer.description.record.offsets.forces === undefined;
    return el("label", { hidden: isMissing }, box, ` ${VIEWER.layers[name]}`);
  });
  const directions = directionBar(viewer, { fit: VIEWER.fitTitle });
  const element = el("div", { class: "look-overlay" }, directions.element,
    el("div", { class: "look-bar" }, menu(VIEWER.show, [layers[0], shapes, ...layers.slice(1)])));
  return { element, showSeen: directions.showSeen };
}

/** Buttons and a choice of where the view is from; `viewer` has `fit`, `see` and `description.cameras`, `titles` are of buttons. */
export function directionBar(viewer, titles = {}) {
  const seen = el("select", { class: "look-select", "aria-label": VIEWER.view, onchange: () => viewer.see(seen.value === "" ? null : Number(seen.value)) },
    el("option", { value: "" }, VIEWER.orbit),
    viewer.description.cameras.map(({ name }, number) => el("option", { value: number }, VIEWER.through(name))));
  const element = el("div", { class: "look-bar", role: "group", "aria-label": VIEWER.view },
    DIRECTIONS.map(([name, direction]) => el("button", { type: "button", class: "look-button", title: titles[name] ?? null, onclick: () => viewer.fit(direction) }, VIEWER.directions[name])),
    seen);
  return { element, showSeen: (number) => { seen.value = number === null ? "" : String(number); } };
}

function menu(label, content) {
  const element = el("details", { class: "look-menu" }, el("summary", { class: "look-button" }, label),
    // On a small screen the sheet scrolls: the keyboard has to get there.
    el("div", { class: "look-sheet", tabindex: 0, role: "group", "aria-label": label }, content));
  element.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || !element.open) return;
    element.open = false;
    element.firstChild.focus();
  });
  element.addEventListener("focusout", (event) => { if (event.relatedTarget && !element.contains(event.relatedTarget)) element.open = false; });
  return element;
}

// Choice of what people look like in the 3D view: humans, capsules, or the job's character, which is loaded when it is chosen.

const MB = 1e6;

export class ShapeChoice {
  #viewer;
  #source;
  #usual; // shape that is shown without the character
  #files = []; // of the character, one a person
  #loading = new AbortController();

  constructor(viewer, source) {
    this.#viewer = viewer;
    this.#source = source;
    const shapes = viewer.description.body ? ["human", "capsule"] : ["capsule"];
    [this.#usual] = shapes;
    this.select = el("select", { class: "look-select", onchange: () => this.choose(this.select.value) },
      shapes.map((shape) => el("option", { value: shape }, VIEWER.shapes[shape])));
    this.element = el("label", {}, VIEWER.bodiesAs, this.select);
    this.progress = el("progress", { class: "look-progress", max: 1, value: 0, "aria-label": VIEWER.characterLoading });
    this.#showState(false);
  }

  /** Offer the character, if the job has one; if it is shown, load it again: its files are new. */
  async renew() {
    const isChosen = this.select.value === "character";
    if (isChosen) this.#showUsual();
    const { signal } = this.#begin();
    try {
      const files = await this.#source?.characters?.(signal) ?? [];
      if (signal.aborted) return;
      this.#offer(files);
      if (isChosen) await this.choose(files.length > 0 ? "character" : this.#usual);
    } catch (problem) {
      if (!signal.aborted) this.#fail(problem);
    }
  }

  /** Show people in a shape. Another choice ends the loading of the character, or frees its memory. */
  async choose(shape) {
    const { signal } = this.#begin();
    this.select.value = shape;
    if (shape !== "character") {
      this.#usual = shape;
      this.#showUsual();
      this.#viewer.view?.characters.clear();
      this.#viewer.say("");
      return;
    }
    this.#showState(true);
    this.#viewer.say(VIEWER.characterLoadingNow);
    try {
      await this.#viewer.view.characters.load(this.#files, signal, (share) => { this.progress.value = share; });
      this.#viewer.view.showAs("character");
      this.#viewer.say("");
    } catch (problem) {
      if (!signal.aborted) this.#fail(problem);
    } finally {
      if (!signal.aborted) this.#showState(false);
    }
  }

  close() {
    this.#loading.abort();
  }

  #begin() {
    this.#loading.abort();
    this.#loading = new AbortController();
    this.#showState(false);
    return this.#loading;
  }

  #offer(files) {
    this.#files = files;
    this.select.querySelector("[value=character]")?.remove();
    const numBytes = files.reduce((sum, file) => sum + file.numBytes, 0);
    const size = `${(numBytes / MB).toFixed(1)} MB`;
    // The mesh is read once, though each file has it.
    if (files.length > 0) this.select.append(el("option", { value: "character" }, VIEWER.characterSize(VIEWER.shapes.character, size, files.length > 1)));
    this.#showState(false);
  }

  #showUsual() {
    this.#viewer.view?.showAs(this.#usual);
  }

  #fail({ message }) {
    this.select.value = this.#usual;
    this.#showUsual();
    this.#viewer.view?.characters.clear();
    this.#viewer.say(VIEWER.characterFailed(message));
  }

  #showState(isLoading) {
    this.progress.hidden = !isLoading;
    this.progress.value = 0;
    this.element.hidden = this.select.options.length < 2;
  }
}
