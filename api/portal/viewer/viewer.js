// Viewer of one take: 3D view and time line around a play head, and what a page puts beside them: videos and figures.

import { VIEWER } from "../shared/strings/viewer.js";
import { listenToKeys, ShapeChoice, transport, viewControls } from "./controls.js";
import { el, graphics } from "./dom.js";
import { frameRange, SPEEDS } from "./player.js";
import { SceneView } from "./scene/scene_view.js";
import { Strips } from "./timeline.js";

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

  /**
   * `store` has the frames of the take. `source`, if there is one, has the files of a character. `videos` makes the wall of
   * videos of this viewer, and `figures` the figures of its people.
   *
   * A leader moves the play head and listens to the keys; the other viewers of a pair follow, and share its buttons.
   */
  constructor(element, store, player, { source = null, videos = () => null, figures = () => null, isLeader = true, hasTransport = true } = {}) {
    Object.assign(this, { store, player, isLeader, hasTransport });
    this.seen = null;
    this.follower = null; // viewer of another job that shares the play head
    this.#makeFigures = figures;
    player.mustWait = (now) => this.isLate(now);
    this.#build(element, source, videos);
    const { signal } = this.#listening;
    player.addEventListener("time", () => this.#show(), { signal });
    player.addEventListener("change", () => this.#show(), { signal });
    this.#listenToStore();
    this.#show(true);
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
    this.player.setRange(frameRange([this, this.follower].filter((viewer) => viewer !== null).map((viewer) => viewer.description)));
    this.#show(true);
    this.wall?.redraw();
    if (hasNewFiles) this.shapes.renew();
  }

  /** Output frame of this take at the play head; null before its start and after its end. */
  get frame() {
    const { start_time_s: startS, frame_rate_hz: rateHz, num_frames: numFrames } = this.description;
    const frame = Math.round((this.player.timeS - startS) * rateHz);
    // While it plays, the play head runs on for the duration of the last frame.
    return frame >= 0 && frame <= numFrames ? Math.min(frame, numFrames - 1) : null;
  }

  /** Move the play head to an output frame of this take. */
  goTo(frame) {
    const { start_time_s: startS, frame_rate_hz: rateHz } = this.description;
    this.player.pause();
    this.player.seekTime(startS + frame / rateHz);
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

  /** Whether the play head must wait: for frames on their way, or for a video that is late. */
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
    this.view?.see(this.seen);
    this.wall?.choose(this.seen);
    this.controls.showSeen(this.seen);
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
    this.element = el("div", { class: this.isLeader ? "look-viewer" : "look-viewer look-follower" },
      el("div", { class: "look-top" }, el("div", { class: "look-view" }, drawn, this.shapes.progress, this.status), this.wall?.element),
      this.hasTransport ? transport(player) : null, this.strips.element, this.figures?.element);
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
    this.strips = new Strips(description, player, { announce: (text) => this.say(text), onperson, isShown: (person) => this.shown[person], signal });
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
      if (this.#isDrawn) this.view?.show(frame);
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
    this.view?.draw(now);
    requestAnimationFrame((next) => this.#tick(next));
  }
}
