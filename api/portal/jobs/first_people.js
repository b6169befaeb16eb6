// First people of a job that runs, in 3D: they grow while cameras are read, and walk again and again until the take is there.

import { call } from "../shared/api.js";
import { length } from "../shared/format.js";
import { html, nothing, ref, render } from "../shared/lit.js";
import { TAKE } from "../shared/strings/take.js";

const RATE_HZ = 5; // as pipeline/run/engine/first_people.py
const AGAIN_MS = 3000;

export class FirstPeople {
  #instants = []; // of all ranges so far
  #at = 0; // instant that is shown next
  #next = 0; // number of the first range that was not read
  #head = null; // skeleton and cameras, as the first range has them
  #scene = null;
  #stage = null; // element of the 3D view
  #timers = [];
  #place;

  /** `path` is the address of the job. */
  constructor(place, path) {
    this.#place = place;
    this.#timers = [setInterval(() => this.#read(`${path}/motion/first-people`), AGAIN_MS), setInterval(() => this.#play(), 1000 / RATE_HZ)];
  }

  close() {
    this.#timers.forEach(clearInterval);
    this.#scene?.close();
    render(nothing, this.#place);
  }

  async #read(path) {
    if (document.hidden) return;
    const { ranges, next } = await call(`${path}?from=${this.#next}`).catch(() => ({ ranges: [], next: this.#next }));
    if (next <= this.#next) return; // an earlier answer had them
    this.#next = next;
    this.#head ??= ranges[0] ?? null;
    this.#instants.push(...ranges.flatMap(({ instants }) => instants));
    if (!this.#instants.some(({ people }) => people.length)) return;
    this.#draw();
    if (this.#scene !== null) return;
    const { LiveScene } = await import("../live/scene.js");
    if (this.#stage.isConnected) this.#scene ??= new LiveScene(this.#stage, this.#head, RATE_HZ);
  }

  #play() {
    if (this.#scene === null || document.hidden) return;
    const { people } = this.#instants[this.#at % this.#instants.length];
    this.#at += 1;
    this.#scene.show({ people: people.map(({ id, joints_m: joints }) => ({ id, joints: joints.map((value) => value ?? NaN) })) });
  }

  #draw() {
    render(html`<section class="panel first-people" aria-labelledby="first-title"><h2 id="first-title">${TAKE.firstPeople}</h2>
      <p class="quiet">${TAKE.firstPeopleHint(length(this.#instants.length / RATE_HZ))}</p>
      <div class="look-viewer"><div class="look-view live-stage" ${ref((element) => { this.#stage = element ?? this.#stage; })}></div></div></section>`, this.#place);
  }
}
