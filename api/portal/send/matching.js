// Cameras' names in the names of files: the rule of pipeline/capture/names.py. The same table of cases tests both.

import { stem } from "../shared/format.js";
import { isPassedOver, readPath } from "./files.js";

const isNumber = (run) => /^[0-9]/.test(run);
const splitRuns = (text) => text.match(/[0-9]+|[^0-9]+/g) ?? [];
// Upper case first unites letters of one lower-case form, such as ß and ss, as case folding does.
const folded = (name) => name.normalize("NFC").toUpperCase().toLowerCase().replaceAll("ς", "σ").normalize("NFC");
const splitWords = (name) => folded(name).match(/[\p{L}\p{M}\p{N}]+/gu) ?? [];

// Order of names in which digits count as numbers, and case is ignored.
export function naturalOrder(one, other) {
  const [left, right] = [one, other].map((name) => splitRuns(folded(name)));
  for (let at = 0; at < Math.min(left.length, right.length); at += 1) {
    const [a, b] = [left[at], right[at]];
    if (isNumber(a) !== isNumber(b)) return isNumber(a) ? -1 : 1;
    const [first, second] = isNumber(a) ? [BigInt(a), BigInt(b)] : [a, b];
    if (first !== second) return first < second ? -1 : 1;
  }
  return left.length - right.length || (one < other ? -1 : Number(one !== other));
}

// Keys of the words `start <= k < stop` with each `stop`: runs of letters and of digits. Letters of adjoining words are
// one run.
function* keysFrom(words, start, mostRuns, { withZeros }) {
  const runs = [];
  for (let at = start; at < words.length; at += 1) {
    for (const run of splitRuns(words[at])) {
      if (isNumber(run)) runs.push(withZeros ? run : run.replace(/^0+(?=.)/, ""));
      else if (runs.length && !isNumber(runs.at(-1))) runs.push(runs.pop() + run);
      else runs.push(run);
    }
    if (runs.length > mostRuns) return;
    yield [at + 1, runs.join("\0")];
  }
}

// Places of cameras' names among the words of a file's name, without those inside a longer name.
function findSpans(words, cameras, options) {
  const known = new Map();
  let mostRuns = 0;
  for (const camera of cameras) {
    const key = [...keysFrom(splitWords(camera), 0, Infinity, options)].at(-1)?.[1];
    if (!key) continue;
    mostRuns = Math.max(mostRuns, key.split("\0").length);
    known.set(key, [...(known.get(key) ?? []), camera]);
  }
  const spans = [];
  for (let start = 0; start < words.length; start += 1) {
    for (const [stop, key] of keysFrom(words, start, mostRuns, options)) {
      for (const camera of known.get(key) ?? []) spans.push({ start, stop, camera });
    }
  }
  const isInside = (span) => spans.some(({ start, stop }) => start <= span.start && span.stop <= stop && stop - start > span.stop - span.start);
  return spans.filter((span) => !isInside(span));
}

// Numbers of words that all names share at their start and at their end; none if there is one name.
function numShared(names) {
  if (names.length < 2) return [0, 0];
  const count = (all) => {
    let at = 0;
    while (all.every((words) => at < words.length && words[at] === all[0][at])) at += 1;
    return at;
  };
  return [count(names), count(names.map((words) => [...words].reverse()))];
}

const listCameras = (spans) => [...new Set(spans.map(({ camera }) => camera))];

// Cameras whose names are whole words in the name of each file, by the file's name: one, none, or several if the name is
// ambiguous.
export function camerasInNames(names, cameras) {
  const split = names.map((name) => splitWords(stem(name)));
  const [numLeft, numRight] = numShared(split);
  return new Map(names.map((name, index) => {
    const exact = cameras.find((camera) => camera.normalize("NFC") === stem(name).normalize("NFC"));
    if (exact !== undefined) return [name, [exact]];
    const words = split[index];
    const strict = findSpans(words, cameras, { withZeros: true });
    const spans = strict.length ? strict : findSpans(words, cameras, { withZeros: false });
    const found = listCameras(spans);
    if (found.length < 2) return [name, found];
    const telling = listCameras(spans.filter(({ start, stop }) => stop > numLeft && start < words.length - numRight));
    return [name, telling.length ? telling : found];
  }));
}

