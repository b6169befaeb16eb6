// The jobs that the page knows, kept up to date: by event streams of a few running jobs, by polling for all others.

import { addressed, call } from "./api.js";
import { hasEnded, isAtWork } from "./jobs.js";
import { notifies } from "./notices.js";

const POLL_MS = 1500;
const QUIET_POLL_MS = 10_000;
const FIRST = 200; // jobs of the first request, and the most that the service lists in one
const LATER = 30;
// A browser opens six connections to a host, and uploads need some.
const MAX_STREAMS = 2;

class Feed extends EventTarget {
  jobs = new Map(); // by id
  isComplete = false; // whether the map has all jobs of the service
  isLoaded = false;
  problem = null;
  #streams = new Map();
  #timer = 0;
  #isRunning = false;
  #only = null; // the one job that is followed, by its id

  constructor() {
    super();
    document.addEventListener("visibilitychange", () => { if (this.#isRunning && !document.hidden) this.refresh(); });
  }

  start() {
    this.#isRunning = true;
    return this.refresh();
  }

  // Follow a single job, which is all that a link opens.
  startOnly(id) {
    this.#only = id;
    return this.start();
  }

  stop() {
    this.#isRunning = false;
    clearTimeout(this.#timer);
    for (const stream of this.#streams.values()) stream.close();
    this.#streams.clear();
    this.jobs.clear();
    this.isLoaded = false;
  }

  put(...jobs) {
    for (const job of jobs) this.jobs.set(job.id, job);
    this.#follow();
    this.#changed();
  }

  remove(id) {
    this.jobs.delete(id);
    this.#follow();
    this.#changed();
  }

  ofSession(sessionId) {
    return this.newest().filter((job) => job.session_id === sessionId);
  }

  // Ids begin with the time, so they sort by it.
  newest() {
    return [...this.jobs.values()].sort((one, other) => (one.id < other.id ? 1 : -1));
  }

  async refresh() {
    clearTimeout(this.#timer);
    try {
      await (this.#only === null ? this.#refreshAll() : this.#refreshOnly());
    } catch (problem) {
      if (!this.#isRunning) return;
      this.problem = problem;
      this.#changed();
    }
    this.#schedule();
  }

  async #refreshOnly() {
    const job = await call(`/v1/jobs/${encodeURIComponent(this.#only)}`);
    if (!this.#isRunning) return;
    this.problem = null;
    this.put(job);
  }

  async #refreshAll() {
    const limit = this.isLoaded ? LATER : FIRST;
    const { jobs, next_cursor: next } = await call(`/v1/jobs?limit=${limit}`);
    if (!this.#isRunning) return;
    if (!this.isLoaded) this.isComplete = next === null;
    this.isLoaded = true;
    const oldest = next === null ? "" : jobs.at(-1).id;
    const listed = new Set(jobs.map(({ id }) => id));
    for (const id of this.jobs.keys()) if (id >= oldest && !listed.has(id)) this.jobs.delete(id);
    this.problem = null;
    this.put(...jobs);
  }

  #schedule() {
    clearTimeout(this.#timer);
    if (!this.#isRunning || (document.hidden && !notifies())) return;
    const isLive = ({ id }) => this.#streams.get(id)?.readyState === EventSource.OPEN;
    const isUnseen = [...this.jobs.values()].some((job) => isAtWork(job) && !(isLive(job) && !hasEnded(job)));
    this.#timer = setTimeout(() => this.refresh(), isUnseen ? POLL_MS : QUIET_POLL_MS);
  }

  #follow() {
    const wanted = this.newest().filter((job) => !hasEnded(job)).sort((one, other) => other.progress - one.progress);
    const ids = new Set(wanted.slice(0, MAX_STREAMS).map(({ id }) => id));
    for (const [id, stream] of this.#streams) {
      // A browser gives a stream up that the service refused; it is opened again.
      if (ids.has(id) && stream.readyState !== EventSource.CLOSED) continue;
      stream.close();
      this.#streams.delete(id);
    }
    for (const id of ids) {
      if (this.#isRunning && !this.#streams.has(id)) this.#streams.set(id, this.#open(this.jobs.get(id)));
    }
  }

  #open(job) {
    const stream = new EventSource(addressed(job.urls.events));
    stream.addEventListener("job", ({ data }) => this.put(JSON.parse(data)));
    stream.addEventListener("gone", () => this.remove(job.id));
    // Without the stream the job is polled; the browser tries again by itself unless the service refused.
    stream.addEventListener("error", () => this.#schedule());
    stream.addEventListener("open", () => this.#schedule());
    return stream;
  }

  #changed() {
    this.dispatchEvent(new Event("change"));
  }
}

export const feed = new Feed();
