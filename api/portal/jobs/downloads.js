// Files of a job to download, by person and format.

import { addressed } from "../shared/api.js";
import { size } from "../shared/format.js";
import { hasEnded } from "../shared/jobs.js";
import { html, nothing } from "../shared/lit.js";
import { TAKE } from "../shared/strings/take.js";

const ORDER = Object.keys(TAKE.kinds); // of files of all people

// Files that are rebuilt some time after the last edit.
const VISUALS = ["report", "overlay", "rerun"];

/** Description of a file: its format, and the application that it is written for. */
function fileWords({ kind, format, preset, person }, options) {
  const label = (name, value) => options?.choices.find((choice) => choice.name === name)?.values.find((one) => one.name === value)?.label ?? value;
  if (kind === "character" && person !== null) return TAKE.characterMotion;
  if (!format) return TAKE.kinds[kind] ?? TAKE.kindsOfPerson[kind] ?? kind;
  if (kind in TAKE.kinds) return TAKE.kinds[kind];
  if (person === null) return TAKE.inScene(label("exports", format));
  return preset && preset !== "default" ? TAKE.formatFor(label("exports", format), label("preset", preset)) : label("exports", format);
}

function fileLink(result, options) {
  return html`<li><a href=${addressed(result.url)} download>
    <span class="what">${fileWords(result, options)}</span>
    <span class="name">${result.download_name}</span> <span class="quiet">${size(result.num_bytes)}</span></a></li>`;
}

function group(title, results, options) {
  return results.length === 0 ? nothing : html`<div class="of-person"><h3>${title}</h3>
    <ul class="results">${results.map((result) => fileLink(result, options))}</ul></div>`;
}

/**
 * Files of the job's last revision that has some. `makeVisuals` makes report, overlay videos and recording of the present edits;
 * null for those who may not. `hasVideos`: the videos of the session were not deleted. `adding` is a form for more files.
 */
export function downloads(job, results, options, makeVisuals, { hasVideos = true, adding = nothing } = {}) {
  const people = [...new Map(results.filter(({ person }) => person !== null).map(({ person, person_name: name }) => [person, name])).entries()]
    .sort(([one], [other]) => one - other);
  const ofAll = results.filter(({ person }) => person === null).sort((one, other) => ORDER.indexOf(one.kind) - ORDER.indexOf(other.kind));
  const isVisual = ({ kind }) => VISUALS.includes(kind);
  const isShown = (file) => isVisual(file) || file.kind === "blurred";
  return html`<section class="panel downloads" aria-labelledby="files-title">
    <div class="head"><h2 id="files-title" tabindex="-1">${TAKE.files}</h2>
      <a class="button small primary" href=${addressed(job.urls.results_zip)} download>${TAKE.zip}</a></div>
    ${revisionNote(job)}
    ${visualsNote(job, ofAll.filter(isVisual), makeVisuals, hasVideos)}
    ${group(TAKE.toShow, ofAll.filter(isShown), options)}
    ${people.map(([person, name]) => group(name, results.filter((result) => result.person === person), options))}
    ${group(TAKE.ofEveryone, ofAll.filter((result) => !isShown(result)), options)}
    ${adding}
  </section>`;
}

const named = (revision) => (revision === 0 ? TAKE.unedited : TAKE.revision(revision));

function revisionNote(job) {
  const { revision, results_revision: shown } = job;
  if (shown === revision) return nothing;
  const next = hasEnded(job) ? TAKE.notMade(revision) : TAKE.inWork(revision);
  return html`<p class="notice">${TAKE.shows(named(shown))} ${next}</p>`;
}

// Report, overlay videos and recording follow edits by a job of their own: on request, or when edits rest.
function visualsNote(job, visuals, makeVisuals, hasVideos) {
  const earlier = visuals.filter(({ revision }) => revision < job.revision);
  if (earlier.length === 0) return addedVisualsNote(job, makeVisuals);
  const kinds = VISUALS.filter((kind) => earlier.some((one) => one.kind === kind));
  const names = new Intl.ListFormat(TAKE.listLanguage).format(kinds.map((kind) => TAKE.visuals[kind]));
  const shown = TAKE.visualsShow(names, kinds.length > 1 || kinds[0] === "overlay", named(Math.min(...earlier.map(({ revision }) => revision))));
  const { state } = job.visuals_job ?? { state: null };
  if (state === "failed") return visualsBox(job, `${shown} ${TAKE.visualsFailed(job.revision)}`, TAKE.tryAgain, makeVisuals);
  if (state !== null && !hasEnded({ state })) return visualsBox(job, `${shown} ${TAKE.visualsInWork(job.revision)}`);
  if (!hasVideos && (job.spec.overlay || job.spec.exports.includes("rerun"))) return visualsBox(job, `${shown} ${TAKE.visualsImpossible}`);
  return visualsBox(job, `${shown} ${TAKE.visualsLater}`, TAKE.makeNow, makeVisuals);
}

// Visuals that were added, and of which there are none yet.
function addedVisualsNote(job, makeVisuals) {
  const { state } = job.visuals_job ?? { state: null };
  if (job.urls.visuals !== null) return visualsBox(job, state === "failed" ? TAKE.addedFailed : TAKE.addedLater, TAKE.makeNow, makeVisuals);
  return state !== null && !hasEnded({ state }) ? visualsBox(job, TAKE.addedInWork) : nothing;
}

function visualsBox(job, words, action = null, makeVisuals = null) {
  const canMake = action !== null && makeVisuals !== null && job.urls.visuals !== null;
  return html`<div class="notice visuals"><p>${words}</p>
    ${canMake ? html`<button type="button" class="button small" @click=${makeVisuals}>${action}</button>` : nothing}</div>`;
}
