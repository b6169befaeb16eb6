// How long a reconstruction of videos will take: an estimate, from jobs of this service or from the measurements of one core.

import { hasEnded } from "./jobs.js";
import { roughly } from "./format.js";

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

// Ratio of the time of a job here to that of the measurements; null of a job that tells nothing.
function paceOf(job, options) {
  // The stage of most frames looks at those of all cameras.
  const [detection] = job.stages.filter(({ unit }) => unit === "frames").sort((one, other) => other.total - one.total);
  const isWhole = job.kind === "reconstruction" && job.state === "succeeded" && job.revision === 0 && job.attempt === 1;
  if (!hasEnded(job) || !isWhole || !detection || detection.reused || detection.total < FEWEST_FRAMES) return null;
  const frameS = cameraFrameS(job.spec, options);
  return frameS && (new Date(job.finished_at) - new Date(job.started_at)) / 1000 / (detection.total * frameS);
}

// An estimate needs no seconds.
const minutes = (seconds) => (seconds < 50 ? "less than a minute" : `about ${seconds < 90 ? "1 min" : roughly(seconds)}`);

// Estimate of a job with a spec on so many frames of all cameras, as `{ text, source }`; null without one.
export function estimateOf(spec, numCameraFrames, jobs, options) {
  const frameS = options && numCameraFrames && cameraFrameS(spec, options);
  if (!frameS) return null;
  const paces = jobs.map((job) => paceOf(job, options)).filter((pace) => pace > 0).slice(0, MOST_JOBS).sort((one, other) => one - other);
  const pace = paces.length ? paces[Math.floor(paces.length / 2)] : 1;
  return {
    text: minutes(numCameraFrames * frameS * pace),
    source: paces.length ? "estimated from the last jobs of this service" : "estimated from measurements on one core; this service may be faster or slower",
  };
}

// Frames of all cameras that a job detects people in, of cameras with so many frames each; null if one is unknown.
export function cameraFramesOf(numbers, spec) {
  if (numbers.length === 0 || numbers.some((number) => !number)) return null;
  const [first, last] = spec.frame_range ?? [null, null];
  return numbers.reduce((sum, number) => sum + Math.max(0, Math.min(number, last ?? number) - (first ?? 0)), 0);
}
