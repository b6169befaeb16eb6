// Form for another run of a capture with other choices; nothing is uploaded.

import { announce } from "../shared/announce.js";
import { call } from "../shared/api.js";
import { cameraFramesOf, estimateOf } from "../shared/estimate.js";
import { feed } from "../shared/feed.js";
import { html } from "../shared/lit.js";
import { characterOf, choicesForm } from "../send/choices.js";

// Choices that a session states for its jobs.
const OF_SESSION = ["sync", "timeline"];

// Choices of a job that differ from the defaults; without a job those of its session.
export function specOf(job, options, session) {
  const stated = job?.spec ?? Object.fromEntries(OF_SESSION.map((name) => [name, session[name]]));
  const differs = ({ name, default: usual }) => (job || OF_SESSION.includes(name))
    && JSON.stringify(stated[name] ?? null) !== JSON.stringify(usual ?? null);
  return { ...Object.fromEntries(options.choices.filter(differs).map(({ name }) => [name, stated[name]])), ...characterOf(stated) };
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
    // What the form shows counts, also against what the session states.
    const usual = Object.fromEntries(view.options.choices.filter(({ name }) => OF_SESSION.includes(name)).map((choice) => [choice.name, choice.default]));
    return view.act(session.id, async () => {
      const job = await call(session.links.jobs, { method: "POST", body: { ...usual, ...spec } });
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
