// Keypoints in OpenPose's form as frames of cameras: zips or folders of a camera each, and their times.

import { isPassedOver, readPath } from "../send/files.js";
import { matchCameras } from "../send/matching.js";
import { stem } from "../shared/format.js";
import { LIVE } from "../shared/strings/live.js";

const FRAME = /^(?:.*\D)?(\d{1,15})(?:_keypoints)?\.json$/;
const COLUMNS = ["camera", "frame", "time_s"];
const LAYOUTS = new Map([[17, "coco-17"], [18, "coco-18"], [25, "body-25"], [26, "halpe-26"], [33, "mediapipe-33"], [133, "coco-wholebody-133"], [136, "halpe-136"]]);
const { problems: PROBLEM_TEXTS } = LIVE;

/** Reason for which nothing can be played, as `problemBox` shows it. */
class PlaybackProblem extends Error {
  constructor(message, hint = null) {
    super(message);
    this.hint = hint;
    this.items = [];
  }
}

const frameNumber = (path) => FRAME.exec(path.split("/").at(-1))?.[1];
const fileExtension = (file) => file.name.slice(file.name.lastIndexOf(".") + 1).toLowerCase();

/**
 * Sort dropped files: `{ views, timestamps, calibration, others }`.
 *
 * A view has `name`, such as a zip's or a folder's, and `frames`: functions that read the text of a frame, by its number.
 */
export async function sortedFiles(files) {
  const views = new Map();
  const found = { timestamps: null, calibration: null, others: [] };
  const addView = (name) => views.get(name) ?? views.set(name, { name, frames: new Map() }).get(name);
  for (const file of [...files].filter((each) => !isPassedOver(readPath(each)))) {
    const folders = readPath(file).split("/").slice(0, -1);
    const isFrame = file.name.endsWith("_keypoints.json") || (folders.length > 0 && frameNumber(file.name) !== undefined);
    const extension = fileExtension(file);
    if (extension === "zip") await addZip(file, addView, found);
    else if (extension === "csv") found.timestamps = file;
    else if (extension === "json" && isFrame) addView(folders.at(-1) ?? "").frames.set(Number(frameNumber(file.name)), () => file.text());
    else if (["json", "toml", "yml", "yaml", "xml", "txt", "npz", "pickle", "pkl"].includes(extension)) found.calibration = file;
    else found.others.push(file.name);
  }
  return { views: [...views.values()], ...found };
}

async function addZip(file, addView, found) {
  const entries = (await listEntries(file)).filter(({ name }) => !isPassedOver(name) && frameNumber(name) !== undefined);
  if (entries.length === 0) found.others.push(file.name);
  for (const entry of entries) addView(stem(file.name)).frames.set(Number(frameNumber(entry.name)), () => readText(file, entry));
}

/** Times in seconds by camera and frame, of a file of timestamps. */
async function readTimes(file) {
  const [head = "", ...rows] = (await file.text()).replace(/^\uFEFF/, "").split(/\r?\n/).filter((row) => row.trim() !== "");
  const cells = (row) => row.split(",").map((cell) => cell.trim().replace(/^"(.*)"$/, "$1"));
  const columns = COLUMNS.map((name) => cells(head).indexOf(name));
  if (columns.includes(-1)) throw new PlaybackProblem(PROBLEM_TEXTS.columns(file.name, COLUMNS.join(", ")));
  const times = new Map();
  for (const [line, row] of rows.entries()) {
    const values = cells(row);
    const [camera, frame, timeS] = columns.map((column) => values[column]);
    if (!camera || !/^\d+$/.test(frame) || !Number.isFinite(Number.parseFloat(timeS))) throw new PlaybackProblem(PROBLEM_TEXTS.line(line + 2, file.name));
    times.set(camera, (times.get(camera) ?? new Map()).set(Number(frame), Number(timeS)));
  }
  return times;
}

/**
 * Recording to be played: `{ frames, cameras, layout, numPoints, rateHz }`.
 *
 * `frames` are in the order of their times: `{ camera, timeS, read }`, where `camera` is a name and `read` gives a promise of
 * the people, x, y and score of each point in a row. Throws a `PlaybackProblem`.
 */
