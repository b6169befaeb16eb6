// A camera's video with the skeletons over it, in step with the play head.

import { el, iconButton } from "../dom.js";
import { graphics } from "../graphics.js";
import { between } from "../motion/kinematics.js";
import { CameraClock } from "./clock.js";
import { Overlay } from "./overlay.js";
import { Pictures } from "./pictures.js";

// A video that is farther behind than this is waited for; farther off, it is set to the play head.
const WAIT_S = 0.08;
const JUMP_S = 0.5;
const PATIENCE_MS = 600;
const SETTLED_S = 1e-4;
// While it plays, a kept picture so near stands for one that was left out.
const NEAR_S = 1 / 24;
// Pictures are kept ahead of the play head: so far, and no more than this share of what is kept. The video is set to the
// next one that is missing, unless it comes there by itself soon.
const AHEAD_S = 20;
const AHEAD_SHARE = 0.8;
const SOON_S = 0.4;
// Speed of the video at each try to keep a picture: the slower, the fewer are left out on a slow machine.
const KEEPING_RATES = [1, 0.5, 0.25];

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
  #pictures; // null with a graphics card, which shows the video itself
  #videoFrame = null; // frame that the video shows
  #shownFrame = null; // frame of the picture that is shown
  #drawn = ""; // what the canvas shows
  #tries = new Map(); // to keep the picture of a frame, by the frame
  #waitedMs = 0; // for the video since playing began
  #askedAt = null;

  constructor(camera, number, store, player, { onenlarge, onthrough, isShown }) {
    Object.assign(this, { camera, number });
    this.#player = player;
    this.#isShown = isShown;
    this.#clock = new CameraClock(camera.clock);
    this.video = el("video", { muted: true, playsinline: true, preload: "auto", tabindex: -1, "aria-hidden": "true" });
    this.video.muted = true;
    this.canvas = el("canvas", { role: "img", "aria-label": `Picture of ${camera.name} with the skeletons over it` });
    this.note = el("p", { class: "look-tile-note" }, "No video");
    this.element = el("figure", { class: "look-tile" },
      el("div", { class: "look-picture" }, this.video, this.canvas, this.note),
      el("figcaption", {}, el("button", { type: "button", class: "look-tile-name", title: `See through ${camera.name} (${number + 1})`, onclick: () => onthrough(number) }, camera.name),
        iconButton("enlarge", `Enlarge ${camera.name}`, () => onenlarge(this), { "aria-pressed": "false" })));
    this.element.style.setProperty("--ratio", `${camera.size_px[0]} / ${camera.size_px[1]}`);
    this.#pictures = graphics().isSoftware ? new Pictures(this.video, store.description.cameras.length) : null;
    this.element.classList.toggle("look-kept", this.#pictures !== null);
    this.#overlay = new Overlay(this.canvas, camera, store.description);
    this.replace(store);
    this.#listen();
  }

  /** Take the people of another store from now on. */
  replace(store) {
    this.#store = store;
    [this.#before, this.#after] = [0, 1].map(() => new Float32Array(3 * store.records.numJoints));
    this.#drawn = "";
  }

  /** Time on the session's clock of what the tile shows: that of the video's picture, or the play head without a video. */
  get shownS() {
    return this.#shown ?? this.#player.timeS;
  }

  /** Whether a picture of the video is there and belongs to the play head's time. */
  get isInTake() {
    return this.#isShowing && this.#clock.frameAt(this.#player.timeS) !== null;
  }

  /** Show a video, `{ url, startS }`; null if there is none. */
  setVideo(video) {
    if (video === null || !this.#clock.hasVideo) return;
    this.note.textContent = "Loading …";
    this.#startS = video.startS;
    this.video.src = video.url;
  }

  /** Bring the video to the play head: exactly while it rests, by its speed and by waiting while it plays. */
  follow() {
    if (!this.#isShowing) return this.draw();
    const frame = this.#clock.frameAt(this.#player.timeS);
    this.element.classList.toggle("look-out", frame === null);
    if (!this.#player.isPlaying) this.#waitedMs = 0;
    if (frame === null) this.video.pause();
    else if (this.#pictures !== null && this.#showKept(frame)) this.#keepAhead(frame);
    else if (this.#player.isPlaying) this.#run();
    else this.#rest(frame);
    return this.draw();
  }

  /** Whether the play head must wait for this video. */
  isBehind(now) {
    if (!this.isInTake || !this.#player.isPlaying || this.#shown === null) return false;
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
    if (this.#pictures?.resize(...this.#overlay.size)) {
      this.#shownFrame = null;
      this.#tries.clear();
      if (this.#isShowing && this.#videoFrame !== null && !this.video.seeking) this.#take(this.#videoFrame);
    }
    this.follow();
  }

  /** Draw the skeletons at the time of the picture that is shown, unless they are drawn; `isNew`: other people are shown. */
  draw(isNew = false) {
    const { description } = this.#store;
    const place = (this.shownS - description.start_time_s) * description.frame_rate_hz;
    const frame = Math.floor(place + 1e-6);
    const picture = this.#isShowing && this.#shownFrame !== null ? this.#pictures?.get(this.#shownFrame) : null;
    const state = `${place.toFixed(3)} ${this.#store.has(frame)} ${picture ? this.#shownFrame : ""} ${this.#isShowing}`;
    if (!isNew && state === this.#drawn) return;
    this.#drawn = state;
    const scale = this.#overlay.begin(picture);
    description.people.forEach(({ color }, person) => {
      if (!this.#isShown(person) || !this.#store.positions(person, frame, "joints", this.#before)) return;
      const share = place - frame;
      if (share > 1e-3 && this.#store.positions(person, frame + 1, "joints", this.#after)) {
        between(this.#before, this.#after, share, this.#before);
      }
      this.#overlay.draw(this.#before, color, scale);
    });
  }

  close() {
    this.video.pause();
    this.video.removeAttribute("src");
    this.video.load();
  }

  /** Show the kept picture of a frame, or while it plays one near it; returns whether there is one. */
  #showKept(frame) {
    const kept = this.#pictures?.nearest(frame, this.#player.isPlaying ? this.#nearFrames : 0) ?? null;
    if (kept === null) return false;
    this.#shownFrame = kept;
    this.#shown = this.#clock.timeOf(kept);
    return true;
  }

  /** Let the video run through pictures ahead that are not kept, each stretch once: it shows none of them itself. */
  #keepAhead(frame) {
    const { video } = this;
    const numAhead = Math.min(AHEAD_S / this.#clock.intervalS, AHEAD_SHARE * this.#pictures.maxCount);
    const last = this.#clock.frameAt(this.#player.endS) ?? this.#clock.lastFrame;
    const missing = this.#nextMissing(frame, Math.min(last, frame + Math.floor(numAhead)));
    if (missing === null) return video.pause();
    if (video.seeking) return undefined;
    const soon = Math.min(this.#videoFrame + Math.ceil(SOON_S / this.#clock.intervalS), last);
    if (!video.paused && missing <= soon && this.#nextMissing(this.#videoFrame, soon) !== null) return undefined;
    const tries = this.#tries.get(missing) ?? 0;
    this.#tries.set(missing, tries + 1);
    video.playbackRate = KEEPING_RATES[tries];
    video.currentTime = this.#startS + this.#clock.videoTimeOf(missing);
    return this.#play();
  }

  /** First frame from `from` up to `to` whose picture is not kept, and was not tried for too often. */
  #nextMissing(from, to) {
    let missing = from - 1;
    do missing = this.#pictures.firstMissing(missing + 1, to, this.#nearFrames);
    while (missing !== null && this.#tries.get(missing) === KEEPING_RATES.length);
    return missing;
  }

  get #nearFrames() {
    return Math.floor(NEAR_S / this.#clock.intervalS);
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
    const next = this.#clock.videoTimeOf(frame + 1);
    const wantedS = this.#startS + this.#clock.videoTimeOf(frame) + Math.max(1e-3, (next - this.#clock.videoTimeOf(frame)) / 2);
    if (Math.abs(this.video.currentTime - wantedS) > SETTLED_S && !this.video.seeking) this.video.currentTime = wantedS;
  }

  /** Keep the picture that the video shows, and show it if the play head is there. */
  async #take(frame) {
    if (await this.#pictures.take(frame)) this.follow();
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
      this.note.textContent = "This video can't be shown here";
      this.draw();
    });
    const onPicture = (mediaTime) => {
      const frame = this.#clock.frameAtVideo(mediaTime - this.#startS);
      this.#videoFrame = frame;
      if (this.#pictures !== null) this.#take(frame);
      else {
        this.#shown = this.#clock.timeOf(frame);
        this.draw();
      }
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
