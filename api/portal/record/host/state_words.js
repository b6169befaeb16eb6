// Takes, clips and phones of a recording as words.

import { length, percent, size } from "../../shared/format.js";
import { COMMON } from "../../shared/strings/common.js";
import { RECORD } from "../../shared/strings/record.js";

const GOOD_CLOCK_S = 0.01;
const LOW_BATTERY = 0.15;
const LOW_BYTES = 500e6;
const PHONE_TONES = { idle: "wait", ready: "good", live: "run", recording: "bad", stopping: "wait", sending: "run", hidden: "warn", failed: "bad", joining: "wait", away: "mute" };

/** Words and tone of a phone's state; `live` is what is known of it at the moment. */
export function phoneState(live) {
  const state = live?.is_connected ? live.status?.state ?? "joining" : "away";
  return [RECORD.phoneStates[state], PHONE_TONES[state]];
}

/** Facts of a phone: `{ text, isWorse }` each. */
export function phoneFacts(live) {
  const { status = null, hello = null } = live ?? {};
  const track = status?.track ?? hello?.track;
  const { battery, charging, free_bytes: free, clock, dropped_frames: dropped } = status ?? {};
  const isGiven = (value) => value !== undefined && value !== null;
  return [
    track && { text: `${track.width} × ${track.height}` },
    track && { text: COMMON.hz(Math.round(10 * track.frame_rate_hz) / 10) },
    isGiven(battery) && { text: RECORD.battery(percent(battery)), isWorse: battery < LOW_BATTERY && !charging },
    isGiven(clock) && { text: RECORD.clock(Math.max(1, Math.round(1000 * clock.std_s))), isWorse: clock.std_s > GOOD_CLOCK_S },
    isGiven(free) && { text: RECORD.freeSpace(size(free)), isWorse: free < LOW_BYTES },
    dropped > 0 && { text: RECORD.droppedFrames(dropped), isWorse: true },
  ].filter(Boolean);
}

/** State of a phone's clip of a take, by its number: `{ words, tone, isHere }`. */
export function clipState(clip, live, take) {
  const { started, stopped, files } = clip;
  const sending = live?.status?.sending;
  const isHere = files.length > 0 && files.length >= Math.max(stopped?.num_parts ?? 1, started?.part ?? 1);
  const { clipStates: words } = RECORD;
  if (isHere) return { words: words.here, tone: "good", isHere };
  if (sending?.take === take) return { words: words.sent(percent(sending.sent_bytes / Math.max(1, sending.num_bytes))), tone: "run", isHere };
  if (!live?.is_connected) return { words: words.unreachable, tone: "warn", isHere };
  if (stopped) return { words: words.onPhone, tone: "wait", isHere };
  return started ? { words: words.recording, tone: "bad", isHere } : { words: words.notBegun, tone: "wait", isHere };
}

/** Sentences about what a phone lost of a take that started at `startS`. */
export function clipLosses(clip, startS) {
  const lost = clip.files.flatMap(({ facts }) => facts.lost ?? []);
  const times = lost.map(({ from_s: from, to_s: to }) => RECORD.lostTime((to - from).toFixed(1), length(Math.max(0, from - startS)), length(Math.max(0, to - startS))));
  const unsaid = lost.length === 0 && clip.stopped?.lost_s > 0 ? [RECORD.lost(clip.stopped.lost_s.toFixed(1))] : [];
  const dropped = clip.stopped?.dropped_frames ?? 0;
  return [...times, ...unsaid, ...(dropped > 0 ? [RECORD.framesDropped(dropped)] : [])];
}

/** Duration of a take in seconds at a time of the service. */
export const takeDurationS = ({ state, start_s: startS, stop_s: stopS }, nowS) => Math.max(0, (state === "recording" ? nowS : stopS) - startS);

// Size and rate of the video that all phones of a recording can.

const SIZES = [[3840, 2160], [1920, 1080], [1280, 720], [960, 540], [640, 480], [640, 360], [320, 240]];
const RATES = [60, 50, 30, 25, 24, 20, 15, 10];
const [MAX_WIDTH, MAX_RATE_HZ] = [1920, 60]; // beyond them phones become hot, and files large
const NEAR_HZ = 0.5; // cameras of 30 Hz may say 29.97

/** Sizes and rates that all of some phones can, by their `capabilities`, the best first; none without a phone that tells. */
export function commonVideos(capabilities) {
  if (capabilities.length === 0) return [];
  const least = (name) => Math.min(...capabilities.map((own) => own[name]));
  // A phone that is held upright states its height first.
  const long = Math.min(...capabilities.map((own) => Math.max(own.max_width, own.max_height)));
  const short = Math.min(...capabilities.map((own) => Math.min(own.max_width, own.max_height)));
  const sizes = SIZES.filter(([width, height]) => width <= long && height <= short);
  const rates = RATES.filter((rateHz) => rateHz <= least("max_frame_rate_hz") + NEAR_HZ);
  return sizes.flatMap(([width, height]) => rates.map((rateHz) => ({ width, height, frame_rate_hz: rateHz })));
}

/** Best of the sizes and rates, within what phones record for long; null of none. */
export function bestVideo(videos) {
  return videos.find(({ width, frame_rate_hz: rateHz }) => width <= MAX_WIDTH && rateHz <= MAX_RATE_HZ) ?? null;
}

/** Size and rate as words. */
export const videoWords = ({ width, height, frame_rate_hz: rateHz }) => RECORD.videoWords(width, height, rateHz);
