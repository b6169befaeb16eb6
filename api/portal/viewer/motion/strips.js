// Heat strips of people, and the spots in them to check.

import { VIEWER } from "../../shared/strings/viewer.js";
import { integers } from "./records.js";

export const UNKNOWN_ERROR = 255;
const MIN_IDENTITY = 0.99;
const MIN_CAMERAS = 2;
const MAX_PREDICTED = 0.25;
const MAX_ABSENT = 0.5;
// An error is bad at this multiple of the person's own median, and never below so many pixels.
const ERROR_RATIO = 2.5;
const ERROR_FLOOR_PX = 10;

/** Columns of a person's strips: `Uint8Array`s of one byte a bucket, by name. */
export function decodeStrips(description, person) {
  const { columns, people } = description.strips;
  const bytes = integers(people[person], Uint8Array);
  const length = bytes.length / columns.length;
  return Object.fromEntries(columns.map((name, number) => [name, bytes.subarray(number * length, (number + 1) * length)]));
}

/** Error of a bucket in pixels; NaN without one. */
export function bucketErrorPx(description, strips, bucket) {
  const steps = strips.error[bucket];
  return steps === UNKNOWN_ERROR ? NaN : steps * description.record.error_step_px;
}

/** Error in pixels from which on a person's frames are bad. */
export function badErrorPx(description, person) {
  return Math.max(ERROR_FLOOR_PX, ERROR_RATIO * (description.people[person].reprojection_error_px ?? 0));
}

/**
 * Spots of a person to check, as `{ from, to, reason }`; frames `from` up to but without `to`, in order.
 *
 * Neighbouring buckets with the same reason are one spot.
 */
export function badSpots(description, person, strips = decodeStrips(description, person)) {
  const about = description.people[person];
  const length = description.strips.frames_per_bucket;
  const limitPx = badErrorPx(description, person);
  const spots = [];
  const first = Math.floor(about.start_frame / length);
  const last = Math.floor((about.start_frame + about.num_frames - 1) / length);
  for (let bucket = first; bucket <= last; bucket++) {
    const reason = refusalReason(description, strips, bucket, limitPx);
    const from = Math.max(bucket * length, about.start_frame);
    const to = Math.min((bucket + 1) * length, about.start_frame + about.num_frames);
    const before = spots.at(-1);
    if (reason === null) continue;
    if (before?.to === from && before.reason === reason) before.to = to;
    else spots.push({ from, to, reason });
  }
  return spots;
}

function refusalReason(description, strips, bucket, limitPx) {
  const [measured, interpolated, predicted] = ["measured", "interpolated", "predicted"].map((name) => strips[name][bucket] / 255);
  if (strips.identity[bucket] / 255 < MIN_IDENTITY) return VIEWER.reasons.identity;
  if (1 - measured - interpolated - predicted > MAX_ABSENT) return VIEWER.reasons.absent;
  if (predicted > MAX_PREDICTED) return VIEWER.reasons.predicted;
  if (strips.cameras[bucket] < MIN_CAMERAS) return VIEWER.reasons.cameras;
  if (bucketErrorPx(description, strips, bucket) > limitPx) return VIEWER.reasons.error;
  return null;
}
