// Heat strips of people, and places to look at.

import { integers } from "./records.js";

export const UNKNOWN_ERROR = 255;
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

/** First frames of the places of a person to look at, in order. */
export function spotsOf({ concerns, people }, person) {
  return concerns.filter(({ person: id }) => id === people[person].id).map(({ start_frame: from }) => from).sort((one, other) => one - other);
}
