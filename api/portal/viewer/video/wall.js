// All cameras' videos beside the 3D view.

import { el } from "../dom.js";
import { Tile } from "./tile.js";

// Largest share of the width that videos take beside the 3D view.
const WIDEST = 0.44;
const WIDEST_LARGE = 0.6;

export class Wall {
  #enlarged = null;

  constructor(viewer, source) {
    const { store, player } = viewer;
    const onthrough = (number) => viewer.see(viewer.seen === number ? null : number);
    const isShown = (person) => viewer.shown[person];
    this.tiles = store.description.cameras.map((camera, number) => new Tile(camera, number, store, player, { onthrough, isShown, onenlarge: (tile) => this.#enlarge(tile) }));
    this.element = el("div", { class: "look-wall", role: "group", "aria-label": "Videos" }, this.tiles.map((tile) => tile.element));
    for (const tile of this.tiles) this.#load(tile, source);
    this.resizing = new ResizeObserver(() => this.#arrange());
    this.resizing.observe(this.element);
    this.element.style.setProperty("--columns", 2);
  }

  /** Take the people of another store from now on; the videos go on. */
  replace(store) {
    for (const tile of this.tiles) tile.replace(store);
  }

  /** Bring all videos to the play head, and draw. */
  follow() {
    for (const tile of this.tiles) tile.follow();
  }

  /** Draw the skeletons anew: others are shown, or frames have come. */
  redraw() {
    for (const tile of this.tiles) tile.draw(true);
  }

  /** Whether a video is so late that the play head must wait. */
  isBehind(now) {
    // All are asked: each keeps how long it has been late.
    return this.tiles.filter((tile) => tile.isBehind(now)).length > 0;
  }

  /** Mark the camera that the 3D view looks through. */
  choose(number) {
    this.tiles.forEach((tile) => tile.element.classList.toggle("look-chosen", tile.number === number));
  }

  close() {
    this.resizing.disconnect();
    for (const tile of this.tiles) tile.close();
  }

  /** Take as many columns as show all pictures at their largest. */
  #arrange() {
    const { clientWidth: width, clientHeight: height } = this.element.parentElement;
    // Below the 3D view, on narrow screens, the style sheet arranges them.
    const room = { width: width * WIDEST, height };
    const heights = this.tiles.map(({ camera: { size_px: [w, h] } }) => h / w);
    const tallest = Math.max(...heights);
    let best = { columns: 1, size: 0 };
    for (let columns = 1; columns <= this.tiles.length; columns++) {
      const rows = Math.ceil(this.tiles.length / columns);
      const size = Math.min(room.width / columns, room.height / rows / tallest);
      if (size > best.size) best = { columns, size };
    }
    this.element.style.setProperty("--columns", best.columns);
    this.element.style.setProperty("--tile", `${Math.floor(best.size) - 5}px`);
    const large = this.#enlarged?.camera.size_px ?? [1, 1];
    this.element.style.setProperty("--large", `${Math.floor(Math.min(width * WIDEST_LARGE, (height * large[0]) / large[1]))}px`);
    this.tiles.forEach((tile) => tile.resize());
  }

  async #load(tile, source) {
    try {
      tile.setVideo(await source.video(tile.camera));
    } catch (error) {
      tile.note.textContent = error.message;
    }
  }

  #enlarge(tile) {
    this.#enlarged = this.#enlarged === tile ? null : tile;
    for (const other of this.tiles) {
      const isLarge = other === this.#enlarged;
      other.element.classList.toggle("look-large", isLarge);
      other.element.querySelector(".look-icon").setAttribute("aria-pressed", String(isLarge));
    }
    this.element.classList.toggle("look-has-large", this.#enlarged !== null);
    this.#arrange();
  }
}
