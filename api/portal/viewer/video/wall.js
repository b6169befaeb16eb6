// All cameras' videos beside the 3D view.

import { VIEWER } from "../../shared/strings/viewer.js";
import { el, graphics, iconButton } from "../dom.js";
import { positionsAt } from "../motion/kinematics.js";
import { FrameClock } from "./frame_times.js";
import { Film } from "./film.js";
import { SkeletonDrawing } from "./overlay.js";
import { Pictures } from "./pictures.js";

// Largest share of the width that videos take beside the 3D view, and the width that the 3D view keeps beside a large one.
const WIDEST = 0.44;
const BESIDE_PX = 300;

export class Wall {
  #large = null; // number of the camera that is shown alone

  constructor(viewer, source) {
    const { store, player } = viewer;
    const on = {
      through: (number) => viewer.see(viewer.seen === number ? null : number),
      enlarge: ({ number, camera }) => viewer.setLayout(number === this.#large ? "both" : `camera:${camera.name}`),
      fill: ({ camera }) => viewer.fillScreen(`camera:${camera.name}`),
      picture: (number) => { if (viewer.seen === number) viewer.showPeople(); },
    };
    this.tiles = store.description.cameras.map((camera, number) => new Tile(camera, number, store, player, { on, isShown: (person) => viewer.shown[person] }));
    this.element = el("div", { class: "look-wall", role: "group", "aria-label": VIEWER.videos }, this.tiles.map((tile) => tile.element));
    for (const tile of this.tiles) this.#load(tile, source);
    this.resizing = new ResizeObserver(() => this.#arrange());
    this.resizing.observe(this.element);
    this.element.style.setProperty("--columns", 2);
  }

  /** Take the people of another store from now on; the videos go on. */
  replace(store) {
    for (const tile of this.tiles) tile.replace(store);
  }

  /** Bring all videos to the play head, and draw. */
  follow() {
    for (const tile of this.tiles) tile.follow();
  }

  /** Draw the skeletons again: others are shown, or frames have come. */
  redraw() {
    for (const tile of this.tiles) tile.draw(true);
  }

  /** True if a video is so late that the play head must wait. */
  isBehind(now) {
    // All are asked: each keeps how long it has been late.
    return this.tiles.filter((tile) => tile.isBehind(now)).length > 0;
  }

  /** Show the picture of the camera that the 3D view looks through behind it, in `place`, unless it is large; null: in the wall. */
  choose(number, place) {
    this.resizing.observe(place);
    for (const tile of this.tiles) tile.lend(tile.number === number && number !== this.#large ? place : null);
  }

  /** Show one camera alone, by its number; null: all of them. */
  enlarge(number) {
    this.#large = number;
    for (const tile of this.tiles) {
      tile.element.classList.toggle("look-large", tile.number === number);
      tile.element.querySelector(".look-icon").setAttribute("aria-pressed", String(tile.number === number));
    }
    this.element.classList.toggle("look-has-large", number !== null);
    this.#arrange();
  }

  close() {
    this.resizing.disconnect();
    for (const tile of this.tiles) tile.close();
  }

  /** Take as many columns as show all pictures at their largest. */
  #arrange() {
    const { clientWidth: width, clientHeight: height } = this.element.parentElement;
    // Below the 3D view, on narrow screens, the style sheet arranges them.
    const room = { width: width * WIDEST, height };
    const heights = this.tiles.map(({ camera: { size_px: [w, h] } }) => h / w);
    const tallest = Math.max(...heights);
    let best = { columns: 1, size: 0 };
    for (let columns = 1; columns <= this.tiles.length; columns++) {
      const rows = Math.ceil(this.tiles.length / columns);
      const size = Math.min(room.width / columns, room.height / rows / tallest);
      if (size > best.size) best = { columns, size };
    }
    this.element.style.setProperty("--columns", best.columns);
    this.element.style.setProperty("--tile", `${Math.floor(best.size) - 5}px`);
    const [w, h] = this.tiles[this.#large]?.camera.size_px ?? [1, 1];
    this.element.style.setProperty("--large", `${Math.floor(Math.min(Math.max(width / 2, width - BESIDE_PX), (height * w) / h))}px`);
    this.tiles.forEach((tile) => tile.resize());
  }

  async #load(tile, source) {
    try {
      tile.setVideo(await source.video(tile.camera));
    } catch (error) {
      tile.note.textContent = error.message;
    }
  }
}

// A camera's video with the skeletons over it, in step with the play head.

// A video that is farther behind than this is waited for; farther off, it is set to the play head.
const WAIT_S = 0.08;
const JUMP_S = 0.5;
const PATIENCE_MS = 600;
const SETTLED_S = 1e-4;
// While it plays or is moved, a kept picture so near stands for the exact one, which follows when the play head rests.
const NEAR_S = 1 / 24;
const REST_MS = 150;
// Rate of the pictures that are kept; of faster videos some are left out.
const KEPT_HZ = 30;
// Pictures are kept ahead of the play head: so far, and no more than this share of what is kept.
const AHEAD_S = 20;
const AHEAD_SHARE = 0.8;

export class Tile {
  #store;
  #player;
  #overlay;
  #clock;
  #before;
  #after;
  #isShowing = false;
  #shown = null; // time on the session's clock of the picture that the video shows
  #isShown;
  #startS = 0; // time of the first frame on the video's own clock
  #numVideos;
  #film = null; // decoder of the video; null with a graphics card, where the browser shows the video itself
  #pictures = null; // that the film has made
  #shownFrame = null; // frame of the picture that is shown
  #head = ""; // time of the play head and whether it plays, and since when
  #restsSince = 0;
  #drawn = ""; // what the canvas shows
  #isOpen = true;
  #waitedMs = 0; // for the video since playing began
  #askedAt = null;

  constructor(camera, number, store, player, { on, isShown }) {
    Object.assign(this, { camera, number, on });
    this.isLent = false; // whether the picture is behind the 3D view
    this.#player = player;
    this.#isShown = isShown;
    this.#clock = new FrameClock(camera.clock);
    this.video = el("video", { muted: true, playsinline: true, preload: "auto", tabindex: -1, "aria-hidden": "true" });
    this.video.muted = true;
    this.canvas = el("canvas", { role: "img", "aria-label": VIEWER.picture(camera.name) });
    this.note = el("p", { class: "look-tile-note" }, VIEWER.noVideo);
    this.picture = el("div", { class: "look-picture" }, this.video, this.canvas, this.note);
    this.element = el("figure", { class: "look-tile" }, this.picture,
      el("figcaption", {}, el("button", { type: "button", class: "look-tile-name", title: VIEWER.seeThrough(camera.name, number + 1), onclick: () => on.through(number) }, camera.name),
        el("span", { class: "look-bar" }, iconButton("enlarge", VIEWER.enlarge(camera.name), () => on.enlarge(this), { "aria-pressed": "false" }),
          document.fullscreenEnabled ? iconButton("fill", VIEWER.fillWith(camera.name), () => on.fill(this)) : null)));
    for (const part of [this.element, this.picture]) part.style.setProperty("--ratio", camera.size_px[0] / camera.size_px[1]);
    this.#numVideos = store.description.cameras.length;
    this.#overlay = new SkeletonDrawing(this.canvas, camera, store.description);
    this.replace(store);
    this.#listen();
  }

  /** Take the people of another store from now on. */
  replace(store) {
    this.#store = store;
    [this.#before, this.#after] = [0, 1].map(() => new Float32Array(3 * store.records.numJoints));
    this.#drawn = "";
  }

  /** Time on the session's clock of what the tile shows: the time of the video's picture, or the play head without a video. */
  get shownS() {
    return this.#shown ?? this.#player.timeS;
  }

  /** Show the picture in another place, such as behind the 3D view, without the skeletons; null: in the tile. */
  lend(place) {
    if (this.isLent === (place !== null)) return;
    this.isLent = place !== null;
    (place ?? this.element).prepend(this.picture);
    this.element.classList.toggle("look-lent", this.isLent);
    this.resize();
  }

  /** True if a picture of the video is there and belongs to the play head's time. */
  get isInTake() {
    return this.#isShowing && this.#clock.frameAt(this.#player.timeS) !== null;
  }

  /** Number of pictures that were decoded one by one; 0 if the browser's player shows the video. */
  get numDecoded() {
    return this.#film?.numDecoded ?? 0;
  }

  /** Show a video, `{ url, startS }`; null if there is none. */
  setVideo(video) {
    if (video === null || !this.#clock.hasVideo) return;
    this.note.textContent = VIEWER.loading;
    this.#startS = video.startS;
    this.#open(video.url);
  }

  /** Without a graphics card pictures are decoded one by one and kept; else, and where that is not possible, the video plays. */
  async #open(url) {
    const film = graphics().isSoftware ? await Film.open(url, this.#clock.lastFrame + 1).catch(() => null) : null;
    if (!this.#isOpen) return film?.close();
    if (film === null) {
      this.video.src = url;
      return undefined;
    }
    this.#film = film;
    this.#pictures = new Pictures(this.#numVideos);
    this.picture.classList.add("look-kept");
    this.resize();
    try {
      await film.run(() => this.#missing(), (frame, picture) => this.#take(frame, picture));
    } catch { // the browser's player may know how to go on
      if (!this.#isOpen) return undefined;
      film.close();
      [this.#film, this.#pictures, this.#shownFrame, this.#isShowing] = [null, null, null, false];
      this.picture.classList.remove("look-kept");
      this.video.src = url;
    }
    return undefined;
  }

  /** Bring the video to the play head: exactly while it rests, by its speed and by waiting while it plays. */
  follow() {
    if (this.#isHidden) return this.video.pause();
    if (!this.#isShowing && this.#film === null) return this.draw();
    const frame = this.#clock.frameAt(this.#player.timeS);
    this.picture.classList.toggle("look-out", frame === null);
    if (!this.#player.isPlaying) this.#waitedMs = 0;
    if (frame === null) [this.#shown, this.#shownFrame] = [null, null]; // the camera took none
    if (this.#film !== null) this.#showKept(frame);
    else if (frame === null) this.video.pause();
    else if (this.#player.isPlaying) this.#run();
    else this.#rest(frame);
    return this.draw();
  }

  /** True if the play head must wait for this video. */
  isBehind(now) {
    if (this.#isHidden || !this.isInTake || !this.#player.isPlaying || this.#shown === null) return false;
    const isBehind = this.#player.timeS - this.#shown > Math.max(WAIT_S * this.#player.speed, 1 / this.#player.rateHz);
    if (isBehind && this.#askedAt !== null) this.#waitedMs += now - this.#askedAt;
    this.#askedAt = isBehind ? now : null;
    // A video that is stuck, or a machine that is too slow, must not hold up everything else for ever.
    return isBehind && this.#waitedMs < PATIENCE_MS;
  }

  /** Take the size that the tile has in the page now. */
  resize() {
    this.#overlay.measure();
    this.#drawn = "";
    // Pictures of a tile that is hidden for a while stay.
    if (!this.#isHidden && this.#pictures?.resize(...this.#overlay.size)) this.#shownFrame = null;
    this.follow();
  }

  /** Draw the skeletons at the time of the picture that is shown, unless they are drawn; `isNew`: other people are shown. */
  draw(isNew = false) {
    const { description } = this.#store;
    const place = (this.shownS - description.start_time_s) * description.frame_rate_hz;
    const frame = Math.floor(place + 1e-6);
    const picture = this.#isShowing && this.#shownFrame !== null ? this.#pictures?.get(this.#shownFrame) : null;
    const state = `${this.isLent} ${place.toFixed(3)} ${this.#store.has(frame)} ${picture ? this.#shownFrame : ""} ${this.#isShowing}`;
    if (!isNew && state === this.#drawn) return undefined;
    this.#drawn = state;
    // A picture may be still to come, also when the size has changed.
    if (this.#film !== null) this.note.hidden = Boolean(picture) || this.#clock.frameAt(this.#player.timeS) === null;
    const scale = this.#overlay.begin(picture);
    if (this.isLent) return this.on.picture(this.number);
    description.people.forEach(({ color }, person) => {
      if (!this.#isShown(person) || !positionsAt(this.#store, person, place, "joints", this.#before, this.#after)) return;
      this.#overlay.draw(this.#before, color, scale);
    });
    return undefined;
  }

  close() {
    this.#isOpen = false;
    this.#film?.close();
    this.video.pause();
    this.video.removeAttribute("src");
    this.video.load();
  }

  /** Show the kept picture of a frame, or one near it; without one the last picture stays. */
  #showKept(frame) {
    const kept = frame === null ? null : this.#pictures.nearest(frame, this.#nearFrames);
    if (kept !== null) {
      this.#shownFrame = kept;
      this.#shown = this.#clock.frameTime(kept);
    }
    // An exact picture is wanted when the play head rests.
    const head = `${this.#player.timeS} ${this.#player.isPlaying}`;
    if (this.#head !== head) {
      [this.#head, this.#restsSince] = [head, performance.now()];
      if (!this.#player.isPlaying) setTimeout(() => this.#film?.wake(), REST_MS + 1);
    }
    this.#film.wake();
  }

  /** Frame whose picture is wanted next; null if all are kept that are needed soon. */
  #missing() {
    const frame = this.#clock.frameAt(this.#player.timeS);
    if (frame === null || this.#isHidden) return null;
    const near = this.#nearFrames;
    if (this.#pictures.firstMissing(frame, frame, near) !== null) return frame;
    const isAtRest = !this.#player.isPlaying && performance.now() - this.#restsSince >= REST_MS;
    if (isAtRest && !this.#pictures.has(frame)) return frame;
    const [first, last] = [this.#player.startS, this.#player.endS].map((timeS) => this.#clock.frameAt(timeS));
    const stop = last ?? this.#clock.lastFrame;
    const numAhead = Math.min(AHEAD_S / this.#clock.intervalS, AHEAD_SHARE * this.#pictures.maxCount * this.#stride);
    const ahead = this.#pictures.firstMissing(frame, Math.min(stop, frame + Math.floor(numAhead)), near);
    // A take that fits is kept as a whole: it loops, and is scrubbed through in both directions.
    const isSmall = stop - (first ?? 0) < numAhead;
    return ahead ?? (isSmall ? this.#pictures.firstMissing(first ?? 0, frame, near) : null);
  }

  /** Keep a picture of the film, unless it is left out. */
  async #take(frame, picture) {
    const isWanted = !this.#pictures.has(frame) && (frame % this.#stride === 0 || frame === this.#missing());
    if (!isWanted || this.#isHidden) return picture.close();
    if (!await this.#pictures.take(frame, picture)) return undefined;
    this.#isShowing = true;
    return this.follow();
  }

  get #isHidden() {
    return this.#overlay.size.includes(0);
  }

  /** Every so many frames one is kept. */
  get #stride() {
    return Math.max(1, Math.floor(1 / (KEPT_HZ * this.#clock.intervalS) + 1e-6));
  }

  get #nearFrames() {
    return Math.floor(NEAR_S / this.#clock.intervalS + 1e-6);
  }

  #run() {
    const { speed, timeS } = this.#player;
    const wantedS = this.#startS + this.#clock.videoTimeAt(timeS);
    const lagS = wantedS - this.video.currentTime;
    if (this.video.paused) {
      this.video.currentTime = wantedS;
      this.#play();
    } else if (Math.abs(lagS) > JUMP_S && !this.video.seeking) {
      this.video.currentTime = wantedS;
    }
    // A little faster or slower brings it back without a jump that the eye sees.
    const rate = speed * (1 + Math.max(-0.15, Math.min(0.15, lagS * 2)));
    if (Math.abs(this.video.playbackRate - rate) > 0.01) this.video.playbackRate = rate;
  }

  #play() {
    this.video.play().catch(() => {}); // paused again before it began
  }

  #rest(frame) {
    if (!this.video.paused) this.video.pause();
    // The middle of the frame's time, so that rounding never shows the frame before it.
    const next = this.#clock.frameVideoTime(frame + 1);
    const wantedS = this.#startS + this.#clock.frameVideoTime(frame) + Math.max(1e-3, (next - this.#clock.frameVideoTime(frame)) / 2);
    if (Math.abs(this.video.currentTime - wantedS) > SETTLED_S && !this.video.seeking) this.video.currentTime = wantedS;
  }

  #listen() {
    const { video } = this;
    video.addEventListener("loadeddata", () => {
      this.#isShowing = true;
      this.note.hidden = true;
      this.resize();
    });
    video.addEventListener("error", () => {
      this.#isShowing = false;
      this.#shown = null;
      this.note.hidden = false;
      this.note.textContent = VIEWER.videoFailed;
      this.draw();
    });
    const onPicture = (mediaTime) => {
      this.#shown = this.#clock.frameTime(this.#clock.frameAtVideo(mediaTime - this.#startS));
      this.draw();
    };
    if ("requestVideoFrameCallback" in video) {
      const again = (_, { mediaTime }) => {
        onPicture(mediaTime);
        video.requestVideoFrameCallback(again);
      };
      video.requestVideoFrameCallback(again);
    } else {
      for (const event of ["seeked", "timeupdate"]) video.addEventListener(event, () => onPicture(video.currentTime));
    }
    video.addEventListener("seeked", () => { if (!this.#player.isPlaying) this.follow(); });
  }
}
