// Row of a job: its state, stages, choices, warnings, and what can be done with it.

import { call } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { describeProgress, jobFacts, hasEnded, hasFiles, jobState } from "../shared/jobs.js";
import { confirm, html, nothing, problemBox, warningList } from "../shared/lit.js";
import { address, announce } from "../shared/page.js";
import { describeSpec } from "../shared/resources.js";
import { CAPTURES, JOBS } from "../shared/strings/captures.js";
import { COMMON } from "../shared/strings/common.js";
import { OPTIONS } from "../shared/strings/send.js";

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
  if (changed.length === 0) return html`<p class="choices quiet">${OPTIONS.usual}</p>`;
  return html`<p class="choices">${changed.map(({ label, value }) => html`<span class="chip"><span class="unseen">${label}: </span>${value}</span>`)}</p>`;
}

// Problem of a failed job, with the camera and the stage that it concerns.
export function errorBox(job) {
  if (!job.error) return nothing;
  const stage = job.stages.find(({ name }) => name === job.error.stage)?.label;
  const where = [job.error.camera && JOBS.camera(job.error.camera), stage].filter(Boolean).join(", ");
  if (job.error.code === "session_refused") {
    return problemBox({ message: JOBS.checkFailed, hint: JOBS.checkFailedHint, code: job.error.code, items: job.error.errors });
  }
  const advice = job.error.hint ?? (job.urls.retry ? JOBS.retryHint : null);
  const message = where ? JOBS.located(job.error.detail, where) : job.error.detail;
  return problemBox({ message, hint: advice, code: job.error.code, items: job.error.errors });
}

// Outage that a job waits for; it continues by itself.
export function waitingBox(job) {
  const outage = job.waiting_for;
  return outage ? warningList([{ message: `${outage.detail} ${outage.hint}`, code: outage.code }], JOBS.waiting) : nothing;
}

// `number`: place of the job among its capture's jobs, from 1; null if it is the only one. `notes` are the capture's.
export function jobRow(view, job, number, notes) {
  const { words, tone } = jobState(job);
  const name = number === null ? job.session_name : JOBS.runOf(job.session_name, number);
  const act = (path, method, said) => view.act(job.id, async () => {
    const answer = await call(path, { method });
    if (answer) feed.put(answer); else feed.remove(job.id);
    announce(said);
    if (!answer) view.focusList();
    else requestAnimationFrame(() => { if (document.activeElement === document.body) view.place.querySelector(`#job-${job.id}`)?.focus(); });
  });
  const remove = async () => {
    const { title, text, action, said } = JOBS.deleting;
    if (await confirm({ title: title(name), text, action })) await act(job.urls.self, "DELETE", said(name));
  };
  const force = () => view.act(job.id, async () => {
    feed.put(await call(`${job.urls.session}/jobs`, { method: "POST", body: { ...job.spec, force: true } }));
    announce(CAPTURES.again.said(job.session_name));
  });
  const isOpenable = job.kind === "reconstruction";
  return html`<li class="job" id="job-${job.id}" tabindex="-1" data-tone=${tone}>
    <div class="line">
      ${number === null ? nothing : html`<b class="run">${JOBS.run(number)}</b>`}
      <span class="state" data-tone=${tone}>${words}</span>
      ${choiceList(job, view.options)}
      <p class="quiet facts">${jobFacts(job).map((fact) => html`<span>${fact}</span>`)}</p>
      <div class="actions">
        ${isOpenable && hasFiles(job) ? html`<a class="button small primary" href=${address("jobs", job.id)} aria-label=${JOBS.openOf(name)}>${JOBS.open}</a>
          <a class="button small" href=${job.urls.results_zip} download aria-label=${JOBS.zipOf(name)}>${JOBS.zip}</a>` : nothing}
        ${isOpenable && !hasFiles(job) ? html`<a class="button small" href=${address("jobs", job.id)} aria-label=${JOBS.detailsOf(name)}>${JOBS.details}</a>` : nothing}
        ${view.canWrite && job.urls.cancel ? html`<button type="button" class="button small" aria-label=${JOBS.cancelOf(name)} @click=${() => act(job.urls.cancel, "POST", JOBS.canceled(name))}>${COMMON.cancel}</button>` : nothing}
        ${view.canWrite && job.urls.retry ? html`<button type="button" class="button small" aria-label=${JOBS.retryOf(name)} @click=${() => act(job.urls.retry, "POST", JOBS.retried(name))}>${JOBS.retry}</button>` : nothing}
        ${view.canWrite && job.error?.code === "session_refused" ? html`<button type="button" class="button small" aria-label=${JOBS.forceOf(name)} @click=${force}>${JOBS.force}</button>` : nothing}
        ${view.canWrite && hasEnded(job) ? html`<button type="button" class="button small ghost" aria-label=${JOBS.deleteOf(name)} @click=${remove}>${JOBS.delete}</button>` : nothing}
      </div>
    </div>
    ${hasEnded(job) || hasFiles(job) ? nothing : stageList(job)}
    ${errorBox(job)}
    ${waitingBox(job)}
    ${problemBox(view.problems.get(job.id))}
    ${warningList(job.warnings, COMMON.warningsOf(name), notes)}
  </li>`;
}
