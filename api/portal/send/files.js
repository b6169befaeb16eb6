// Files of a capture: what they are, by their names.

import { emptyBoard } from "../calibrations/values.js";
import { RequestProblem } from "../shared/api.js";
import { countFrames } from "../shared/mp4.js";
import { SEND } from "../shared/strings/send.js";

const KINDS = {
  video: ["mp4", "mov", "m4v", "mkv", "webm", "avi", "ts", "mts", "m2ts", "mpg", "mpeg"],
  timestamps: ["csv"],
  calibration: ["toml", "json", "yml", "yaml", "xml", "txt", "npz", "pickle", "pkl"],
};
// Files of 3D points by their endings, and what tells others: columns of a table, fields of a document.
const POINTS = ["trc", "c3d", "bvh", "nc"];
const POINT_HEADS = { csv: /^[^\n]*[ _.:]x([ _]?\(?(m|cm|mm)\)?)?"?\s*[,;\t]/i, json: /"joint_names"|"(pose_keypoints_3d|keypoints3d|joints19)"\s*:\s*\[\s*[-\d[]/ };
// A file about points of the user's own begins with objects or bones.
const OWN_POINTS = { yaml: /^(objects|bones)\s*:/m, yml: /^(objects|bones)\s*:/m, json: /^\s*\{\s*"(objects|bones)"/ };
const HEAD_BYTES = 1 << 16;
const IMAGES = ["png", "jpg", "jpeg", "tif", "tiff", "bmp", "webp"];
const KEYPOINTS = ["json", "csv", "npy", "h5", "hdf5"];
// FreeMoCap's array of the 2D points of all cameras.
const ARRAY = /2d.*\.npy$/i;
const LABELS = /\d\.txt$/i; // YOLO's; the texts of calibrations have no numbers at the ends of their names
const MOST_FILES = 20_000; // of dropped folders
// The directory of a zip is at its end; its first entries are enough to tell what the zip has.
const TAIL_BYTES = 1 << 16;
const ENTRY = "PK\u0001\u0002";
const [NAME_LENGTH_AT, NAME_AT] = [28, 46];

export const ACCEPTED = ["zip", "npy", ...POINTS, ...Object.values(KINDS).flat()].map((ending) => `.${ending}`).concat("video/*").join(",");
// Axes of a calibration's world that may point up.
export const AXES = [["", SEND.calibration.upAuto], ...["x", "-x", "y", "-y", "-z"].map((axis) => [axis, axis.toUpperCase().replace("-", "−")])];
export const ACCEPTED_CALIBRATIONS = KINDS.calibration.map((ending) => `.${ending}`).join(",");

// Files that systems and cameras put beside others, and that are not meant to be sent.
const BESIDE = /^(\._.*|__macosx|desktop\.ini|thumbs\.db|.*\.(lrv|lrf|thm|insv))$/i;

const paths = new WeakMap(); // of dropped files, with their folders

export const readPath = (file) => paths.get(file) ?? (file.webkitRelativePath || file.name);
export const isPassedOver = (path) => path.split("/").some((name) => BESIDE.test(name));

const readFolders = (file) => readPath(file).split("/").slice(0, -1);

// Names of files, by file; each once where folders tell files of one name apart: `left_DCIM_GX010042.MP4`.
export function uniqueNames(files) {
  const all = [...files];
  const isOther = (one, other) => one.name === other.name && readPath(one) !== readPath(other) && readFolders(one).length > 0 && readFolders(other).length > 0;
  const alike = all.filter((file) => all.some((other) => isOther(file, other)));
  const folders = alike.map(readFolders);
  let shared = 0;
  while (folders.length && folders.every((path) => shared < path.length && path[shared] === folders[0][shared])) shared += 1;
  return new Map(all.map((file) => [file, alike.includes(file) ? readPath(file).split("/").slice(shared).join("_") : file.name]));
}

const fileEnding = (name) => name.slice(name.lastIndexOf(".") + 1).toLowerCase();

// True if a file of points is a laboratory's: a C3D file beside videos or keypoints.
export const isLaboratory = (row, rows) => row.kind === "points" && /\.c3d$/i.test(row.name) && rows.some(({ kind, isUsed }) => isUsed && ["video", "keypoints", "array"].includes(kind));

// Files that belong to one camera, by their kinds.
export const needsCamera = ({ kind }) => kind === "video" || kind === "keypoints";

// Kind of a file; null for a file that belongs to no capture.
export async function detectKind(file) {
  const ending = fileEnding(file.name);
  if (ending === "zip") return kindOfZip(await file.slice(-TAIL_BYTES).arrayBuffer());
  if (ARRAY.test(file.name)) return "array";
  if (POINTS.includes(ending) || /3d.*\.npy$/i.test(file.name)) return "points";
  const head = POINT_HEADS[ending] || OWN_POINTS[ending] ? await file.slice(0, HEAD_BYTES).text() : "";
  if (OWN_POINTS[ending]?.test(head)) return "ownPoints";
  if (POINT_HEADS[ending]?.test(head)) return "points";
  const found = Object.entries(KINDS).find(([, endings]) => endings.includes(ending));
  return found?.[0] ?? (file.type.startsWith("video/") ? "video" : null);
}

// A zip has the images of a camera in place of its video, or its keypoints, or it is a calibration of several files.
function kindOfZip(tail) {
  const text = new TextDecoder("latin1").decode(tail);
  const bytes = new DataView(tail);
  const names = [];
  for (let at = text.indexOf(ENTRY); at >= 0 && at + NAME_AT < tail.byteLength; at = text.indexOf(ENTRY, at + 1)) {
    names.push(text.substr(at + NAME_AT, bytes.getUint16(at + NAME_LENGTH_AT, true)));
  }
  const endings = new Set(names.map(fileEnding));
  if (IMAGES.some((ending) => endings.has(ending))) return "video";
  return KEYPOINTS.some((ending) => endings.has(ending)) || names.some((name) => LABELS.test(name)) ? "keypoints" : "calibration";
}

// All files of what was dropped, also those in dropped folders.
export async function droppedFiles(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (entries.length === 0) return [...transfer.files];
  const files = [];
  for (const entry of entries) await walk(entry, files);
  if (files.length > MOST_FILES) {
    throw new RequestProblem({ detail: SEND.folders.tooMany(MOST_FILES), hint: SEND.folders.tooManyHint }, 413);
  }
  return files;
}

async function walk(entry, files) {
  if (files.length > MOST_FILES || (entry.name.startsWith(".") && !isPassedOver(entry.name))) return;
  if (entry.isFile) {
    const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
    paths.set(file, entry.fullPath.replace(/^\//, ""));
    files.push(file);
    return;
  }
  const reader = entry.createReader();
  // A reader gives a folder in pieces, and an empty piece at the end.
  for (;;) {
    const piece = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (piece.length === 0) return;
    for (const child of piece) await walk(child, files);
  }
}

// Files that were dropped or chosen, as rows of a draft.

const MOST_SHOWN = 6;

const pick = ({ camera, isUsed, isJoined, offset_s, rate, url, sent, isSent }) => ({ camera, isUsed, isJoined, offset_s, rate, url, sent, isSent });

// Add files to a draft, and return the calibration file among them, or null. Sentences about files that are left out or
// replaced are added to `notes`, `forget(row)` hears of a row that another file replaces, and nothing is added once
// `isOver()`.
export async function addFiles(draft, chosen, { notes, forget, isOver }) {
  const [beside, files] = [true, false].map((isBeside) => [...chosen].filter((file) => isPassedOver(readPath(file)) === isBeside));
  const kinds = await Promise.all(files.map(detectKind));
  const counts = await Promise.all(files.map((file, index) => (kinds[index] === "video" ? countFrames(file) : null)));
  if (isOver()) return null;
  const filesByKind = (kind) => files.filter((file, index) => kinds[index] === kind);
  const names = uniqueNames([...draft.rows.map(({ file }) => file).filter(Boolean), ...files]);
  for (const row of draft.rows) if (row.file && !row.url && !row.isActive) row.name = names.get(row.file);
  const [calibrations, others] = [filesByKind("calibration"), filesByKind(null)];
  const added = new Set();
  files.forEach((file, index) => {
    const [kind, name] = [kinds[index], names.get(file)];
    if (kind === null || kind === "calibration") return;
    if (added.has(name)) notes.push(SEND.notes.sameName(name));
    else addRow(draft, file, { name, kind, numFrames: counts[index] }, { notes, forget });
    added.add(name);
  });
  if (calibrations.length > 1) {
    notes.push(SEND.notes.calibrations(calibrations.map(({ name }) => name).join(", ")));
  }
  if (others.length) {
    notes.push(SEND.notes.leftOut(others.map(({ name }) => name).join(", ")));
  }
  if (beside.length) {
    const shown = beside.slice(0, MOST_SHOWN).map(({ name }) => name).join(", ");
    notes.push(SEND.notes.beside(`${shown}${beside.length > MOST_SHOWN ? ", …" : ""}`));
  }
  if (!draft.name && draft.rows.length) draft.name = folderName(files) ?? "";
  return calibrations[0] ?? null;
}

// A file continues with its own upload, and takes the place of another file of its name.
function addRow(draft, file, known, { notes, forget }) {
  // A file that is chosen again may come without its folders.
  const isAgain = (row) => row.file === null && isSame(row, file) && row.name.endsWith(`_${file.name}`);
  const at = draft.rows.findIndex((row) => row.name === known.name || isAgain(row));
  const facts = { size: file.size, modified: file.lastModified, ...known, name: draft.rows[at]?.name ?? known.name };
  if (at < 0) {
    draft.rows.push(makeRow(facts, file));
    return;
  }
  const row = draft.rows[at];
  if (isSame(row, file) && row.file !== null) return;
  if (!isSame(row, file)) {
    forget(row);
    notes.push(SEND.notes.replaced(facts.name));
  }
  draft.rows[at] = makeRow({ ...facts, ...pick(row) }, file);
}

// Name of the folder that the files were dropped or chosen with.
function folderName(files) {
  const [path] = [...files].map((file) => file.webkitRelativePath).filter(Boolean);
  return path?.split("/")[0] ?? null;
}

// The capture that is being put together, kept over a reload: all but the files, which the browser does not keep.

const DRAFT_KEY = "multicap.draft";

export const FACTS = ["name", "size", "modified", "kind", "numFrames", "camera", "isUsed", "isJoined", "offset_s", "rate", "url", "sent", "isSent"];

export function emptyDraft(kept = {}) {
  return {
    name: "", calibrationId: null, calibrateFrom: null, stature: "", board: emptyBoard(), clock: "declared", frameRate_hz: null, layout: null, units: null, up: null, laboratoryClock: null, spec: {}, rows: [],
    wasSending: false, calibrating: null, request: null, sessionId: null, ...kept,
  };
}

export function loadDraft() {
  const stored = storedDraft();
  return stored?.rows ? { ...emptyDraft(), ...stored, rows: stored.rows.map((row) => makeRow(row)) } : emptyDraft();
}

function storedDraft() {
  try {
    return JSON.parse(localStorage.getItem(DRAFT_KEY));
  } catch {
    return null; // storage is off, or holds something else
  }
}

export function saveDraft(draft) {
  const rows = draft.rows.map((row) => Object.fromEntries(FACTS.map((fact) => [fact, row[fact]])));
  try {
    localStorage.setItem(DRAFT_KEY, JSON.stringify({ ...draft, rows }));
  } catch { /* storage is off or full: the draft does not outlive the page */ }
}

// Row of the table of files. `file` is null after a reload, until the same file is chosen again.
export function makeRow(facts, file = null) {
  return {
    camera: null, isUsed: true, isJoined: false, offset_s: 0, rate: null, url: null, sent: 0, isSent: false, ...facts,
    file, preview: facts.kind === "video" && file?.type.startsWith("video/") ? URL.createObjectURL(file) : null, hasFailed: false, isActive: false,
  };
}

// A row may have the name of a file with its folders before.
export const isSame = (row, file) => row.name.endsWith(file.name) && row.size === file.size && row.modified === file.lastModified;
