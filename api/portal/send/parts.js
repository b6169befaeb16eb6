// Files that are the parts of one recording, by their names: the rule of pipeline/capture/parts.py. The same table of
// cases tests both.

import { naturalOrder } from "./matching.js";

// Runs of ASCII letters and digits; all else ends a word, as it does for the service.
const PATTERNS = [
  /(?<kind>g[hxls])(?<part>\d\d)(?<file>\d{4})/,
  /(?<kind>gopr|gp(?<part>\d\d))(?<file>\d{4})/,
  /(?<kind>g[hx][a-z]{2})(?<part>\d{4})/,
  /(?<kind>part|pt)[ _.-]*(?<part>\d{1,4})/,
].map(({ source }) => new RegExp(`^(?<head>(?:.*[^a-z0-9])?)${source}(?<tail>(?:[^a-z0-9].*)?)$`, "s"));

// Place of a file in its recording; null if its name tells of no recording in parts.
function partOf(name) {
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
export function recordingsOf(names) {
  const found = new Map();
  const alone = [];
  for (const name of [...names].sort(naturalOrder)) {
    const part = partOf(name);
    const parts = part && (found.get(part.recording) ?? new Map());
    if (part === null || parts.has(part.number)) alone.push([name]);
    else found.set(part.recording, parts.set(part.number, name));
  }
  const recordings = [...found.values()].map((parts) => [...parts].sort(([a], [b]) => a - b).map(([, name]) => name));
  return [...alone, ...recordings].sort(([one], [other]) => naturalOrder(one, other));
}
