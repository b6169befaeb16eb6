// Row of a job: its state, stages, choices, warnings, and what can be done with it.

import { call } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { describeProgress, jobFacts, hasEnded, hasFiles, jobState } from "../shared/jobs.js";
import { confirm, html, nothing, problemBox, warningList } from "../shared/lit.js";
import { address, announce } from "../shared/page.js";
import { describeSpec } from "../shared/resources.js";

export function stageList(job) {
  return html`<ol class="stages">${job.stages.map((stage) => html`<li class="stage" data-state=${stage.state}>
    <span class="label">${stage.label}</span>
    <progress max="1" .value=${stage.fraction} aria-label=${stage.label}></progress>
    <span class="count quiet">${describeProgress(stage)}</span>
  </li>`)}</ol>`;
}

export function choiceList(job, options) {
  if (!options || job.kind === "calibration") return nothing;
  const changed = describeSpec(job.spec, options);
  if (changed.length === 0) return html`<p class="choices quiet">Usual choices</p>`;
  return html`<p class="choices">${changed.map(({ label, value }) => html`<span class="chip"><span class="unseen">${label}: </span>${value}</span>`)}</p>`;
}

// Problem of a failed job, with the camera and the stage that it concerns.
export function errorBox(job) {
  if (!job.error) return nothing;
  const stage = job.stages.find(({ name }) => name === job.error.stage)?.label;
  const where = [job.error.camera && `camera ${job.error.camera}`, stage].filter(Boolean).join(", ");
  if (job.error.errors.length) {
    const hint = "Correct the capture and send it again, or reconstruct it all the same.";
    return problemBox({ message: "The check found errors, with which a reconstruction would be wrong.", hint, items: job.error.errors });
  }
  const advice = job.error.hint ?? (job.urls.retry ? "Retry it." : null);
  return problemBox({ message: where ? `${job.error.detail} (${where})` : job.error.detail, hint: advice });
}

// Outage that a job waits for; it continues by itself.
export function waitingBox(job) {
  const outage = job.waiting_for;
  return outage ? warningList([{ message: `${outage.detail} ${outage.hint}` }], "Waiting") : nothing;
}

// `number`: place of the job among its capture's jobs, from 1; null if it is the only one.
export function jobRow(view, job, number) {
  const { words, tone } = jobState(job);
  const name = number === null ? job.session_name : `${job.session_name}, run ${number}`;
  const act = (path, method, said) => view.act(job.id, async () => {
    const answer = await call(path, { method });
    if (answer) feed.put(answer); else feed.remove(job.id);
    announce(said);
    if (!answer) view.focusList();
    else requestAnimationFrame(() => { if (document.activeElement === document.body) view.place.querySelector(`#job-${job.id}`)?.focus(); });
  });
  const remove = async () => {
    const question = { title: `Delete this job of ${name}?`, text: "Its results are deleted for good. The videos stay.", action: "Delete the job" };
    if (await confirm(question)) await act(job.urls.self, "DELETE", `The job of ${name} is deleted.`);
  };
  const force = () => view.act(job.id, async () => {
    feed.put(await call(`${job.urls.session}/jobs`, { method: "POST", body: { ...job.spec, force: true } }));
    announce(`Another job of ${job.session_name} waits.`);
  });
  const isOpenable = job.kind === "reconstruction";
  return html`<li class="job" id="job-${job.id}" tabindex="-1" data-tone=${tone}>
    <div class="line">
      ${number === null ? nothing : html`<b class="run">Run ${number}</b>`}
      <span class="state" data-tone=${tone}>${words}</span>
      ${choiceList(job, view.options)}
      <p class="quiet facts">${jobFacts(job).map((fact) => html`<span>${fact}</span>`)}</p>
      <div class="actions">
        ${isOpenable && hasFiles(job) ? html`<a class="button small primary" href=${address("jobs", job.id)} aria-label="Look at ${name}">Look</a>
          <a class="button small" href=${job.urls.results_zip} download aria-label="All as ZIP: ${name}">All as ZIP</a>` : nothing}
        ${isOpenable && !hasFiles(job) ? html`<a class="button small" href=${address("jobs", job.id)} aria-label="Details of ${name}">Details</a>` : nothing}
        ${view.canWrite && job.urls.cancel ? html`<button type="button" class="button small" aria-label="Cancel ${name}" @click=${() => act(job.urls.cancel, "POST", `${name} is being canceled.`)}>Cancel</button>` : nothing}
        ${view.canWrite && job.urls.retry ? html`<button type="button" class="button small" aria-label="Retry ${name}" @click=${() => act(job.urls.retry, "POST", `${name} waits for another attempt.`)}>Retry</button>` : nothing}
        ${view.canWrite && job.error?.errors.length ? html`<button type="button" class="button small" aria-label="Reconstruct ${name} all the same" @click=${force}>Reconstruct all the same</button>` : nothing}
        ${view.canWrite && hasEnded(job) ? html`<button type="button" class="button small ghost" aria-label="Delete job of ${name}" @click=${remove}>Delete job</button>` : nothing}
      </div>
    </div>
    ${hasEnded(job) ? nothing : stageList(job)}
    ${errorBox(job)}
    ${waitingBox(job)}
    ${problemBox(view.problems.get(job.id))}
    ${warningList(job.warnings, `Warnings of ${name}`)}
  </li>`;
}