export async function openRecording({ views, timestamps }, cameras, frameRateHz) {
  const paired = matchCameras(views.map(({ name }) => `${name}.zip`), cameras);
  const stray = views.filter(({ name }) => !paired.has(`${name}.zip`));
  if (stray.length) throw new PlaybackProblem(PROBLEM_TEXTS.stray(stray.map(({ name }) => name || PROBLEM_TEXTS.noFolder).join(", ")), PROBLEM_TEXTS.cameras(cameras.join(", ")));
  if (views.length < 2) throw new PlaybackProblem(PROBLEM_TEXTS.twoCameras, PROBLEM_TEXTS.twoCamerasHint);
  const times = timestamps ? await readTimes(timestamps) : null;
  const frames = views.flatMap((view) => viewFrames(view, paired.get(`${view.name}.zip`), times, frameRateHz));
  frames.sort((one, other) => one.timeS - other.timeS);
  return { frames, cameras: [...new Set(frames.map(({ camera }) => camera))], ...await findLayout(frames), rateHz: times ? measuredRateHz(frames) : frameRateHz };
}

function viewFrames({ frames }, camera, times, frameRateHz) {
  const frameTimeS = times ? (number) => times.get(camera)?.get(number) : (number) => number / frameRateHz;
  const timed = [...frames].map(([number, text]) => ({ camera, timeS: frameTimeS(number), read: () => text().then(parsePeople) }));
  if (timed.some(({ timeS }) => timeS === undefined)) throw new PlaybackProblem(PROBLEM_TEXTS.noTime(camera));
  return timed;
}

/** People of a frame: x, y and score of each point in a row. */
export function parsePeople(text) {
  let people;
  try {
    ({ people } = JSON.parse(text));
  } catch { /* not JSON */ }
  if (!Array.isArray(people)) throw new PlaybackProblem(PROBLEM_TEXTS.form, PROBLEM_TEXTS.formHint);
  return people.map((person) => person?.pose_keypoints_2d).filter((row) => Array.isArray(row) && row.some((value) => value));
}

/** Layout of the points, by the first frame with people. */
async function findLayout(frames) {
  for (const { read } of frames) {
    const [row] = await read();
    if (row === undefined) continue;
    const layout = LAYOUTS.get(row.length / 3);
    if (layout === undefined) throw new PlaybackProblem(PROBLEM_TEXTS.layout(row.length / 3), PROBLEM_TEXTS.layoutHint([...LAYOUTS.keys()].join(", ")));
    return { layout: layout === "body-25" && await isBody25B(frames) ? "body-25b" : layout, numPoints: row.length / 3 };
  }
  throw new PlaybackProblem(PROBLEM_TEXTS.noPerson);
}

// BODY_25B has as many points in another order; it is told as in pipeline/capture/keypoint_files/layout_choice.py.
const [MOST_TOLD, FEWEST_TOLD, FAR] = [200, 5, 0.35];
const TOLD_BY = [1, 2, 5, 8, 9, 12, 17, 6, 11];

async function isBody25B(frames) {
  const off = [];
  for (const { read } of frames) {
    for (const row of await read()) {
      const at = (point) => [row[3 * point], row[3 * point + 1]];
      const apart = ([x, y], [otherX, otherY]) => Math.hypot(x - otherX, y - otherY);
      const middle = (...points) => points.map(at).reduce(([x, y], [otherX, otherY]) => [(x + otherX) / 2, (y + otherY) / 2]);
      if (row.length !== 75 || TOLD_BY.some((point) => !(row[3 * point + 2] > 0))) continue;
      const asBody25 = Math.max(apart(at(1), middle(2, 5)), apart(at(8), middle(9, 12))) / apart(at(1), at(8));
      const asBody25B = apart(at(17), middle(5, 6)) / apart(middle(5, 6), middle(11, 12));
      off.push([asBody25, asBody25B]);
    }
    if (off.length >= MOST_TOLD) break;
  }
  const median = (place) => off.map((each) => each[place]).sort((one, other) => one - other)[off.length >> 1];
  return off.length >= FEWEST_TOLD && median(0) > FAR && median(1) < FAR;
}

