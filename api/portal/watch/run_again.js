// Form for another run of a capture with other choices; nothing is uploaded.

import { announce } from "../shared/announce.js";
import { call } from "../shared/api.js";
import { cameraFramesOf, estimateOf } from "../shared/estimate.js";
import { feed } from "../shared/feed.js";
import { html } from "../shared/lit.js";
import { choicesForm } from "../send/choices.js";

// Choices of a job that differ from the defaults; without a job those of its session.
export function specOf(job, options, session) {
  const differs = ({ name, default: usual }) => JSON.stringify(job.spec[name] ?? null) !== JSON.stringify(usual ?? null);
  return job ? Object.fromEntries(options.choices.filter(differs).map(({ name }) => [name, job.spec[name]]))
    : session.sync === "auto" ? { sync: "auto" } : {};
}

export function runAgainForm(view, session) {
  const spec = view.opened.get(session.id);
  const close = () => {
    view.opened.delete(session.id);
    view.draw();
    view.place.querySelector(`#run-${session.id}`)?.focus();
  };
  const change = (name, value) => {
    if (value === undefined) delete spec[name]; else spec[name] = value;
    view.draw();
  };
  const submit = (event) => {
    event.preventDefault();
    return view.act(session.id, async () => {
      const job = await call(session.links.jobs, { method: "POST", body: { sync: "declared", ...spec } });
      feed.put(job);
      close();
      announce(`Another job of ${session.name} waits.`);
    });
  };
  const { preflight } = session;
  const counts = preflight.cameras.map(({ num_frames: number }) => number);
  const isVideo = session.files.some(({ kind }) => kind === "video");
  const noteOf = (choice, value) => {
    const wanted = { ...spec, profile: value };
    return isVideo && choice.name === "profile" ? estimateOf(wanted, cameraFramesOf(counts, wanted), feed.newest(), view.options)?.text : null;
  };
  return html`<form class="again" id="again-${session.id}" aria-label="Run ${session.name} again" @submit=${submit}>
    ${choicesForm({ id: `again-${session.id}`, options: view.options, spec, onChange: change, noteOf })}
    <div class="actions"><button class="button primary">Reconstruct without uploading</button>
      <button type="button" class="button" @click=${close}>Close</button></div>
  </form>`;
}
