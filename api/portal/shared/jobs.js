// Jobs as words.

import { day, moment, percent, roughly } from "./format.js";
import { FORMATS, STATES } from "./strings/common.js";

const TONES = { queued: "wait", running: "run", canceling: "wait", succeeded: "good", failed: "bad" };
const ENDED = new Set(["succeeded", "failed", "canceled", "expired"]);
const STEADY_S = 2; // before that a rate says little

// True if a job and its files are at rest.
export const hasEnded = (job) => ENDED.has(job.state) && job.files_state !== "updating";
// True if files of a job can be read: also files of earlier edits, while newer ones are made.
export const hasFiles = (job) => job.results_revision !== null && job.state !== "expired";
// True if something of a job still changes by itself: its files, or the overlay videos, the report and the recording of its edits.
export const isAtWork = (job) => !hasEnded(job) || (job.visuals_job !== null && !ENDED.has(job.visuals_job.state));
const hasWarning = (job, wanted) => job.warnings.some(({ code }) => code === wanted);
const foundNobody = (job) => hasWarning(job, "nobody_found");

// Words and tone of a job's state. A result without people, or with doubts, is no plain success.
export function jobState(job) {
  if (job.files_state === "failed") return { words: STATES.notUpdated, tone: "warn" };
  if (job.state === "succeeded" && foundNobody(job)) return { words: STATES.foundNobody, tone: "empty" };
  if (job.state === "succeeded" && hasWarning(job, "everybody_removed")) return { words: STATES.emptied, tone: "empty" };
  if (job.state === "succeeded" && job.warnings.some(({ severity }) => severity !== "info")) return { words: STATES.doneWithWarnings, tone: "warn" };
  const words = job.state === "running" ? STATES.runningAt(percent(job.progress)) : STATES[job.state];
  return { words, tone: TONES[job.state] ?? "mute" };
}

// Facts of a job in short: times, attempts, its place in the queue, time left.
export function jobFacts(job) {
  const facts = [moment(job.created_at)];
  // A change of the edits is an attempt too.
  if (job.attempt > job.revision + 1) facts.push(STATES.attempt(job.attempt - job.revision));
  if (job.revision > 0) facts.push(STATES.revision(job.revision));
  if (job.files_state === "updating") facts.push(STATES.updatingAt(percent(job.progress)));
  if (job.queue_position) facts.push(STATES.inQueue(job.queue_position));
  if (job.eta_s !== null) facts.push(STATES.timeLeft(roughly(job.eta_s)));
  if (hasEnded(job) && job.started_at && job.finished_at) {
    facts.push(STATES.took(roughly((new Date(job.finished_at) - new Date(job.started_at)) / 1000)));
  }
  if (job.state === "succeeded" && job.expires_at) facts.push(STATES.keptUntil(day(job.expires_at)));
  return facts;
}

// Progress of a stage as words, with frames a second while it runs.
export function describeProgress(stage) {
  if (stage.state === "done") return stage.reused ? STATES.doneBefore : STATES.done;
  if (stage.state === "waiting" || stage.done === 0) return "";
  const elapsed_s = (Date.now() - new Date(stage.started_at)) / 1000;
  const isRated = stage.unit === "frames" && stage.state === "running" && stage.started_at && elapsed_s > STEADY_S;
  const rate = isRated ? `, ${STATES.rate((stage.done / elapsed_s).toFixed(stage.done < 10 * elapsed_s ? 1 : 0))}` : "";
  return `${STATES.progress(stage.done, stage.total)}${rate}`;
}

// How long a reconstruction of videos will take: an estimate, from jobs of this service or from the measurements of one core.

const MOST_JOBS = 5;
const FEWEST_FRAMES = 100; // of all cameras; of shorter takes the start of a job counts too much

// Measured seconds a frame of a camera by the choices of a job; null where nothing was measured.
function cameraFrameS(spec, options) {
  const choice = (name) => spec[name] ?? options.choices.find((one) => one.name === name)?.default;
  if (choice("method") !== "tracking" || choice("detector") !== "auto") return null;
  const profile = options.profiles.find(({ name }) => name === choice("profile"));
  const joints = choice("joints") === "auto" ? profile?.default_joints : choice("joints");
  return profile?.joints.find((entry) => entry.joints === joints)?.camera_frame_s ?? null;
}

// Ratio of the time of a job here to the time of the measurements; null of a job that tells nothing.
function measurePace(job, options) {
  // The stage of most frames looks at the frames of all cameras.
  const [detection] = job.stages.filter(({ unit }) => unit === "frames").sort((one, other) => other.total - one.total);
  const isWhole = job.kind === "reconstruction" && job.state === "succeeded" && job.revision === 0 && job.attempt === 1;
  if (!hasEnded(job) || !isWhole || !detection || detection.reused || detection.total < FEWEST_FRAMES) return null;
  const frameS = cameraFrameS(job.spec, options);
  return frameS && (new Date(job.finished_at) - new Date(job.started_at)) / 1000 / (detection.total * frameS);
}

// An estimate needs no seconds.
const minutes = (seconds) => (seconds < 50 ? STATES.shortTime : STATES.about(seconds < 90 ? FORMATS.minutes(1) : roughly(seconds)));

// Estimate of a job with a spec on so many frames of all cameras, as `{ text, source }`; null without one.
export function estimateTime(spec, numCameraFrames, jobs, options) {
  const frameS = options && numCameraFrames && cameraFrameS(spec, options);
  if (!frameS) return null;
  const paces = jobs.map((job) => measurePace(job, options)).filter((pace) => pace > 0).slice(0, MOST_JOBS).sort((one, other) => one - other);
  const pace = paces.length ? paces[Math.floor(paces.length / 2)] : 1;
  return {
    text: minutes(numCameraFrames * frameS * pace),
    source: paces.length ? STATES.fromJobs : STATES.fromMeasurements,
  };
}

// Frames of all cameras that a job detects people in, of cameras with so many frames each; null if one is unknown.
export function countCameraFrames(numbers, spec) {
  if (numbers.length === 0 || numbers.some((number) => !number)) return null;
  const [first, last] = spec.frame_range ?? [null, null];
  return numbers.reduce((sum, number) => sum + Math.max(0, Math.min(number, last ?? number) - (first ?? 0)), 0);
}
