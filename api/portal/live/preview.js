// Page of `multicap live --preview`: people in 3D while they are captured, latency, and what the cameras do.

import { length } from "../shared/format.js";
import { html, nothing, ref, render } from "../shared/lit.js";
import { COMMON, COUNTS } from "../shared/strings/common.js";
import { LIVE } from "../shared/strings/live.js";
import { unpackInstant } from "./client.js";
import { LiveScene } from "./scene.js";

const AGAIN_MS = 2000;

class PreviewView {
  #place;
  #stage = null; // element of the 3D view
  #scene = null;
  #status = null; // latest message `status`
  #people = 0;
  #isOpen = false;

  constructor(place) {
    this.#place = place;
    place.replaceChildren();
    this.#open();
  }

  /** Connect; when the capture is over, look for the next one at the same port. */
  #open() {
    const socket = new WebSocket(`ws://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => this.#show(true));
    socket.addEventListener("message", ({ data }) => (typeof data === "string" ? this.#tell(JSON.parse(data)) : this.#take(unpackInstant(data))));
    socket.addEventListener("close", () => {
      this.#show(false);
      setTimeout(() => this.#open(), AGAIN_MS);
    });
  }

  #show(isOpen) {
    this.#isOpen = isOpen;
    this.#draw();
  }

  #tell(message) {
    if (message.type === "status") this.#status = message;
    this.#draw();
    if (message.type !== "ready") return;
    this.#scene?.close();
    this.#scene = new LiveScene(this.#stage, message, message.frame_rate_hz);
  }

  #take(instant) {
    this.#people = instant.people.length;
    this.#scene?.show(instant);
  }

  #draw() {
    const over = html`<p class="notice" role="status">${LIVE.preview.idle}</p>`;
    render(html`<div class="live">
      <div class="bar"><h1 class="title">${LIVE.title}</h1></div>
      <section class="look-viewer" aria-label=${LIVE.peopleNow}>
        <div class="look-view live-stage" ${ref((element) => { this.#stage = element ?? null; })}></div>
        ${this.#status ? this.#figures(this.#status) : nothing}
      </section>
      ${this.#isOpen ? nothing : over}
      ${this.#status ? this.#cameras(this.#status) : nothing}
    </div>`, this.#place);
  }

  #figures({ time_s: timeS, instants_hz: rateHz, latency_s: { p50, p95 } }) {
    const { figures } = LIVE;
    const facts = [
      [figures.time, length(timeS)],
      [figures.people, String(this.#people)],
      [figures.instants, COMMON.hz(rateHz)],
      [figures.latency, p50 === null ? LIVE.unknown : LIVE.latency((1000 * p50).toFixed(0), (1000 * p95).toFixed(0))],
    ];
    return html`<dl class="live-figures">${facts.map(([name, value]) => html`<div><dt>${name}</dt><dd>${value}</dd></div>`)}</dl>`;
  }

  #cameras({ cameras }) {
    return html`<section class="panel" aria-labelledby="cameras-title"><h2 id="cameras-title">${COMMON.cameras}</h2>
      <table class="live-cameras"><thead><tr>${LIVE.preview.table.map((head) => html`<th>${head}</th>`)}</tr></thead>
      <tbody>${cameras.map((camera) => html`<tr><th scope="row">${camera.name}</th><td>${LIVE.preview.states[camera.state]}</td>
        <td>${COMMON.hz(camera.decoded_hz)}</td><td>${COMMON.hz(camera.detected_hz)}</td><td>${COUNTS.frames(camera.dropped)}</td><td>${COUNTS.times(camera.lost)}</td></tr>`)}</tbody></table>
    </section>`;
  }
}

new PreviewView(document.getElementById("view"));
