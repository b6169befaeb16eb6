// The latest jobs in short, beside the form.

import { address } from "../shared/router.js";
import { hasEnded, stateOf } from "../shared/jobs.js";
import { html, nothing, repeat } from "../shared/lit.js";

const SHOWN = 4;

export function recentJobs(feed) {
  const jobs = feed.newest().slice(0, SHOWN);
  if (jobs.length === 0) return nothing;
  return html`<section class="panel recent" aria-labelledby="recent-title">
    <h2 id="recent-title">Latest</h2>
    <ol>${repeat(jobs, ({ id }) => id, (job) => {
      const { words, tone } = stateOf(job);
      return html`<li>
        <a href=${address("jobs", job.id)}>${job.kind === "calibration" ? "Calibration: " : ""}${job.session_name}</a>
        <span class="state" data-tone=${tone}>${words}</span>
        ${hasEnded(job) ? nothing : html`<progress max="1" .value=${job.progress} aria-label="Progress of ${job.session_name}"></progress>`}
      </li>`;
    })}</ol>
    <a class="all" href="#/captures">All captures</a>
  </section>`;
}
