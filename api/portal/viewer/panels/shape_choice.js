// Choice of what people look like in the 3D view: humans, capsules, or the job's character, which is loaded when it is chosen.

import { el } from "../dom.js";

const LABELS = { human: "Humans", capsule: "Capsules", character: "My character" };
const MB = 1e6;

export class ShapeChoice {
  #viewer;
  #source;
  #usual; // shape that is shown without the character
  #files = []; // of the character, one a person
  #loading = new AbortController();

  constructor(viewer, source) {
    this.#viewer = viewer;
    this.#source = source;
    const shapes = viewer.description.body ? ["human", "capsule"] : ["capsule"];
    [this.#usual] = shapes;
    this.select = el("select", { class: "look-select", onchange: () => this.choose(this.select.value) },
      shapes.map((shape) => el("option", { value: shape }, LABELS[shape])));
    this.element = el("label", {}, "Bodies as ", this.select);
    this.progress = el("progress", { class: "look-progress", max: 1, value: 0, "aria-label": "Loading the character" });
    this.#showState(false);
  }

  /** Offer the character, if the job has one; if it is shown, load it again: its files are new. */
  async renew() {
    const isChosen = this.select.value === "character";
    if (isChosen) this.#showUsual();
    const { signal } = this.#begin();
    try {
      const files = await this.#source?.characters?.(signal) ?? [];
      if (signal.aborted) return;
      this.#offer(files);
      if (isChosen) await this.choose(files.length > 0 ? "character" : this.#usual);
    } catch (problem) {
      if (!signal.aborted) this.#fail(problem);
    }
  }

  /** Show people in a shape. Another choice ends the loading of the character, or frees its memory. */
  async choose(shape) {
    const { signal } = this.#begin();
    this.select.value = shape;
    if (shape !== "character") {
      this.#usual = shape;
      this.#showUsual();
      this.#viewer.view?.characters.clear();
      this.#viewer.say("");
      return;
    }
    this.#showState(true);
    this.#viewer.say("Loading the character …");
    try {
      await this.#viewer.view.characters.load(this.#files, signal, (share) => { this.progress.value = share; });
      this.#viewer.view.showAs("character");
      this.#viewer.say("");
    } catch (problem) {
      if (!signal.aborted) this.#fail(problem);
    } finally {
      if (!signal.aborted) this.#showState(false);
    }
  }

  close() {
    this.#loading.abort();
  }

  #begin() {
    this.#loading.abort();
    this.#loading = new AbortController();
    this.#showState(false);
    return this.#loading;
  }

  #offer(files) {
    this.#files = files;
    this.select.querySelector("[value=character]")?.remove();
    const numBytes = files.reduce((sum, file) => sum + file.numBytes, 0);
    const size = `${(numBytes / MB).toFixed(1)} MB`;
    // The mesh is read once, though each file has it.
    if (files.length > 0) this.select.append(el("option", { value: "character" }, `${LABELS.character} (${files.length > 1 ? "up to " : ""}${size})`));
    this.#showState(false);
  }

  #showUsual() {
    this.#viewer.view?.showAs(this.#usual);
  }

  #fail({ message }) {
    this.select.value = this.#usual;
    this.#showUsual();
    this.#viewer.view?.characters.clear();
    this.#viewer.say(`The character can't be shown: ${message}`);
  }

  #showState(isLoading) {
    this.progress.hidden = !isLoading;
    this.progress.value = 0;
    this.element.hidden = this.select.options.length < 2;
  }
}
