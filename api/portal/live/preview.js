// Page of `multicap live --preview`: people in 3D while they are captured, latency, and what the cameras do.

import { html, nothing, ref, render } from "../shared/lit.js";
import { LIVE } from "../shared/strings/live.js";
import { unpackInstant } from "./client.js";
import { LiveScene } from "./scene.js";
import { states, statusFigures } from "./status.js";

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
        ${this.#status ? statusFigures(this.#status, this.#people) : nothing}
      </section>
      ${this.#isOpen ? nothing : over}
      ${this.#status ? states(this.#status) : nothing}
    </div>`, this.#place);
  }
}

new PreviewView(document.getElementById("view"));
