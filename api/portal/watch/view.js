// View Watch: the captures with their jobs.

import { call, persistently } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { jobState } from "../shared/jobs.js";
import { html, nothing, problemBox, render, repeat, typed } from "../shared/lit.js";
import { announce } from "../shared/page.js";
import { characters, readOptions } from "../shared/resources.js";
import { CAPTURES } from "../shared/strings/captures.js";
import { COMMON } from "../shared/strings/common.js";
import { captureCard } from "./capture_card.js";

const PAGE = 20;
const MOST = 200; // sessions that the service lists in one answer
const TYPING_MS = 250;
const FETCHED_MS = 2000; // between looks at sessions whose videos the service fetches

export function open(place, route, caller) {
  const view = new Captures(place, caller);
  view.search = route.query.get("name") ?? "";
  view.start();
  return { title: CAPTURES.title, close: () => view.close() };
}

const told = ({ state, files_state: filesState }) => `${state} ${filesState}`;

class Captures {
  sessions = [];
  options = null;
  problem = null;
  cursor = null; // of the next page
  isLoaded = false;
  search = "";
  filter = "";
  problems = new Map(); // of an action, by the id of the job or session
  opened = new Map(); // form for another run by the session's id: its choices
  recalibrated = new Map(); // form for another calibration by the session's id: the calibrations to choose from
  shown = new Set(); // sessions whose cameras are shown
  renamed = null; // id of the session whose name is being changed
  #isClosed = false;
  #number = 0; // of the last request, so that a slow answer does not replace a later one
  #timer = 0;
  #asked = new Set(); // sessions whose jobs were asked for
  #states = new Map(); // announced states of each job and its files

  constructor(place, caller) {
    this.place = place;
    this.canWrite = caller.scopes.includes("write");
    this.onFeed = () => this.#feedChanged();
    this.onCharacters = () => this.draw();
  }

  async start() {
    feed.addEventListener("change", this.onFeed);
    characters.addEventListener("change", this.onCharacters);
    for (const job of feed.jobs.values()) this.#states.set(job.id, told(job));
    this.draw();
    this.reload();
    try {
      this.options = await persistently(readOptions, this.#awhile);
    } catch (problem) {
      this.problem = problem;
    }
    this.draw();
  }

  // How requests are made that the view needs: again, until the service answers or the view is closed.
  get #awhile() {
    return { isOver: () => this.#isClosed, away: (problem) => { this.problem = problem; this.draw(); } };
  }

  close() {
    this.#isClosed = true;
    clearTimeout(this.#timer);
    feed.removeEventListener("change", this.onFeed);
    characters.removeEventListener("change", this.onCharacters);
  }

  // Ask for the sessions that fit the search: the first ones, as many as are shown, or the next page.
  async load({ isMore = false } = {}) {
    const number = ++this.#number;
    const query = new URLSearchParams({ limit: isMore ? PAGE : Math.min(MOST, Math.max(PAGE, this.sessions.length)) });
    if (this.search.trim()) query.set("name", this.search.trim());
    if (this.filter) query.set("state", this.filter);
    if (isMore) query.set("cursor", this.cursor);
    const { sessions, next_cursor: next } = await call(`/v1/sessions?${query}`);
    if (number !== this.#number || this.#isClosed) return;
    this.sessions = isMore ? [...this.sessions, ...sessions] : sessions;
    this.cursor = next;
    this.isLoaded = true;
    this.problem = null;
    this.draw();
    if (this.sessions.some(({ state }) => state === "fetching")) this.reload(FETCHED_MS);
    await Promise.all(sessions.map((session) => this.#loadJobs(session)));
  }

  reload(delayMs = 0) {
    clearTimeout(this.#timer);
    const load = () => persistently(() => this.load(), this.#awhile).catch((problem) => { this.problem = problem; this.draw(); });
    this.#timer = setTimeout(load, delayMs);
  }

  // Jobs that are older than the feed's.
  async #loadJobs(session) {
    if (this.#asked.has(session.id) || feed.ofSession(session.id).length >= session.num_jobs) return;
    const { jobs } = await call(session.urls.jobs);
    this.#asked.add(session.id);
    feed.put(...jobs);
  }

  #feedChanged() {
    const known = new Set(this.sessions.map(({ id }) => id));
    const newest = this.sessions[0]?.id ?? "";
    let isOld = this.isLoaded && feed.newest().some((job) => !known.has(job.session_id) && job.session_id > newest);
    for (const job of feed.jobs.values()) {
      const before = this.#states.get(job.id);
      if (before !== undefined && before !== told(job)) announce(CAPTURES.stateOf(job.session_name, jobState(job).words));
      isOld ||= before !== told(job) && this.filter !== "";
      this.#states.set(job.id, told(job));
    }
    if (isOld) this.reload();
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

  draw() {
    if (!this.#isClosed) render(this.#page(), this.place);
  }

  #page() {
    const isFiltered = this.search.trim() !== "" || this.filter !== "";
    return html`
      <div class="bar">
        <h1 class="title" id="captures-title" tabindex="-1">${CAPTURES.title}</h1>
        <label class="search"><span class="unseen">${CAPTURES.search}</span>
          <input type="search" placeholder=${CAPTURES.search} maxlength="200" .value=${typed(this.search)} @input=${(event) => { this.search = event.target.value; this.reload(TYPING_MS); }}></label>
        <label class="filter"><span class="unseen">${CAPTURES.state}</span>
          <select @change=${(event) => { this.filter = event.target.value; this.reload(); }}>
            ${Object.entries(CAPTURES.filters).map(([state, label]) => html`<option value=${state}>${label}</option>`)}</select></label>
        ${this.canWrite ? html`<a class="button primary" href="#/new">${CAPTURES.new}</a>` : nothing}
      </div>
      ${problemBox(this.problem)}
      ${this.isLoaded && this.sessions.length === 0 ? html`<p class="panel empty">${isFiltered ? CAPTURES.noneFits : CAPTURES.none}</p>` : nothing}
      ${this.isLoaded || this.problem ? nothing : html`<p class="quiet">${COMMON.loading}</p>`}
      <ol class="captures">${repeat(this.sessions, ({ id }) => id, (session) => captureCard(this, session))}</ol>
      ${this.cursor ? html`<button type="button" class="button" @click=${() => this.act("more", () => this.load({ isMore: true }))}>${CAPTURES.showMore}</button>` : nothing}
      ${problemBox(this.problems.get("more"))}`;
  }
}
