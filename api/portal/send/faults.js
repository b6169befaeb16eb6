// What keeps a capture from being sent, as sentences.

import { partsOf, recordingsOfRows, videosByCamera } from "./capture.js";
import { isOfCamera } from "./files.js";

const MIN_CAMERAS = 2;

const asksForUnit = (problem) => problem.items?.some(({ code }) => code === "calibration_units_unstated");
// Files of cameras that have several which are no parts of one recording.
export function twiceOf(views) {
  const joined = [...videosByCamera(views).values()].filter((rows) => partsOf(rows) !== null).flat();
  return views.filter((row) => row.camera && !joined.includes(row) && views.some((other) => other !== row && other.camera === row.camera));
}

const listed = (rows) => rows.map(({ name }) => name).join(", ");

export function faultsOf({ files, views, calibration, needsFrameRate, frameRate_hz }, rig) {
  const faults = [];
  const missing = files.filter((row) => row.file === null && !row.isSent);
  const arrays = views.filter(({ kind }) => kind === "array");
  if (arrays.length && views.length > 1) faults.push(`${arrays[0].name} has the keypoints of all cameras: leave out the other files, or it.`);
  if (!arrays.length && recordingsOfRows(views).length < MIN_CAMERAS) faults.push(`Add the videos of at least ${MIN_CAMERAS} cameras.`);
  if (rig.problem && asksForUnit(rig.problem)) faults.push(`State the unit of length of ${rig.name}.`);
  else if (rig.problem) faults.push(`The calibration ${rig.name ?? ""} could not be read. Choose or add another one.`);
  else if (!calibration) faults.push("Choose or add the calibration of the cameras.");
  if (missing.length) faults.push(`Choose again: ${listed(missing)}.`);
  if (needsFrameRate && !(frameRate_hz >= 1)) faults.push("State the frame rate of the keypoints, or add their timestamps, a CSV file.");
  const images = views.filter(({ kind, name, rate }) => kind === "video" && /\.zip$/i.test(name) && !rate);
  if (images.length) faults.push(`State the frame rate of the images: ${listed(images)}.`);
  if (!calibration) return faults;
  const without = views.filter((row) => isOfCamera(row) && row.camera === null);
  if (without.length) faults.push(`Give a camera to ${listed(without)}, or leave it out.`);
  const twice = twiceOf(views);
  if (twice.length) faults.push(`One camera has two files: ${listed(twice)}.`);
  return faults;
}
