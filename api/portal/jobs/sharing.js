// Public links to look at a job: made, copied, listed, revoked.

import { call } from "../shared/api.js";
import { confirm, html, nothing, problemBox, render, repeat } from "../shared/lit.js";
import { announce } from "../shared/page.js";

const HOUR_S = 3600;
const DURATIONS = [["1 hour", HOUR_S], ["1 day", 24 * HOUR_S], ["7 days", 7 * 24 * HOUR_S], ["30 days", 30 * 24 * HOUR_S]];
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
      <h2 id="sharing-title" tabindex="-1">Public link</h2>
      <p class="quiet">Whoever has the link can look at this job and download its files, without a key, until it ends.</p>
      <form class="actions" @submit=${(event) => this.#make(event)}>
        <label class="with"><span>Ends after</span> <select name="duration">
          ${DURATIONS.map(([label, seconds]) => html`<option value=${seconds} ?selected=${seconds === USUAL_S}>${label}</option>`)}</select></label>
        <button class="button small primary">Make a link</button>
      </form>
      ${problemBox(this.problem)}
      ${this.made === null ? nothing : html`<div class="made">
        <label class="field"><span>Address of the new link. It is shown only now.</span>
          <input id="made-link" readonly .value=${this.made.address} @focus=${(event) => event.target.select()}></label>
        <button type="button" class="button small" @click=${() => this.#copy()}>Copy the link</button></div>`}
      ${this.links.length === 0 ? nothing : html`<ul class="links" aria-label="Links">${repeat(this.links, ({ id }) => id, (link, index) => this.#item(link, this.links.length - index))}</ul>`}
    </section>`;
  }

  #item(link, number) {
    const [made, ends] = [link.created_at, link.expires_at].map(formatMoment);
    return html`<li><span>Link ${number} ends ${ends}${link.id === this.made?.id ? " (the new one)" : ""} <span class="quiet">made ${made}</span></span>
      <button type="button" class="button small danger-quiet" aria-label="Revoke link ${number}" @click=${() => this.#revoke(link)}>Revoke</button></li>`;
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
      announce("The link is made.");
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
      announce("The link is copied.");
    } catch { // pages without TLS may not
      field.focus();
      field.select();
      announce("Copy the chosen address with Ctrl+C.");
    }
  }

  async #revoke(link) {
    const question = { title: "Revoke the link?", text: "Whoever has it can no longer look at this job. It can't be restored; make another one instead.", action: "Revoke" };
    if (!await confirm(question)) return;
    this.problem = null;
    try {
      await call(`/v1/links/${link.id}`, { method: "DELETE" });
      if (link.id === this.made?.id) this.made = null;
      await this.#load();
      announce("The link is revoked.");
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

function formatMoment(text) {
  return new Date(text).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
}
