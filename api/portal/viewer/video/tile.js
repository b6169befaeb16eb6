// A camera's video with the skeletons over it, in step with the play head.

import { el, iconButton } from "../dom.js";
import { between } from "../motion/kinematics.js";
import { CameraClock } from "./clock.js";
import { Overlay } from "./overlay.js";

// A video that is farther behind than this is waited for; farther off, it is set to the play head.
const WAIT_FRAMES = 1;
const JUMP_S = 0.5;
const PATIENCE_MS = 1500;
const SETTLED_S = 1e-4;

export class Tile {
  #store;
  #player;
  #overlay;
  #clock;
  #before;
  #after;
  #behindSince = null;
  #isShowing = false;
  #shown = null; // time on the session's clock of the picture that the video shows
  #isShown;
  #startS = 0; // time of the first frame on the video's own clock

  constructor(camera, number, store, player, { onenlarge, onthrough, isShown }) {
    Object.assign(this, { camera, number });
    this.#store = store;
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
    this.#overlay = new Overlay(this.canvas, camera, store.description);
    [this.#before, this.#after] = [0, 1].map(() => new Float32Array(3 * store.records.numJoints));
    this.#listen();
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
    if (frame === null) {
      this.video.pause();
      return this.draw();
    }
    if (this.#player.isPlaying) this.#run();
    else this.#rest(frame);
    return this.draw();
  }

  /** Whether the play head must wait for this video. */
  isBehind(now) {
    if (!this.isInTake || !this.#player.isPlaying || this.#shown === null) return false;
    const isBehind = this.#player.timeS - this.#shown > WAIT_FRAMES / this.#player.rateHz;
    this.#behindSince = isBehind ? (this.#behindSince ?? now) : null;
    // A video that is stuck must not hold up everything else for ever.
    return isBehind && now - this.#behindSince < PATIENCE_MS;
  }

  /** Draw the skeletons at the time of the picture that is shown. */
  draw() {
    const { description } = this.#store;
    const scale = this.#overlay.clear();
    const place = (this.shownS - description.start_time_s) * description.frame_rate_hz;
    const frame = Math.floor(place + 1e-6);
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

  #run() {
    const { speed, timeS } = this.#player;
    const wantedS = this.#startS + this.#clock.videoTimeAt(timeS);
    const lagS = wantedS - this.video.currentTime;
    if (this.video.paused) {
      this.video.currentTime = wantedS;
      this.video.play().catch(() => {}); // paused again before it began
    } else if (Math.abs(lagS) > JUMP_S && !this.video.seeking) {
      this.video.currentTime = wantedS;
    }
    // A little faster or slower brings it back without a jump that the eye sees.
    const rate = speed * (1 + Math.max(-0.15, Math.min(0.15, lagS * 2)));
    if (Math.abs(this.video.playbackRate - rate) > 0.01) this.video.playbackRate = rate;
  }

  #rest(frame) {
    if (!this.video.paused) this.video.pause();
    // The middle of the frame's time, so that rounding never shows the frame before it.
    const next = this.#clock.videoTimeOf(frame + 1);
    const wantedS = this.#startS + this.#clock.videoTimeOf(frame) + Math.max(1e-3, (next - this.#clock.videoTimeOf(frame)) / 2);
    if (Math.abs(this.video.currentTime - wantedS) > SETTLED_S && !this.video.seeking) this.video.currentTime = wantedS;
  }

  #listen() {
    const { video } = this;
    video.addEventListener("loadeddata", () => {
      this.#isShowing = true;
      this.note.hidden = true;
      this.follow();
    });
    video.addEventListener("error", () => {
      this.#isShowing = false;
      this.#shown = null;
      this.note.hidden = false;
      this.note.textContent = "This video can't be shown here";
      this.draw();
    });
    const onPicture = (mediaTime) => {
      this.#shown = this.#clock.timeOf(this.#clock.frameAtVideo(mediaTime - this.#startS));
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