/** Rate of the fastest camera, by the median of the times between its frames. */
function measuredRateHz(frames) {
  const byCamera = Map.groupBy(frames, ({ camera }) => camera);
  const medians = [...byCamera.values()].map((own) => {
    const steps = own.slice(1).map(({ timeS }, place) => timeS - own[place].timeS).sort((one, other) => one - other);
    return steps[steps.length >> 1];
  }).filter((stepS) => stepS > 0);
  return Math.min(1000, Math.max(1, Math.round(1000 / Math.min(...medians)) / 1000 || 25));
}

// Zip archives in the browser: their entries, and the content of one.

// Records of the format (APPNOTE.TXT of PKWARE, sections 4.3.12 to 4.3.16) by their first four bytes.
const [ENTRY, END, END_64, LOCATOR_64] = [0x02014b50, 0x06054b50, 0x06064b50, 0x07064b50];
const [END_BYTES, LOCATOR_BYTES, ENTRY_BYTES, LOCAL_BYTES] = [22, 20, 46, 30];
const MAX_COMMENT_BYTES = 0xffff;
const [STORED, DEFLATED] = [0, 8];
const MAX_CONTENT_BYTES = 4 * 2 ** 20; // as the service allows a frame

const readView = async (blob, start, end) => new DataView(await blob.slice(start, end).arrayBuffer());

/** Entries of an archive, a Blob: `{ name, start, method, packedBytes, numBytes }` each; throws if it is none. */
export async function listEntries(blob) {
  const { start, numBytes } = await findDirectory(blob);
  const view = await readView(blob, start, start + numBytes);
  const decoder = new TextDecoder();
  const entries = [];
  for (let at = 0; at + ENTRY_BYTES <= view.byteLength && view.getUint32(at, true) === ENTRY;) {
    const [nameBytes, extraBytes, commentBytes] = [28, 30, 32].map((offset) => view.getUint16(at + offset, true));
    entries.push({
      name: decoder.decode(new Uint8Array(view.buffer, at + ENTRY_BYTES, nameBytes)), method: view.getUint16(at + 10, true),
      packedBytes: view.getUint32(at + 20, true), numBytes: view.getUint32(at + 24, true), start: view.getUint32(at + 42, true),
    });
    at += ENTRY_BYTES + nameBytes + extraBytes + commentBytes;
  }
  return entries;
}

export async function readText(blob, { name, start, method, packedBytes, numBytes }) {
  if (numBytes > MAX_CONTENT_BYTES || ![STORED, DEFLATED].includes(method)) throw new Error(PROBLEM_TEXTS.zipEntry(name));
  const head = await readView(blob, start, start + LOCAL_BYTES);
  const first = start + LOCAL_BYTES + head.getUint16(26, true) + head.getUint16(28, true);
  const content = blob.slice(first, first + packedBytes);
  if (method === STORED) return content.text();
  return new Response(content.stream().pipeThrough(new DecompressionStream("deflate-raw")).pipeThrough(limited(name, numBytes))).text();
}

/** Stream that breaks off where there are more bytes than the archive states. */
function limited(name, numBytes) {
  let left = numBytes;
  return new TransformStream({
    transform(chunk, controller) {
      left -= chunk.byteLength;
      if (left < 0) throw new Error(PROBLEM_TEXTS.zipSize(name));
      controller.enqueue(chunk);
    },
  });
}

/** Place of the list of entries. */
async function findDirectory(blob) {
  const from = Math.max(0, blob.size - END_BYTES - MAX_COMMENT_BYTES - LOCATOR_BYTES);
  const tail = await readView(blob, from, blob.size);
  for (let at = tail.byteLength - END_BYTES; at >= 0; at--) {
    if (tail.getUint32(at, true) !== END) continue;
    const locator = at - LOCATOR_BYTES;
    if (locator < 0 || tail.getUint32(locator, true) !== LOCATOR_64) return { numBytes: tail.getUint32(at + 12, true), start: tail.getUint32(at + 16, true) };
    const place = Number(tail.getBigUint64(locator + 8, true));
    const end = await readView(blob, place, place + 56);
    if (end.byteLength === 56 && end.getUint32(0, true) === END_64) return { numBytes: Number(end.getBigUint64(40, true)), start: Number(end.getBigUint64(48, true)) };
  }
  throw new Error(PROBLEM_TEXTS.notZip);
}
