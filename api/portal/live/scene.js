// People of a live capture in 3D, with the scene of the viewer.

import { el } from "../viewer/dom.js";
import { graphics } from "../viewer/graphics.js";
import { directionBar } from "../viewer/panels/view_controls.js";
import { SceneView } from "../viewer/scene/view.js";
import { LiveStore } from "./store.js";

/**
 * 3D view of a live capture in an element.
 *
 * `ready` is the message `ready` of the service, `rateHz` the rate of the instants. `element.dataset.people` has the number of
 * people who are drawn.
 */
export class LiveScene {
  #store;
  #view = null;
  #isOpen = true;
  #isDrawn = true; // whether the latest instant is drawn
  #isNew = false; // whether people came or left since
  #isAimed = false; // whether the view was turned to the first people

  constructor(element, ready, rateHz) {
    this.element = element;
    this.#store = new LiveStore(ready, rateHz);
    if (!graphics().hasWebGL) {
      element.replaceChildren(el("p", { class: "look-no-3d" }, "This browser draws no 3D (WebGL 2)."));
      return;
    }
    const { cameras } = this.#store.description;
    this.description = { cameras };
    const canvas = el("canvas", { class: "look-canvas", tabindex: 0, role: "img", "aria-label": `3D view of the people whom ${cameras.length} cameras see now` });
    const layer = el("div", { class: "look-labels", "aria-hidden": "true" });
    this.bar = directionBar(this);
    element.replaceChildren(canvas, layer, el("div", { class: "look-overlay" }, this.bar.element));
    this.#view = new SceneView(canvas, layer, this.#store);
    this.#view.open(0);
    requestAnimationFrame((now) => this.#tick(now));
  }

  /** Show an instant, as `unpackInstant` gives it; of several between two pictures the last one is drawn. */
  show(instant) {
    this.#isNew = this.#store.add(instant) || this.#isNew;
    this.#isDrawn = false;
  }

  /** Look at everybody, from a named direction or as before. */
  fit(direction = null) {
    this.see(null);
    this.#view.fit(direction);
  }

  /** See through a camera, by its number; null: orbit again. */
  see(number) {
    this.#view.see(number);
    this.bar.showSeen(number);
  }

  close() {
    this.#isOpen = false;
    this.#view?.close();
  }

  #tick(now) {
    if (!this.#isOpen) return;
    if (!this.#isDrawn) this.#draw();
    this.#view.draw(now);
    requestAnimationFrame((next) => this.#tick(next));
  }

  #draw() {
    this.#isDrawn = true;
    if (this.#isNew) this.#view.replace(this.#store);
    this.#isNew = false;
    this.#view.show(this.#store.frame);
    const { people } = this.#store.description;
    this.element.dataset.people = people.length;
    if (this.#isAimed || people.length === 0) return;
    this.#isAimed = true;
    this.#view.fit();
  }
}
