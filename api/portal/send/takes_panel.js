// Part of the view Send that lists the takes of a folder.

import { count } from "../shared/format.js";
import { html, nothing, repeat } from "../shared/lit.js";
import { problemBox } from "../shared/problem.js";
import { address } from "../shared/router.js";

const WORDS = { waiting: "waits", sent: "sent", before: "sent before", failed: "not sent" };
const TONES = { sent: "good", before: "good", failed: "bad" };
const AGAIN = { before: "Send again", failed: "Show" };

function offer(takes, failed) {
  const names = takes.offered.takes.map(({ name }) => name);
  return html`<section class="panel" aria-labelledby="takes-title"><h2 id="takes-title">${count(names.length, "folder")}</h2>
    <p>${names.join(", ")}: is each a take of all cameras?</p>
    <div class="actions">
      <button type="button" class="button primary" @click=${() => takes.accept().catch(failed)}>They are ${names.length} takes</button>
      <button type="button" class="button" @click=${() => takes.decline().catch(failed)}>All files are one capture</button>
    </div></section>`;
}

function row(take, takes, failed) {
  const { name, files, state, problem, job } = take;
  const tools = takes.isRunning ? nothing : html`
    ${state in AGAIN ? html`<button type="button" class="button ghost" aria-label="${AGAIN[state]} ${name}" @click=${() => takes.again(take).catch(failed)}>${AGAIN[state]}</button>` : nothing}
    ${state === "sent" ? nothing : html`<button type="button" class="button ghost icon" aria-label="Leave out ${name}" title="Leave out" @click=${() => takes.remove(take)}>✕</button>`}`;
  return html`<li>
    <b>${job ? html`<a href=${address("jobs", job.id)}>${name}</a>` : name}</b>
    <span class="quiet">${count(files.length, "file")}</span>
    <span class="state" data-tone=${TONES[state] ?? nothing}>${WORDS[state]}</span>
    <span class="tools">${tools}</span>
    ${problemBox(problem)}</li>`;
}

export function takesPanel(takes, failed) {
  if (takes.offered) return offer(takes, failed);
  if (takes.list.length === 0) return nothing;
  const numSent = takes.list.filter(({ job }) => job).length;
  return html`<section class="panel" aria-labelledby="takes-title">
    <h2 id="takes-title">${count(takes.list.length, "take")}, ${numSent} sent</h2>
    <p class="quiet">All get the calibration and the choices below. A take that can't be sent does not stop the others.</p>
    <ol class="takes" aria-label="Takes">${repeat(takes.list, ({ name }) => name, (take) => row(take, takes, failed))}</ol></section>`;
}
