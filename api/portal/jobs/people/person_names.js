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

// Name of a person; people taken away by a later edit have the name that an edit gave them last. Null: a new person who is gone.
export function personName(id, { people, edits, outcomes }) {
  if (id === null) return PEOPLE.gone;
  const given = edits.findLast(({ action }, index) => action === "rename" && outcomes[index]?.person === id)?.name;
  return people.find((person) => person.id === id)?.name ?? given ?? `person-${id}`;
}

// An edit in words, with the present names of people. `outcome` has the numbers of an edit that names people by places, and `first`
// is the frame of the session with which the edit's frames are counted.
export function describe(edit, document, { outcome = edit, first = 0 } = {}) {
  const person = personName(outcome.person ?? null, document);
  const other = personName(outcome.other ?? null, document);
  const inRun = (frame) => (frame === null ? null : frame - first);
  const { start_frame: start, stop_frame: stop = null } = edit;
  const words = {
    rename: () => PEOPLE.actions.rename(outcome.person ?? null, edit.name),
    remove: () => PEOPLE.actions.remove(person),
    merge: () => PEOPLE.actions.merge(other, person),
    split: () => PEOPLE.actions.split(person, inRun(edit.frame)),
    exchange: () => PEOPLE.actions.exchange(person, other, inRun(start), inRun(stop)),
    cut: () => PEOPLE.actions.cut(inRun(start), inRun(stop)),
    key: () => PEOPLE.actions.key(person, edit.joint, inRun(edit.frame)),
    ignore_detections: () => PEOPLE.actions.ignoreDetections(person, edit.part, edit.camera, inRun(start), inRun(stop)),
    place_detection: () => PEOPLE.actions.placeDetection(person, edit.joint, edit.camera, inRun(edit.frame)),
    exchange_sides: () => PEOPLE.actions.exchangeSides(person, edit.part, inRun(start), inRun(stop)),
    contact: () => PEOPLE.actions.contact(person, edit.limb, edit.stands, inRun(start), inRun(stop)),
    describe: () => PEOPLE.actions.describe(person, edit.sex, edit.mass_kg),
    accept: () => PEOPLE.actions.accept(edit.camera ?? person, inRun(start), inRun(stop)),
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
