// Viewer of one take: 3D view and time line around a play head, and what a page puts beside them: videos and figures.

import { VIEWER } from "../shared/strings/viewer.js";
import { ShapeChoice, transport, viewControls, viewerTools } from "./controls.js";
import { el, graphics } from "./dom.js";
import { keySheet, listenToKeys } from "./keys.js";
import { frameRange, SPEEDS } from "./player.js";
import { SceneView } from "./scene/scene_view.js";
import { Strips } from "./timeline.js";

const LAYOUT_KEY = "multicap-layout";

export class Viewer {
  #isOpen = true;
  #isDrawn = false;
  #shownFrame = -1;
  #lastTick = performance.now();
  #orbit = null; // of the viewer before this one, for the first picture
  #listening = new AbortController();
  #ofStore = new AbortController(); // of what listens to the store
  #figuresEnd = new AbortController(); // of what listens to the play head for the figures
  #makeFigures;
  #rateHz; // frames a second of the play head, unless it has the take's

  /**
   * `store` has the frames of the take. `source`, if there is one, has the files of a character. `videos` makes the wall of
   * videos of this viewer, and `figures` the figures of its people. `editor`, if people can be edited, has `add(edit)`.
   *
   * A leader moves the play head and listens to the keys; the other viewers of a pair follow, and share its buttons.
   */
  constructor(element, store, player, { source = null, videos = () => null, figures = () => null, isLeader = true, hasTransport = true, editor = null } = {}) {
    Object.assign(this, { store, player, isLeader, hasTransport, editor });
    this.seen = null;
    this.layout = "both"; // also "scene", the 3D view alone, and "camera:NAME", a camera large
    this.fileRateHz = source?.fileRateHz ?? null;
    this.follower = null; // viewer of another job that shares the play head
    this.#makeFigures = figures;
    player.mustWait = (now) => this.isLate(now);
    this.#build(element, source, videos);
    const { signal } = this.#listening;
    player.addEventListener("time", () => this.#show(), { signal });
    player.addEventListener("change", () => this.#show(), { signal });
    this.#listenToStore();
    this.#show(true);
    if (this.wall !== null) this.#arrange(localStorage.getItem(LAYOUT_KEY));
    requestAnimationFrame((now) => this.#tick(now));
  }

  get description() {
    return this.store.description;
  }

  /**
   * Show another store of the same capture, such as an edited take's: its people in the 3D view, over the videos, in the
   * time line and in the figures. Videos, view and play head stay. The earlier store is not closed.
   */
  replace(store) {
    const hasNewFiles = store.records !== this.store.records;
    const hidden = new Set(this.description.people.filter((_, person) => !this.shown[person]).map(({ id }) => id));
    const hadFocus = this.element.contains(document.activeElement) && document.activeElement;
    this.#ofStore.abort();
    this.store = store;
    this.shown = store.description.people.map(({ id }) => !hidden.has(id));
    this.view?.replace(store);
    this.wall?.replace(store);
    const [strips, figures] = [this.strips, this.figures];
    this.#buildFigures(figures?.shown);
    strips.element.replaceWith(this.strips.element);
    figures?.element.replaceWith(this.figures.element);
    this.canvas.setAttribute("aria-label", this.#sceneName());
    this.shown.forEach((isShown, person) => { if (!isShown) this.view?.setShown(person, false); });
    if (hadFocus && !hadFocus.isConnected) this.figures?.focus();
    this.#listenToStore();
    this.#setRange();
    this.#show(true);
    this.wall?.redraw();
    if (hasNewFiles) this.shapes.renew();
  }

  /** Output frame of this take at the play head; null before its start and after its end. */
  get frame() {
    const { num_frames: numFrames } = this.description;
    const frame = Math.round(this.#placeAt(this.player.timeS));
    // While it plays, the play head runs on for the duration of the last frame.
    return frame >= 0 && frame <= numFrames ? Math.min(frame, numFrames - 1) : null;
  }

  /** Move the play head to an output frame of this take. */
  goTo(frame) {
    const { start_time_s: startS, frame_rate_hz: rateHz } = this.description;
    this.player.pause();
    this.player.seekTime(startS + frame / rateHz);
  }

  /** Show the 3D view alone, it and all cameras, or a camera large; kept for other takes. */
  setLayout(layout) {
    this.#arrange(layout);
    localStorage.setItem(LAYOUT_KEY, this.layout);
  }

  /** Show the next of the layouts; of the cameras the one that is seen through, or the first. */
  nextLayout() {
    const { cameras } = this.description;
    const next = { both: "scene", scene: `camera:${cameras[this.seen ?? 0]?.name}` };
    if (this.wall !== null) this.setLayout(next[this.layout] ?? "both");
  }

  /** Fill the screen with the 3D view (`scene`) or a camera, such as the large one, until the browser ends it; or end it. */
  fillScreen(layout = this.layout === "both" ? "scene" : this.layout) {
    if (document.fullscreenElement !== null) return document.exitFullscreen();
    const before = this.layout;
    this.main.onfullscreenchange = () => {
      const isFull = document.fullscreenElement === this.main;
      this.element.classList.toggle("look-alone", isFull);
      this.#arrange(isFull ? layout : before);
    };
    return this.main.requestFullscreen();
  }

  /** Step through the frames of the files, where they have another frame rate than the capture; null: of the capture. */
  setRate(rateHz) {
    this.#rateHz = rateHz ?? undefined;
    this.#setRange();
  }

  /** Edit the take so that it has the frames of the played range alone. */
  trim() {
    const { from, to } = this.player.span;
    const [start, last] = [from, to].map((frame) => this.description.first_frame + Math.round(this.#placeAt(this.player.startS + frame / this.player.rateHz)));
    this.player.setSpan();
    return this.editor.add({ action: "cut", start_frame: start, stop_frame: last + 1 });
  }

  /** Play head and view, for a viewer of the same capture that `resume` puts there. */
  get standpoint() {
    return { timeS: this.player.timeS, speed: this.player.speed, orbit: this.view?.stage.standpoint ?? null };
  }

  /** Stand where another viewer stood. */
  resume({ timeS, speed, orbit }) {
    this.player.setSpeed(speed);
    this.player.seekTime(timeS);
    this.#orbit = orbit;
    if (this.#isDrawn) this.#lookAsBefore();
  }

  /** True if the play head must wait: for frames on their way, or for a video that is late. */
  isLate(now) {
    const isVideoLate = this.wall?.isBehind(now);
    return isVideoLate || (this.frame !== null && !this.store.has(this.frame));
  }

  /** Tell what happened, to eyes and to screen readers. */
  say(text) {
    this.status.textContent = text;
  }

  /** Look at everybody, from a named direction or as before. */
  fit(direction = null) {
    this.see(null);
    this.view?.fit(direction);
  }

  /** See through a camera, by its number; null, or a number that no camera has: orbit again. */
  see(number) {
    this.seen = number !== null && number < this.description.cameras.length ? number : null;
    this.wall?.choose(this.seen, this.scene);
    this.element.classList.toggle("look-over", this.hasFootage);
    this.view?.see(this.seen, this.hasFootage);
    this.controls.showSeen(this.seen);
    this.showPeople();
  }

  /** True if the 3D view is over the picture of a camera's video. */
  get hasFootage() {
    const tile = this.wall?.tiles[this.seen];
    return (tile?.isLent && tile.isInTake) ?? false;
  }

  /** Put the people where they are at the play head, or in the picture of the camera that is seen through. */
  showPeople() {
    if (!this.#isDrawn || this.view === null) return;
    if (this.seen !== null && this.hasFootage !== (this.view.stage.scene.background === null)) return this.see(this.seen);
    const place = this.player.rateHz === this.description.frame_rate_hz ? this.frame : this.#placeAt(this.player.frameTimeS);
    this.view.show(this.frame !== null && this.hasFootage ? this.#placeAt(this.wall.tiles[this.seen].shownS) : place);
  }

  changeSpeed(step) {
    const place = SPEEDS.indexOf(this.player.speed) + step;
    this.player.setSpeed(SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, place))]);
  }

  close() {
    this.follower?.close();
    this.#isOpen = false;
    this.#listening.abort();
    this.#ofStore.abort();
    this.#figuresEnd.abort();
    this.player.pause();
    this.unlisten();
    this.shapes.close();
    this.figures?.close();
    this.wall?.close();
    this.store.close();
    this.view?.close();
  }

  #listenToStore() {
    this.#ofStore = new AbortController();
    const { signal } = this.#ofStore;
    this.store.addEventListener("load", () => this.#show(true), { signal });
    this.store.addEventListener("problem", () => this.say(VIEWER.framesFailed(this.store.problem.message)), { signal });
  }

  /** Place of a time among the frames of this take. */
  #placeAt(timeS) {
    return (timeS - this.description.start_time_s) * this.description.frame_rate_hz;
  }

  #setRange() {
    const range = frameRange([this, this.follower].filter((viewer) => viewer !== null).map((viewer) => viewer.description), this.#rateHz);
    this.player.setRange(this.#rateHz ? { ...range, firstSourceFrame: 0 } : range);
  }

  #arrange(layout) {
    const camera = this.description.cameras.findIndex(({ name }) => layout === `camera:${name}`);
    this.layout = camera >= 0 || layout === "scene" ? layout : "both";
    this.element.dataset.layout = camera >= 0 ? "camera" : this.layout;
    this.wall?.enlarge(camera >= 0 ? camera : null);
    this.see(this.seen);
    this.tools?.showLayout(this.layout);
    if (this.follower !== null) this.follower.setLayout(layout);
  }

  #build(element, source, videos) {
    const { description, player } = this;
    this.shown = description.people.map(() => true);
    this.canvas = el("canvas", { class: "look-canvas", tabindex: 0, role: "img", "aria-label": this.#sceneName() });
    const layer = el("div", { class: "look-labels", "aria-hidden": "true" });
    this.status = el("p", { class: "look-status", role: "status" });
    this.shapes = new ShapeChoice(this, source);
    this.controls = viewControls(this, this.shapes.element, (options) => this.view?.apply(options));
    const draws = graphics().hasWebGL;
    const drawn = draws ? [this.canvas, layer, this.controls.element]
      : [el("p", { class: "look-no-3d" }, VIEWER.no3d)];
    this.wall = videos(this);
    this.#buildFigures();
    this.scene = el("div", { class: "look-view" }, drawn, this.shapes.progress, this.status);
    this.tools = this.isLeader ? viewerTools(this) : null;
    this.sheet = this.isLeader ? keySheet() : null;
    this.main = el("div", { class: "look-main" }, el("div", { class: "look-top" }, this.scene, this.wall?.element),
      this.hasTransport ? el("div", { class: "look-row" }, transport(player), this.tools.element) : null, this.strips.element, this.sheet);
    this.element = el("div", { class: this.isLeader ? "look-viewer" : "look-viewer look-follower" }, this.main, this.figures?.element);
    element.replaceChildren(this.element);
    this.view = draws ? new SceneView(this.canvas, layer, this.store) : null;
    this.unlisten = listenToKeys(this);
    if (draws) this.shapes.renew();
  }

  /** Time line and figures of the store's people; `shown` is the state of the figures before these. */
  #buildFigures(shown) {
    const { description, player } = this;
    this.#figuresEnd.abort();
    this.#figuresEnd = new AbortController();
    const { signal } = this.#figuresEnd;
    const onperson = (person, isShown) => this.#setShown(person, isShown);
    this.strips = new Strips(description, player, { announce: (text) => this.say(text), onperson, editor: this.editor, isShown: (person) => this.shown[person], signal });
    this.figures?.close();
    this.figures = this.#makeFigures(this, shown);
  }

  #sceneName() {
    const { people, cameras } = this.description;
    return VIEWER.scene(people.length, cameras.length);
  }

  #setShown(person, isShown) {
    this.shown[person] = isShown;
    this.view?.setShown(person, isShown);
    this.wall?.redraw();
  }

  /** Show the frame at the play head, unless it is shown. */
  #show(isNew = false) {
    const { frame } = this;
    if (frame !== null) this.store.want(frame);
    if (isNew || frame !== this.#shownFrame) {
      this.#shownFrame = frame;
      if (this.#isDrawn) this.showPeople();
      else if (frame === null || this.store.has(frame)) this.#first(frame);
    }
    this.wall?.follow();
  }

  #first(frame) {
    this.#isDrawn = true;
    this.view?.open(frame);
    this.#lookAsBefore();
    this.element.dataset.ready = "true";
  }

  #lookAsBefore() {
    if (this.#orbit !== null) this.view?.stage.stand(this.#orbit);
    this.#orbit = null;
  }

  #tick(now) {
    if (!this.#isOpen) return;
    const elapsedS = (now - this.#lastTick) / 1000;
    this.#lastTick = now;
    if (this.isLeader && this.player.isPlaying && !this.player.mustWait(now)) this.player.advance(elapsedS);
    if (this.scene.clientWidth > 0) this.view?.draw(now);
    requestAnimationFrame((next) => this.#tick(next));
  }
}
