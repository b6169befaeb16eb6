// Offers of the service to captures: choices, calibrations, characters.

import { call, jsonPart } from "./api.js";
import { day } from "./format.js";
import { FORMATS } from "./strings/common.js";
import { OPTIONS } from "./strings/send.js";

const KEPT_MS = 30_000;

let options = null;
let readAt = -Infinity;

export async function readOptions() {
  if (performance.now() - readAt > KEPT_MS) {
    options = await call("/v1/options");
    readAt = performance.now();
  }
  return options;
}

export function choiceText(choice, value) {
  const label = (item) => choice.values.find(({ name }) => name === item)?.label ?? String(item);
  return Array.isArray(value) ? value.map((item) => label(item ?? "…")).join(", ") : label(value);
}

// Choices of a spec that differ from the defaults, as words; an empty list if none does.
export function describeSpec(spec, { choices }) {
  const differs = (choice) => JSON.stringify(spec[choice.name] ?? null) !== JSON.stringify(choice.default ?? null);
  const describe = (choice) => (choice.kind === "flag"
    ? { label: spec[choice.name] ? OPTIONS.with : OPTIONS.without, value: choice.label }
    : { label: choice.label, value: choiceText(choice, spec[choice.name]) });
  const changed = choices.filter((choice) => choice.name in spec && differs(choice)).map(describe);
  return spec.character ? [...changed, { label: OPTIONS.with, value: OPTIONS.aCharacter }] : changed;
}

// Stored calibrations as lists for people.

const MOST = 100;

export const readCalibrations = async () => (await call(`/v1/calibrations?limit=${MOST}`)).calibrations;

// Calibrations of which none has the cameras of another: the newest of equal ones, each as `{ newest, all }`.
export function distinct(calibrations) {
  const groups = new Map();
  for (const calibration of calibrations) {
    const key = calibration.sha256 ?? calibration.id;
    if (groups.has(key)) groups.get(key).all.push(calibration);
    else groups.set(key, { newest: calibration, all: [calibration] });
  }
  return [...groups.values()];
}

// Calibrations that can reconstruct, equal ones once.
export function usable(calibrations) {
  const isUsable = ({ state, report }) => state === "ready" && report?.has_extrinsics !== false;
  return distinct(calibrations.filter(isUsable)).map(({ newest }) => newest);
}

// Name and day of a calibration, as in a list to choose from, and a list of them for a field.
export const dated = ({ name, created_at: created }) => (created ? FORMATS.dated(name, day(created)) : name);
export const listed = (calibrations) => calibrations.map((calibration) => [calibration.id, dated(calibration)]);

// The characters of one's own: their list, and those that were opened, with their bones.

const MOST_CHARACTERS = 100;

class CharacterShelf extends EventTarget {
  list = null; // newest first; null until it is loaded
  opened = new Map(); // characters with their bones, by id
  reading = null; // name of the file that is read
  problem = null;
  #showsBones = false;

  // True if forms show bones: a character may have hundreds, each in the list of each joint.
  get showsBones() { return this.#showsBones; }

  set showsBones(isShown) {
    if (isShown === this.#showsBones) return;
    this.#showsBones = isShown;
    this.#changed();
  }

  // Load the list, and the character of a spec with its bones. One that was deleted since is taken out of the spec.
  async load(spec) {
    const { character: id } = spec;
    await this.#try(async () => {
      this.list ??= (await call(`/v1/characters?limit=${MOST_CHARACTERS}`)).characters;
      if (!id) return;
      if (!this.list.some((character) => character.id === id)) delete spec.character;
      else if (!this.opened.has(id)) this.opened.set(id, await call(`/v1/characters/${id}`));
    });
  }

  // Character of a new file; null if it is refused, and `problem` says why.
  async add(file) {
    this.reading = file.name;
    const form = new FormData();
    form.append("character", file, file.name);
    form.append("spec", jsonPart({}));
    const added = await this.#try(() => call("/v1/characters", { method: "POST", form }));
    this.reading = null;
    if (added) {
      this.opened.set(added.id, added);
      this.list = [added, ...(this.list ?? [])];
    }
    this.#changed();
    return added;
  }

  // Bone of a joint as the user corrects it; null: the joint has none.
  async correct({ urls, corrections }, joint, bone) {
    const changed = await this.#try(() => call(urls.self, { method: "PATCH", body: { bones: { ...corrections, [joint]: bone } } }));
    if (changed) this.opened.set(changed.id, changed);
    this.#changed();
  }

  async #try(task) {
    this.problem = null;
    this.#changed();
    try {
      return await task();
    } catch (problem) {
      this.problem = problem;
      return null;
    } finally {
      this.#changed();
    }
  }

  #changed() { this.dispatchEvent(new Event("change")); }
}

export const characters = new CharacterShelf();
