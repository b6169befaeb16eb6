// Cameras' names in the names of files: the rule of pipeline/capture/names.py. The same table of cases tests both.

import { stem } from "../shared/format.js";

const isNumber = (run) => /^[0-9]/.test(run);
const runsOf = (text) => text.match(/[0-9]+|[^0-9]+/g) ?? [];
// Upper case first unites letters of one lower-case form, such as ß and ss, as case folding does.
const folded = (name) => name.normalize("NFC").toUpperCase().toLowerCase().replaceAll("ς", "σ").normalize("NFC");
const wordsOf = (name) => folded(name).match(/[\p{L}\p{M}\p{N}]+/gu) ?? [];

// Order of names in which digits count as numbers, and case is ignored.
export function naturalOrder(one, other) {
  const [left, right] = [one, other].map((name) => runsOf(folded(name)));
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
    for (const run of runsOf(words[at])) {
      if (isNumber(run)) runs.push(withZeros ? run : run.replace(/^0+(?=.)/, ""));
      else if (runs.length && !isNumber(runs.at(-1))) runs.push(runs.pop() + run);
      else runs.push(run);
    }
    if (runs.length > mostRuns) return;
    yield [at + 1, runs.join("\0")];
  }
}

// Places of cameras' names among the words of a file's name, without those inside a longer name.
function spansOf(words, cameras, options) {
  const known = new Map();
  let mostRuns = 0;
  for (const camera of cameras) {
    const key = [...keysFrom(wordsOf(camera), 0, Infinity, options)].at(-1)?.[1];
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

const camerasOf = (spans) => [...new Set(spans.map(({ camera }) => camera))];

// Cameras whose names are whole words in the name of each file, by the file's name: one, none, or several if the name is
// ambiguous.
export function camerasInNames(names, cameras) {
  const split = names.map((name) => wordsOf(stem(name)));
  const [numLeft, numRight] = numShared(split);
  return new Map(names.map((name, index) => {
    const exact = cameras.find((camera) => camera.normalize("NFC") === stem(name).normalize("NFC"));
    if (exact !== undefined) return [name, [exact]];
    const words = split[index];
    const strict = spansOf(words, cameras, { withZeros: true });
    const spans = strict.length ? strict : spansOf(words, cameras, { withZeros: false });
    const found = camerasOf(spans);
    if (found.length < 2) return [name, found];
    const telling = camerasOf(spans.filter(({ start, stop }) => stop > numLeft && start < words.length - numRight));
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
