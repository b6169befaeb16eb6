// Public links to look at a job: made, copied, listed, revoked.

import { call } from "../shared/api.js";
import { dateAndTime } from "../shared/format.js";
import { confirm, html, nothing, problemBox, render, repeat } from "../shared/lit.js";
import { announce } from "../shared/page.js";
import { SHARING } from "../shared/strings/take.js";

const HOUR_S = 3600;
const DURATIONS_S = [HOUR_S, 24 * HOUR_S, 7 * 24 * HOUR_S, 30 * 24 * HOUR_S];
const USUAL_S = 7 * 24 * HOUR_S;

export class Sharing {
  links = []; // valid ones, the newest first
  made = null; // link that was made last, with its address
  problem = null;
  #isOpen = true;
  #timer = 0;

  constructor(place, job) {
    Object.assign(this, { place, job, path: `${job.urls.self}/links` });
    this.#load().catch((problem) => this.#fail(problem));
  }

  close() {
    this.#isOpen = false;
    clearTimeout(this.#timer);
  }

  draw() {
    if (this.#isOpen) render(this.#panel(), this.place);
  }

  #panel() {
    return html`<section class="panel sharing" aria-labelledby="sharing-title">
      <h2 id="sharing-title" tabindex="-1">${SHARING.title}</h2>
      <p class="quiet">${SHARING.hint}</p>
      <form class="actions" @submit=${(event) => this.#make(event)}>
        <label class="with"><span>${SHARING.endsAfter}</span> <select name="duration">
          ${DURATIONS_S.map((seconds, number) => html`<option value=${seconds} ?selected=${seconds === USUAL_S}>${SHARING.durations[number]}</option>`)}</select></label>
        <button class="button small primary">${SHARING.make}</button>
      </form>
      ${problemBox(this.problem)}
      ${this.made === null ? nothing : html`<div class="made">
        <label class="field"><span>${SHARING.address}</span>
          <input id="made-link" readonly .value=${this.made.address} @focus=${(event) => event.target.select()}></label>
        <button type="button" class="button small" @click=${() => this.#copy()}>${SHARING.copy}</button></div>`}
      ${this.links.length === 0 ? nothing : html`<ul class="links" aria-label=${SHARING.links}>${repeat(this.links, ({ id }) => id, (link, index) => this.#item(link, this.links.length - index))}</ul>`}
    </section>`;
  }

  #item(link, number) {
    const [made, ends] = [link.created_at, link.expires_at].map((time) => dateAndTime(new Date(time)));
    return html`<li><span>${SHARING.item(number, ends)}${link.id === this.made?.id ? SHARING.isNew : ""} <span class="quiet">${SHARING.made(made)}</span></span>
      <button type="button" class="button small danger-quiet" aria-label=${SHARING.revokeOf(number)} @click=${() => this.#revoke(link)}>${SHARING.revoke}</button></li>`;
  }

  async #load() {
    clearTimeout(this.#timer);
    const { links } = await call(this.path);
    this.links = links.filter(({ scope }) => scope === "job");
    this.draw();
    if (!this.#isOpen || this.links.length === 0) return;
    // A link that has ended leaves the list. Timers of browsers take 24 days at most.
    const first = Math.min(...this.links.map((link) => new Date(link.expires_at))) - Date.now();
    if (first < 2 ** 31) this.#timer = setTimeout(() => this.#load().catch((problem) => this.#fail(problem)), Math.max(1000, first + 500));
  }

  async #make(event) {
    event.preventDefault();
    const seconds = Number(event.target.elements.duration.value);
    this.problem = null;
    try {
      const made = await call(this.path, { method: "POST", body: { scope: "job", expires_in_s: seconds } });
      this.made = { id: made.id, address: new URL(made.url, location.href).href };
      await this.#load();
      announce(SHARING.said.made);
      const field = this.place.querySelector("#made-link");
      field.focus();
      field.select();
    } catch (problem) {
      this.#fail(problem);
    }
  }

  async #copy() {
    const field = this.place.querySelector("#made-link");
    try {
      await navigator.clipboard.writeText(this.made.address);
      announce(SHARING.said.copied);
    } catch { // pages without TLS may not
      field.focus();
      field.select();
      announce(SHARING.said.copyByHand);
    }
  }

  async #revoke(link) {
    if (!await confirm(SHARING.revoking)) return;
    this.problem = null;
    try {
      await call(`/v1/links/${link.id}`, { method: "DELETE" });
      if (link.id === this.made?.id) this.made = null;
      await this.#load();
      announce(SHARING.said.revoked);
      this.place.querySelector("#sharing-title").focus();
    } catch (problem) {
      this.#fail(problem);
    }
  }

  #fail(problem) {
    this.problem = problem;
    this.draw();
  }
}
