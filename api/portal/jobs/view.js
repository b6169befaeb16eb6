// View of one job: its motion, its people, its files and its public links. A guest, who has a link alone, reads only.

import { call, persistently } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { jobFacts, hasEnded, hasFiles, jobState } from "../shared/jobs.js";
import { html, nothing, problemBox, render, warningList } from "../shared/lit.js";
import { announce, setTitle } from "../shared/page.js";
import { readOptions } from "../shared/resources.js";
import { COMMON } from "../shared/strings/common.js";
import { FRAME } from "../shared/strings/frame.js";
import { TAKE } from "../shared/strings/take.js";
import { choiceList, errorBox, stageList, waitingBox } from "../watch/job_row.js";
import { AddedFiles } from "./added_files.js";
import { downloads } from "./downloads.js";
import { FirstPeople } from "./first_people.js";
import { JobMotion } from "./job_motion.js";
import { PeoplePanel } from "./people/panel.js";
import { personColor } from "./people/person_names.js";
import { Sharing } from "./sharing.js";

export function open(place, route, caller) {
  const view = new JobView(place, route.id, caller);
  view.start();
  return { title: view.job?.session_name ?? TAKE.title, close: () => view.close() };
}

class JobView {
  job = null;
  session = null;
  results = null;
  options = null;
  problem = null;
  #listed = ""; // what the list of files was read for
  #shown = null; // revision of the motion that is shown
  #panel = null; // to edit the people
  #sharing = null; // public links
  #firstPeople = null; // while the job runs
  #added = new AddedFiles(() => this.draw());
  #isClosed = false;

  constructor(place, id, caller) {
    Object.assign(this, { place, id, caller });
    this.frame = document.createElement("div");
    this.first = document.createElement("div");
    this.stage = document.createElement("div");
    this.people = document.createElement("div");
    this.below = document.createElement("div");
    this.links = document.createElement("div");
    place.append(this.frame, this.first, this.stage, this.people, this.below, this.links);
    this.stage.className = "motion";
    this.motion = new JobMotion(this.stage);
    this.onFeed = () => this.#feedChanged();
    this.onKey = (event) => this.#panel?.key(event);
  }

