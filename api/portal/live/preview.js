// Page of `multicap live --preview`: people in 3D while they are captured, latency, and what the cameras do.

import { count, length } from "../shared/format.js";
import { html, nothing, ref, render } from "../shared/lit.js";
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
    const over = html`<p class="notice" role="status">The capture is over, or has not begun.</p>`;
    render(html`<div class="live">
      <div class="bar"><h1 class="title">Live</h1></div>
      <section class="look-viewer" aria-label="People now">
        <div class="look-view live-stage" ${ref((element) => { this.#stage = element ?? null; })}></div>
        ${this.#status ? this.#figures(this.#status) : nothing}
      </section>
      ${this.#isOpen ? nothing : over}
      ${this.#status ? this.#cameras(this.#status) : nothing}
    </div>`, this.#place);
  }

  #figures({ time_s: timeS, instants_hz: rateHz, latency_s: { p50, p95 } }) {
    const facts = [
      ["Time", length(timeS)],
      ["People", String(this.#people)],
      ["Instants", `${rateHz} Hz`],
      ["Latency", p50 === null ? "–" : `${(1000 * p50).toFixed(0)} ms, 95 % within ${(1000 * p95).toFixed(0)} ms`],
    ];
    return html`<dl class="live-figures">${facts.map(([name, value]) => html`<div><dt>${name}</dt><dd>${value}</dd></div>`)}</dl>`;
  }

  #cameras({ cameras }) {
    return html`<section class="panel" aria-labelledby="cameras-title"><h2 id="cameras-title">Cameras</h2>
      <table class="live-cameras"><thead><tr><th>Camera</th><th>State</th><th>Sends</th><th>Detected</th><th>Dropped</th><th>Lost</th></tr></thead>
      <tbody>${cameras.map((camera) => html`<tr><th scope="row">${camera.name}</th><td>${camera.state === "lost" ? "lost, opening again" : camera.state}</td>
        <td>${camera.decoded_hz} Hz</td><td>${camera.detected_hz} Hz</td><td>${count(camera.dropped, "frame")}</td><td>${count(camera.lost, "time")}</td></tr>`)}</tbody></table>
    </section>`;
  }
}

new PreviewView(document.getElementById("view"));
