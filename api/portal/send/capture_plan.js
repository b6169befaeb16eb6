// The capture that the page shows, and the requests that send it: both come from `planCapture` alone.

import { boardSpec, readStatures } from "../calibrations/values.js";
import { dateAndTime, stem } from "../shared/format.js";
import { CALIBRATIONS } from "../shared/strings/calibrations.js";
import { SEND } from "../shared/strings/send.js";
import { shownSpec } from "./choices.js";
import { isLaboratory, needsCamera } from "./files.js";
import { naturalOrder, groupRecordings } from "./matching.js";

// Unknown start of the cameras: the service measures their clocks.
export const MEASURED = "measured";

// Choices of a job that are about cameras, and have no effect on 3D points.
export const OF_CAMERAS = [
  "sync", "method", "profile", "joints", "detector", "follow_s", "appearance", "joint_centers", "refine_calibration", "people", "overlay",
  "blur_faces", "keep_videos", "force",
];

// Description of a draft with its calibration and the choices that the service offers. What the page does not ask for
// has no value here, whatever the draft keeps for the next capture.
export function planCapture({ draft, rig, options }) {
  const files = draft.rows.filter(({ isUsed }) => isUsed);
  const has = (kind) => files.some((row) => row.kind === kind);
  const hasPoints = has("keypoints") || has("array");
  const laboratory = files.filter((row) => isLaboratory(row, files));
  const is3d = files.some((row) => row.kind === "points" && !laboratory.includes(row));
  const isMeasured = draft.clock === MEASURED && !is3d;
  const choices = options ? shownSpec(draft.spec, options) : {};
  if (is3d) for (const name of OF_CAMERAS) delete choices[name];
  return {
    name: draft.name,
    files,
    views: files.filter((row) => !["timestamps", "ownPoints"].includes(row.kind) && !laboratory.includes(row)),
    laboratory,
    laboratoryClock: laboratory.length ? draft.laboratoryClock : null,
    is3d,
    calibration: is3d ? null : rig.record,
    calibrate: !is3d && draft.calibrateFrom && { method: draft.calibrateFrom, ...(draft.calibrateFrom === "board" ? { board: boardSpec(draft.board) } : { stature_m: readStatures(draft.stature) }) },
    start: draft.clock,
    clock: has("video") ? (isMeasured ? "declared" : draft.clock) : null,
    needsFrameRate: hasPoints && !has("timestamps"),
    frameRate_hz: is3d || (hasPoints && !has("timestamps")) ? draft.frameRate_hz : null,
    units: is3d ? draft.units : null,
    up: is3d ? draft.up : null,
    hasPoints,
    layout: hasPoints ? draft.layout : null,
    spec: options ? { ...choices, sync: isMeasured ? "auto" : "declared" } : null,
  };
}

// Rows of files by the recordings that they are parts of by their names; most recordings are one file.
export function groupRows(rows) {
  const byName = new Map();
  for (const row of rows) byName.set(byName.has(stem(row.name)) ? row.name : stem(row.name), row);
  return groupRecordings([...byName.keys()]).map((names) => names.map((name) => byName.get(name)));
}

// Rows with the video of a camera in order, if they are the parts of one recording: by their names, or as was said; else
// null.
export function orderParts(rows) {
  const recordings = groupRows(rows);
  if (recordings.length < 2) return recordings[0] ?? null;
  return rows.every(({ isJoined }) => isJoined) ? [...rows].sort((one, other) => naturalOrder(one.name, other.name)) : null;
}

export function videosByCamera(rows) {
  const groups = new Map();
  for (const row of rows.filter(({ kind, camera }) => kind === "video" && camera)) {
    groups.set(row.camera, [...(groups.get(row.camera) ?? []), row]);
  }
  return groups;
}

const uploadIds = (files, kind) => files.filter((row) => row.kind === kind).map(({ url }) => url.slice(url.lastIndexOf("/") + 1));

// Camera of a manifest with the parts of its recording.
const cameraManifest = (name, [first, ...more]) => ({
  name, file: first.name, ...(more.length && { more_files: more.map((row) => row.name) }),
  offset_s: first.offset_s, ...(first.rate !== null && { rate: first.rate }),
});

const laboratoryPart = ([row]) => row && { laboratory: uploadIds([row], row.kind)[0] };

const captureName = (name) => name.trim() || SEND.defaultName(dateAndTime(new Date()));

// Request that makes a calibration from the people or the board in the videos of a capture. Its cameras have the names of the files.
export function calibrationBody({ name, files, views, calibrate }) {
  const cameras = groupRows(views).map((rows) => cameraManifest(stem(rows[0].name), rows));
  return { ...calibrate, name: captureName(name), videos: uploadIds(files, "video"), cameras };
}

