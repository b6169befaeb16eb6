// View Watch: the captures with their jobs.

import { announce } from "../shared/announce.js";
import { call } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { hasEnded, stateOf } from "../shared/jobs.js";
import { html, nothing, render, repeat } from "../shared/lit.js";
import { readOptions } from "../shared/options.js";
import { problemBox } from "../shared/problem.js";
import { captureCard } from "./capture.js";

const PAGE = 20;
const FILTERS = [
  ["all", "All", () => true],
  ["active", "In progress", (jobs) => jobs.some((job) => !hasEnded(job))],
  ["done", "Done", (jobs) => jobs.some(({ state }) => state === "succeeded")],
  ["attention", "Needs attention", (jobs) => jobs.some((job) => ["bad", "warn", "empty"].includes(stateOf(job).tone))],
  ["none", "Without a job", (jobs) => jobs.length === 0],
];

export function open(place, route, caller) {
  const view = new Captures(place, caller);
  view.start();
  return { title: "Captures", close: () => view.close() };
}

class Captures {
  sessions = [];
  options = null;
  problem = null;
  cursor = null; // of the next page
  isLoaded = false;
  search = "";
  filter = "all";
  problems = new Map(); // of an action, by the id of the job or session
  opened = new Map(); // form for another run by the session's id: its choices
  renamed = null; // id of the session whose name is being changed
  #isClosed = false;
  #asked = new Set(); // sessions whose jobs were asked for
  #states = new Map(); // announced state of each job

  constructor(place, caller) {
    this.place = place;
    this.canWrite = caller.scopes.includes("write");
    this.onFeed = () => this.#feedChanged();
  }

  async start() {
    feed.addEventListener("change", this.onFeed);
    for (const job of feed.jobs.values()) this.#states.set(job.id, job.state);
    this.draw();
    try {
      [this.options] = await Promise.all([readOptions(), this.load()]);
    } catch (problem) {
      this.problem = problem;
    }
    this.draw();
  }

  close() {
    this.#isClosed = true;
    feed.removeEventListener("change", this.onFeed);
  }

  async load({ isMore = false } = {}) {
    const query = new URLSearchParams({ limit: PAGE });
    if (isMore && this.cursor) query.set("cursor", this.cursor);
    const { sessions, next_cursor: next } = await call(`/v1/sessions?${query}`);
    this.sessions = isMore ? [...this.sessions, ...sessions] : sessions;
    this.cursor = next;
    this.isLoaded = true;
    if (!feed.isComplete) await Promise.all(sessions.map((session) => this.#loadJobs(session)));
    this.draw();
  }

  // Jobs that are older than those of the feed.
  async #loadJobs(session) {
    if (this.#asked.has(session.id)) return;
    this.#asked.add(session.id);
    feed.put(...(await call(session.links.jobs)).jobs);
  }

  #feedChanged() {
    const known = new Set(this.sessions.map(({ id }) => id));
    const newest = this.sessions[0]?.id ?? "";
    if (this.isLoaded && feed.newest().some((job) => !known.has(job.session_id) && job.session_id > newest)) {
      this.load().catch((problem) => { this.problem = problem; this.draw(); });
    }
    for (const job of feed.jobs.values()) {
      const before = this.#states.get(job.id);
      if (before !== undefined && before !== job.state) announce(`${job.session_name}: ${stateOf(job).words}`);
      this.#states.set(job.id, job.state);
    }
    this.draw();
  }

  // Do something and show its problem beside what it concerns.
  async act(id, action) {
    this.problems.delete(id);
    this.draw();
    try {
      await action();
    } catch (problem) {
      this.problems.set(id, problem);
    }
    this.draw();
  }

  // After an element is gone the focus goes to the list's heading rather than to the page's start.
  focusList() {
    this.place.querySelector("#captures-title").focus();
  }

  shown() {
    const [, , fits] = FILTERS.find(([name]) => name === this.filter);
    const wanted = this.search.trim().toLowerCase();
    return this.sessions.filter((session) => session.name.toLowerCase().includes(wanted) && fits(feed.ofSession(session.id)));
  }

  draw() {
    if (!this.#isClosed) render(this.#page(), this.place);
  }

  #page() {
    const shown = this.shown();
    return html`
      <div class="bar">
        <h1 class="title" id="captures-title" tabindex="-1">Captures</h1>
        <label class="search"><span class="unseen">Search by name</span>
          <input type="search" placeholder="Search by name" @input=${(event) => { this.search = event.target.value; this.draw(); }}></label>
        <label class="filter"><span class="unseen">Show</span>
          <select @change=${(event) => { this.filter = event.target.value; this.draw(); }}>
            ${FILTERS.map(([name, label]) => html`<option value=${name}>${label}</option>`)}</select></label>
        ${this.canWrite ? html`<a class="button primary" href="#/new">New capture</a>` : nothing}
      </div>
      ${problemBox(this.problem)}
      ${this.isLoaded && this.sessions.length === 0 ? html`<p class="panel empty">No captures yet. Send the videos of a capture and their calibration.</p>` : nothing}
      ${this.sessions.length && shown.length === 0 ? html`<p class="panel empty">No capture fits. Change the search or the filter.</p>` : nothing}
      ${this.isLoaded ? nothing : html`<p class="quiet">Loading …</p>`}
      <ol class="captures">${repeat(shown, ({ id }) => id, (session) => captureCard(this, session))}</ol>
      ${this.cursor ? html`<button type="button" class="button" @click=${() => this.load({ isMore: true }).catch((problem) => { this.problem = problem; this.draw(); })}>Show more</button>` : nothing}`;
  }
}