  async start() {
    feed.addEventListener("change", this.onFeed);
    document.addEventListener("keydown", this.onKey);
    this.draw();
    await this.#persist(async () => {
      this.job = feed.jobs.get(this.id) ?? await call(`/v1/jobs/${encodeURIComponent(this.id)}`);
      setTitle(this.job.session_name);
      [this.session, this.options] = await Promise.all([call(this.job.urls.session), this.caller.isGuest ? null : readOptions()]);
      await this.#showResults();
    });
  }

  // Load what the view needs, again until the service answers.
  async #persist(load) {
    const show = (problem) => {
      this.problem = problem;
      this.draw();
    };
    try {
      await persistently(load, { isOver: () => this.#isClosed, away: show });
      show(null);
    } catch (problem) {
      show(problem);
    }
  }

  close() {
    this.#isClosed = true;
    this.motion.close();
    this.#firstPeople?.close();
    this.#panel?.close();
    this.#sharing?.close();
    feed.removeEventListener("change", this.onFeed);
    document.removeEventListener("keydown", this.onKey);
  }

  #feedChanged() {
    const job = feed.jobs.get(this.id);
    if (!job || job === this.job) return;
    this.job = job;
    this.#persist(() => this.#showResults());
    this.draw();
  }

  async #showResults() {
    const { job } = this;
    const isFirst = job.kind === "reconstruction" && job.state === "running";
    if (isFirst) this.#firstPeople ??= new FirstPeople(this.first, job.urls.self);
    else this.#firstPeople?.close();
    if (!isFirst) this.#firstPeople = null;
    const canEdit = this.caller.scopes.includes("write") && job.kind === "reconstruction" && job.urls.edits !== null;
    if (canEdit) {
      this.#panel ??= new PeoplePanel(this.people, job, this.motion, () => this.#showPeople());
      await this.#panel.follow(job); // a list of jobs that is answered late may be of a time before there were people
    }
    // The files of an earlier revision can be read until the files of the present one are there.
    if (!hasFiles(job) || this.session === null) return;
    await this.#list(job);
    if (job.kind !== "reconstruction" || this.#shown === job.results_revision) return;
    const before = this.#shown;
    this.#shown = job.results_revision;
    try {
      if (this.caller.scopes.includes("write")) this.#sharing ??= new Sharing(this.links, job);
      // Blurred videos are there since the job has succeeded.
      if (job.spec.blur_faces) this.session = await call(job.urls.session);
      await this.motion.open(job, this.session, { isGuest: this.caller.isGuest, editor: this.#panel });
      this.#showPeople();
    } catch (problem) {
      this.#shown = before;
      throw problem;
    }
  }

  // List the files, unless they are listed: the files of a revision, and the visuals, which follow.
  async #list(job) {
    const listed = `${job.results_revision} ${job.visuals_job?.id} ${job.visuals_job?.state}`;
    if (this.#listed === listed) return;
    this.results = (await call(job.urls.results)).results;
    this.#listed = listed;
    this.draw();
  }

  // Show people in the viewer as edits have put them, also before the files of these edits are there.
  #showPeople() {
    const people = this.#panel?.editing.people ?? null;
    if (people === null || this.#shown === null) return;
    const before = this.#panel.editing.peopleAt(this.#shown) ?? null;
    const isNewer = before !== null && people.revision > before.revision;
    const filed = new Set((before?.edits ?? []).map((edit) => JSON.stringify(edit)));
    const pending = this.#panel.editing.edits.filter((edit) => !filed.has(JSON.stringify(edit)));
    this.motion.previewJoints(pending, people.first_frame);
    this.motion.preview(isNewer ? { before, after: colored(people) } : null);
  }

  async #makeVisuals() {
    await this.#persist(async () => {
      await call(this.job.urls.visuals, { method: "POST" });
      announce(TAKE.visualsStarted);
      await feed.refresh();
      this.below.querySelector("#files-title").focus(); // the button is gone
    });
  }

  draw() {
    if (this.#isClosed) return;
    render(this.#head(), this.frame);
    render(this.#files(), this.below);
  }

  #head() {
    const { job } = this;
    if (job === null) return html`<h1 class="title">${FRAME.job}</h1>${this.problem ? problemBox(this.problem) : html`<p class="quiet">${COMMON.loading}</p>`}`;
    const { words, tone } = jobState(job);
    return html`<div class="bar">
        ${this.caller.isGuest ? nothing : html`<p class="crumb"><a href="#/captures">${TAKE.captures}</a></p>`}
        <h1 class="title">${job.session_name}</h1>
        <span class="state" data-tone=${tone}>${words}</span>
        ${choiceList(job, this.options)}
        <p class="quiet facts">${jobFacts(job).map((fact) => html`<span>${fact}</span>`)}</p>
        ${job.warnings?.length ? html`<details><summary>${TAKE.warnings(job.warnings.length)}</summary>
          ${warningList(job.warnings, COMMON.warningsOf(job.session_name), this.session?.notes)}</details>` : nothing}
        ${this.motion.choice}
      </div>
      ${hasEnded(job) || hasFiles(job) ? nothing : html`<div class="panel">${stageList(job)}</div>`}
      ${errorBox(job)}${waitingBox(job)}${problemBox(this.problem)}`;
  }

  #files() {
    if (this.job === null || !this.results) return nothing;
    const makeVisuals = this.caller.scopes.includes("write") ? () => this.#makeVisuals() : null;
    const { job, options } = this;
    const adding = this.caller.scopes.includes("write") && options && job.urls.files ? this.#added.form(job, options) : nothing;
    return html`${downloads(job, this.results, options, makeVisuals, { hasVideos: !this.session?.videos_deleted_at, adding })}`;
  }
}

// The same people object for the same people, so that the viewer is changed only when they are.
const coloredPeople = new WeakMap();

function colored(people) {
  if (!coloredPeople.has(people)) coloredPeople.set(people, { ...people, people: people.people.map((person) => ({ ...person, color: personColor(person.id) })) });
  return coloredPeople.get(people);
}