// Request that makes a session of the footage of a calibration.
export const calibratedBody = ({ name, laboratory, laboratoryClock, spec }, calibrationId, sessionId) => ({
  session_id: sessionId, calibration_id: calibrationId, ...laboratoryPart(laboratory),
  manifest: { name: captureName(name), sync: spec.sync, ...(laboratoryClock && { laboratory: { clock: laboratoryClock } }) },
});

// Request that makes a session of a capture whose files are sent.
export function sessionBody({ name, files, is3d, laboratory, laboratoryClock, calibration, clock, frameRate_hz, layout, units, up, spec }) {
  if (is3d) {
    const stated = { ...(frameRate_hz && { frame_rate_hz: frameRate_hz }), ...(units && { units }), ...(up && { up }) };
    return { points: uploadIds(files, "points"), manifest: { name: captureName(name), ...stated } };
  }
  const ids = (kind) => uploadIds(files, kind);
  const cameras = [...videosByCamera(files)].map(([name, rows]) => cameraManifest(name, orderParts(rows) ?? rows));
  const [[timestamps], [ownPoints]] = [ids("timestamps"), ids("ownPoints")];
  return {
    videos: ids("video"), keypoints: [...ids("keypoints"), ...ids("array")], ...(timestamps && { timestamps }),
    ...(ownPoints && { own_points: ownPoints }), ...laboratoryPart(laboratory), calibration_id: calibration.id,
    manifest: {
      name: captureName(name), cameras, ...(clock && { clock }), ...(frameRate_hz && { frame_rate_hz: frameRate_hz }),
      ...(layout && { layout }), ...(laboratoryClock && { laboratory: { clock: laboratoryClock } }),
      sync: spec.sync, ...(ids("array").length && { pair_by_order: true }),
    },
  };
}

// Request that reconstructs it.
export const jobBody = ({ spec }) => spec;

// Faults that keep a capture from being sent, as sentences.

const MIN_CAMERAS = 2;

const asksForUnit = (problem) => problem.items?.some(({ code }) => code === "calibration_units_unstated");
// Files of cameras that have several which are no parts of one recording.
export function findDoubled(views) {
  const joined = [...videosByCamera(views).values()].filter((rows) => orderParts(rows) !== null).flat();
  return views.filter((row) => row.camera && !joined.includes(row) && views.some((other) => other !== row && other.camera === row.camera));
}

const listed = (rows) => rows.map(({ name }) => name).join(", ");

export function findFaults({ files, views, is3d, laboratory, calibration, calibrate, start, needsFrameRate, frameRate_hz }, rig) {
  const faults = [];
  const missing = files.filter((row) => row.file === null && !row.isSent);
  if (is3d) {
    const others = files.filter(({ kind }) => kind !== "points");
    return [...(others.length ? [SEND.faults.points(listed(others))] : []), ...(missing.length ? [SEND.faults.missing(listed(missing))] : [])];
  }
  const ownPoints = files.filter(({ kind }) => kind === "ownPoints");
  if (ownPoints.length > 1) faults.push(SEND.faults.ownPoints(listed(ownPoints)));
  const ofKeypoints = files.filter(({ kind }) => ["timestamps", "ownPoints"].includes(kind));
  if (ofKeypoints.length && views.some(({ kind }) => kind === "video")) faults.push(SEND.faults.ofKeypoints(listed(ofKeypoints)));
  if (laboratory.length > 1) faults.push(SEND.faults.laboratory(listed(laboratory)));
  const arrays = views.filter(({ kind }) => kind === "array");
  if (arrays.length && views.length > 1) faults.push(SEND.faults.array(arrays[0].name));
  if (!arrays.length && groupRows(views).length < MIN_CAMERAS) faults.push(SEND.faults.fewCameras(MIN_CAMERAS));
  if (calibrate) {
    if (views.some(({ kind }) => kind !== "video") || start !== "declared") faults.push(SEND.faults.calibrate);
    if (calibrate.stature_m === null) faults.push(CALIBRATIONS.add.statureUnread);
  } else if (rig.problem && asksForUnit(rig.problem)) faults.push(SEND.faults.unit(rig.name));
  else if (rig.problem) faults.push(SEND.faults.calibrationUnread(rig.name ?? ""));
  else if (!calibration) faults.push(SEND.faults.calibration);
  if (missing.length) faults.push(SEND.faults.missing(listed(missing)));
  if (needsFrameRate && !(frameRate_hz >= 1)) faults.push(SEND.faults.rate);
  const images = views.filter(({ kind, name, rate }) => kind === "video" && /\.zip$/i.test(name) && !rate);
  if (images.length) faults.push(SEND.faults.imageRate(listed(images)));
  if (!calibration) return faults;
  const without = views.filter((row) => needsCamera(row) && row.camera === null);
  if (without.length) faults.push(SEND.faults.camera(listed(without)));
  const twice = findDoubled(views);
  if (twice.length) faults.push(SEND.faults.twice(listed(twice)));
  return faults;
}
