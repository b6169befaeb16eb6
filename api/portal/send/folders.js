// Folders of dropped files: whether they are takes.

import { stem } from "../shared/format.js";
import { isPassedOver, pathOf } from "./files.js";
import { naturalOrder } from "./matching.js";
import { recordingsOf } from "./parts.js";

const VIEWS = ["video", "keypoints"];
const MIN_RECORDINGS = 2;

// Takes among files, in the natural order of their folders, and the files beside these folders; null if no two folders
// have videos of several cameras. `kinds` are the kinds of the files.
export function takesIn(files, kinds) {
  const kept = files.map((file, index) => ({ file, kind: kinds[index], folders: pathOf(file).split("/").slice(0, -1) })).filter(({ file }) => !isPassedOver(pathOf(file)));
  let depth = 0;
  while (kept.length && kept.every(({ folders }) => depth < folders.length && folders[depth] === kept[0].folders[depth])) depth += 1;
  const groups = new Map();
  for (const one of kept) groups.set(one.folders[depth], [...(groups.get(one.folders[depth]) ?? []), one]);
  const numRecordings = (group) => recordingsOf(group.filter(({ kind }) => VIEWS.includes(kind)).map(({ file }) => stem(file.name))).length;
  const named = [...groups].filter(([name]) => name !== undefined).sort(([one], [other]) => naturalOrder(one, other));
  if (named.filter(([, group]) => numRecordings(group) >= MIN_RECORDINGS).length < 2) return null;
  const takes = named.filter(([, group]) => numRecordings(group) > 0).map(([name, group]) => ({
    name, files: group.map(({ file }) => file), hasCalibration: group.some(({ kind }) => kind === "calibration"),
  }));
  const used = new Set(takes.flatMap((take) => take.files));
  return { takes, beside: kept.map(({ file }) => file).filter((file) => !used.has(file)) };
}
