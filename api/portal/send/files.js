// Files of a capture: what they are, by their names.

import { RequestProblem } from "../shared/api.js";

const KINDS = {
  video: ["mp4", "mov", "m4v", "mkv", "webm", "avi", "ts", "mts", "m2ts", "mpg", "mpeg"],
  timestamps: ["csv"],
  calibration: ["toml", "json", "yml", "yaml", "xml", "txt", "npz", "pickle", "pkl"],
};
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

export const ACCEPTED = ["zip", "npy", ...Object.values(KINDS).flat()].map((ending) => `.${ending}`).concat("video/*").join(",");
// Axes of a calibration's world that may point up.
export const AXES = [["", "Z, or as the format states"], ...["x", "-x", "y", "-y", "-z"].map((axis) => [axis, axis.toUpperCase().replace("-", "−")])];
export const ACCEPTED_CALIBRATIONS = KINDS.calibration.map((ending) => `.${ending}`).join(",");

// Files that systems and cameras put beside others, and that nobody means to send.
const BESIDE = /^(\._.*|__macosx|desktop\.ini|thumbs\.db|.*\.(lrv|lrf|thm|insv))$/i;

const paths = new WeakMap(); // of dropped files, with their folders

export const pathOf = (file) => paths.get(file) ?? (file.webkitRelativePath || file.name);
export const isPassedOver = (path) => path.split("/").some((name) => BESIDE.test(name));

const foldersOf = (file) => pathOf(file).split("/").slice(0, -1);

// Names of files, by file; each once where folders tell files of one name apart: `left_DCIM_GX010042.MP4`.
export function namesOf(files) {
  const all = [...files];
  const isOther = (one, other) => one.name === other.name && pathOf(one) !== pathOf(other) && foldersOf(one).length > 0 && foldersOf(other).length > 0;
  const alike = all.filter((file) => all.some((other) => isOther(file, other)));
  const folders = alike.map(foldersOf);
  let shared = 0;
  while (folders.length && folders.every((path) => shared < path.length && path[shared] === folders[0][shared])) shared += 1;
  return new Map(all.map((file) => [file, alike.includes(file) ? pathOf(file).split("/").slice(shared).join("_") : file.name]));
}

const endingOf = (name) => name.slice(name.lastIndexOf(".") + 1).toLowerCase();

// Files that belong to one camera, by their kinds.
export const isOfCamera = ({ kind }) => kind === "video" || kind === "keypoints";

// Kind of a file; null for a file that belongs to no capture.
export async function kindOf(file) {
  const ending = endingOf(file.name);
  if (ending === "zip") return kindOfZip(await file.slice(-TAIL_BYTES).arrayBuffer());
  if (ARRAY.test(file.name)) return "array";
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
  const endings = new Set(names.map(endingOf));
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
    throw new RequestProblem({ detail: `The folders have more than ${MOST_FILES} files.`, hint: "Drop fewer takes at a time. Put the images or keypoints of a camera into a zip." }, 413);
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
