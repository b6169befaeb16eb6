// Names over the 3D view: elements of the page, so that they stay sharp and can be read aloud.

import * as THREE from "../../vendor/three/three.module.js";
import { el } from "../dom.js";

export class Labels {
  #items = [];
  #place = new THREE.Vector3();

  constructor(stage, layer) {
    this.stage = stage;
    this.layer = layer;
    this.isShown = true;
  }

  /** Add a name at a point that may move; it is hidden while the point is NaN. */
  add(text, point, { color = null, kind }) {
    const element = el("span", { class: `look-label look-label-${kind}` }, text);
    if (color) element.style.setProperty("--tint", color);
    this.layer.append(element);
    const item = { element, point, kind, isShown: true };
    this.#items.push(item);
    return item;
  }

  /** Remove a name. */
  remove(item) {
    item.element.remove();
    this.#items = this.#items.filter((other) => other !== item);
  }

  /** Put all names where their points are in the picture. */
  draw() {
    for (const { element, point, isShown } of this.#items) {
      const isVisible = this.isShown && isShown && Number.isFinite(point.x) && this.stage.toScreen(point, this.#place);
      element.hidden = !isVisible;
      if (isVisible) element.style.transform = `translate(-50%, -100%) translate(${this.#place.x.toFixed(1)}px, ${this.#place.y.toFixed(1)}px)`;
    }
  }
}
