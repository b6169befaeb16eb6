// The characters of one's own: their list, and those that were opened, with their bones.

import { call, jsonPart } from "./api.js";

const MOST_CHARACTERS = 100;

class CharacterShelf extends EventTarget {
  list = null; // newest first; null until it is loaded
  opened = new Map(); // characters with their bones, by id
  reading = null; // name of the file that is read
  problem = null;
  #showsBones = false;

  // Whether forms show bones: a character may have hundreds, each in the list of each joint.
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

  // Bone of a joint as somebody knows better; null: the joint has none.
  async correct({ links, corrections }, joint, bone) {
    const changed = await this.#try(() => call(links.self, { method: "PATCH", body: { bones: { ...corrections, [joint]: bone } } }));
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