// Camera by name of a file, where the file has the name of one camera, and no other file has it.
export function matchCameras(names, cameras) {
  const found = [...camerasInNames(names, cameras)].filter(([, list]) => list.length === 1).map(([name, [camera]]) => [name, camera]);
  return new Map(found.filter(([name, camera]) => !found.some(([other, same]) => other !== name && same === camera)));
}

// Camera by name of a file, both in the natural order of their names.
export function inOrder(names, cameras) {
  const sorted = [...cameras].sort(naturalOrder);
  const order = [...names].sort((one, other) => naturalOrder(stem(one), stem(other)));
  return new Map(order.map((name, index) => [name, sorted[index]]));
}

// Files that are the parts of one recording, by their names: the rule of pipeline/capture/parts.py. The same table of
// cases tests both.

// Runs of ASCII letters and digits; all else ends a word, as it does for the service.
const PATTERNS = [
  /(?<kind>g[hxls])(?<part>\d\d)(?<file>\d{4})/,
  /(?<kind>gopr|gp(?<part>\d\d))(?<file>\d{4})/,
  /(?<kind>g[hx][a-z]{2})(?<part>\d{4})/,
  /(?<kind>part|pt)[ _.-]*(?<part>\d{1,4})/,
].map(({ source }) => new RegExp(`^(?<head>(?:.*[^a-z0-9])?)${source}(?<tail>(?:[^a-z0-9].*)?)$`, "s"));

// Place of a file in its recording; null if its name tells of no recording in parts.
function parsePart(name) {
  const folded = name.normalize("NFC").toLowerCase();
  for (const [index, pattern] of PATTERNS.entries()) {
    const found = pattern.exec(folded)?.groups;
    if (!found) continue;
    const kind = found.kind.startsWith("gp") ? "gopr" : found.kind;
    return { recording: JSON.stringify([index, found.head, kind, found.file ?? "", found.tail]), number: Number(found.part ?? 0) };
  }
  return null;
}

// Names of files, without endings, sorted into recordings, each with its parts in order; most recordings are one file.
export function groupRecordings(names) {
  const found = new Map();
  const alone = [];
  for (const name of [...names].sort(naturalOrder)) {
    const part = parsePart(name);
    const parts = part && (found.get(part.recording) ?? new Map());
    if (part === null || parts.has(part.number)) alone.push([name]);
    else found.set(part.recording, parts.set(part.number, name));
  }
  const recordings = [...found.values()].map((parts) => [...parts].sort(([a], [b]) => a - b).map(([, name]) => name));
  return [...alone, ...recordings].sort(([one], [other]) => naturalOrder(one, other));
}

// Folders of dropped files: whether they are takes.

const VIEWS = ["video", "keypoints"];
const MIN_RECORDINGS = 2;

// Takes among files, in the natural order of their folders, and the files beside these folders; null if no two folders
// have videos of several cameras. `kinds` are the kinds of the files.
export function takesIn(files, kinds) {
  const kept = files.map((file, index) => ({ file, kind: kinds[index], folders: readPath(file).split("/").slice(0, -1) })).filter(({ file }) => !isPassedOver(readPath(file)));
  let depth = 0;
  while (kept.length && kept.every(({ folders }) => depth < folders.length && folders[depth] === kept[0].folders[depth])) depth += 1;
  const groups = new Map();
  for (const one of kept) groups.set(one.folders[depth], [...(groups.get(one.folders[depth]) ?? []), one]);
  const numRecordings = (group) => groupRecordings(group.filter(({ kind }) => VIEWS.includes(kind)).map(({ file }) => stem(file.name))).length;
  const named = [...groups].filter(([name]) => name !== undefined).sort(([one], [other]) => naturalOrder(one, other));
  if (named.filter(([, group]) => numRecordings(group) >= MIN_RECORDINGS).length < 2) return null;
  const takes = named.filter(([, group]) => numRecordings(group) > 0).map(([name, group]) => ({
    name, files: group.map(({ file }) => file), hasCalibration: group.some(({ kind }) => kind === "calibration"),
  }));
  const used = new Set(takes.flatMap((take) => take.files));
  return { takes, beside: kept.map(({ file }) => file).filter((file) => !used.has(file)) };
}
