// Files that were dropped or chosen, as rows of a draft.

import { isSame, rowOf } from "./draft.js";
import { isPassedOver, kindOf, namesOf, pathOf } from "./files.js";
import { numFramesOf } from "./frame_count.js";

const MOST_SHOWN = 6;

const pick = ({ camera, isUsed, isJoined, offset_s, rate, url, sent, isSent }) => ({ camera, isUsed, isJoined, offset_s, rate, url, sent, isSent });

// Add files to a draft, and return the calibration file among them, or null. Sentences about files that are left out or
// replaced are added to `notes`, `forget(row)` hears of a row that another file replaces, and nothing is added once
// `isOver()`.
export async function addFiles(draft, chosen, { notes, forget, isOver }) {
  const [beside, files] = [true, false].map((isBeside) => [...chosen].filter((file) => isPassedOver(pathOf(file)) === isBeside));
  const kinds = await Promise.all(files.map(kindOf));
  const counts = await Promise.all(files.map((file, index) => (kinds[index] === "video" ? numFramesOf(file) : null)));
  if (isOver()) return null;
  const filesOf = (kind) => files.filter((file, index) => kinds[index] === kind);
  const names = namesOf([...draft.rows.map(({ file }) => file).filter(Boolean), ...files]);
  for (const row of draft.rows) if (row.file && !row.url && !row.isActive) row.name = names.get(row.file);
  const [calibrations, others] = [filesOf("calibration"), filesOf(null)];
  const added = new Set();
  files.forEach((file, index) => {
    const [kind, name] = [kinds[index], names.get(file)];
    if (kind === null || kind === "calibration") return;
    if (added.has(name)) notes.push(`Two files have the name ${name}. Rename one of them.`);
    else addRow(draft, file, { name, kind, numFrames: counts[index] }, { notes, forget });
    added.add(name);
  });
  if (calibrations.length > 1) {
    notes.push(`Several files may be the calibration: ${calibrations.map(({ name }) => name).join(", ")}. The first is used.`);
  }
  if (others.length) {
    notes.push(`Left out: ${others.map(({ name }) => name).join(", ")}. A capture has videos, or zips of images or of keypoints, and a calibration.`);
  }
  if (beside.length) {
    const shown = beside.slice(0, MOST_SHOWN).map(({ name }) => name).join(", ");
    notes.push(`Passed over, as systems and cameras put them beside videos: ${shown}${beside.length > MOST_SHOWN ? ", …" : ""}.`);
  }
  if (!draft.name && draft.rows.length) draft.name = folderOf(files) ?? "";
  return calibrations[0] ?? null;
}

// A file goes on with its own upload, and takes the place of another file of its name.
function addRow(draft, file, known, { notes, forget }) {
  // A file that is chosen again may come without its folders.
  const isAgain = (row) => row.file === null && isSame(row, file) && row.name.endsWith(`_${file.name}`);
  const at = draft.rows.findIndex((row) => row.name === known.name || isAgain(row));
  const facts = { size: file.size, modified: file.lastModified, ...known, name: draft.rows[at]?.name ?? known.name };
  if (at < 0) {
    draft.rows.push(rowOf(facts, file));
    return;
  }
  const row = draft.rows[at];
  if (isSame(row, file) && row.file !== null) return;
  if (!isSame(row, file)) {
    forget(row);
    notes.push(`${facts.name} takes the place of the file of this name.`);
  }
  draft.rows[at] = rowOf({ ...facts, ...pick(row) }, file);
}

// Name of the folder that the files were dropped or chosen with.
function folderOf(files) {
  const [path] = [...files].map((file) => file.webkitRelativePath).filter(Boolean);
  return path?.split("/")[0] ?? null;
}
