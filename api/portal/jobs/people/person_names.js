// Edits of people as words, and people by their numbers.

import { PEOPLE } from "../../shared/strings/take.js";

const HUE_STEP = 0.618034; // as in pipeline/export/scene.py

// Colour of a person by number, as in the 3D view and of the exported models.
export function personColor(id) {
  const hue = ((id * HUE_STEP) % 1) * 6;
  const part = (shift) => {
    const distance = (shift + hue) % 6;
    return Math.round(255 * (1 - 0.85 * Math.max(0, Math.min(distance, 4 - distance, 1))));
  };
  return `#${[5, 3, 1].map((shift) => part(shift).toString(16).padStart(2, "0")).join("")}`;
}

// Name of a person; people taken away by a later edit have the name that an edit gave them last.
export function personName(id, { people, edits }) {
  const given = edits.findLast(({ action, person }) => action === "rename" && person === id)?.name;
  return people.find((person) => person.id === id)?.name ?? given ?? `person-${id}`;
}

// An edit in words, with the present names of people.
export function describe(edit, document) {
  const person = personName(edit.person, document);
  const other = personName(edit.other, document);
  const { start_frame: start, stop_frame: stop = null } = edit;
  const words = {
    rename: () => PEOPLE.actions.rename(edit.person, edit.name),
    remove: () => PEOPLE.actions.remove(person),
    merge: () => PEOPLE.actions.merge(other, person),
    split: () => PEOPLE.actions.split(person, edit.frame),
    exchange: () => PEOPLE.actions.exchange(person, other, start, stop),
    cut: () => PEOPLE.actions.cut(start, stop),
  };
  return words[edit.action]();
}

// Number of frames of a person, of the whole reconstruction.
export function numFrames({ pieces }) {
  return pieces.reduce((sum, { start_frame: start, stop_frame: stop }) => sum + stop - start, 0);
}

// Frames in which two people are there: how many, the first and the last one.
export function sharedFrames(person, other) {
  let [num, first, last] = [0, Infinity, -Infinity];
  for (const piece of person.pieces) {
    for (const theirs of other.pieces) {
      const [start, stop] = [Math.max(piece.start_frame, theirs.start_frame), Math.min(piece.stop_frame, theirs.stop_frame)];
      if (start >= stop) continue;
      num += stop - start;
      [first, last] = [Math.min(first, start), Math.max(last, stop - 1)];
    }
  }
  return { num, first, last };
}

// Whether the edits after this one would be of other people without it: a split gives the next free number.
export function isNumbering(edits, index) {
  return edits[index].action === "split" && edits.slice(index + 1).some(({ action }) => action !== "cut");
}
