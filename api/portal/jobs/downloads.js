// Files of a job to download, by person and format.

import { addressed } from "../shared/api.js";
import { size } from "../shared/format.js";
import { hasEnded } from "../shared/jobs.js";
import { html, nothing } from "../shared/lit.js";

// Files of all people by their kind, in the order of the page.
const OF_ALL = {
  report: "Report, opens in a browser",
  overlay: "Video with the skeletons",
  rerun: "Recording for Rerun's viewer",
  blurred: "Video with blurred heads",
  skeletons: "Joints of everybody, JSON",
  metrics: "Quality figures, JSON",
  calibration: "Refined calibration, JSON",
  character: "Bones of the character, JSON",
};
const ORDER = Object.keys(OF_ALL);

// Files that are rebuilt after edits have rested.
const VISUALS = { report: "report", overlay: "overlay videos", rerun: "recording" };

// Tables of a person beside the files in a format.
const OF_PERSON = { events: "Foot strikes, foot offs and jumps, CSV", strides: "Strides and their figures, CSV" };

/** What a file is: its format, and the application that it is written for. */
function fileWords({ kind, format, preset, person }, options) {
  const label = (name, value) => options?.choices.find((choice) => choice.name === name)?.values.find((one) => one.name === value)?.label ?? value;
  if (kind === "character" && person !== null) return "The character in motion";
  if (!format) return OF_ALL[kind] ?? OF_PERSON[kind] ?? kind;
  if (kind in OF_ALL) return OF_ALL[kind];
  if (person === null) return `${label("exports", format)}, in one scene with cameras and floor`;
  return preset && preset !== "default" ? `${label("exports", format)} for ${label("preset", preset)}` : label("exports", format);
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
 * null for those who may not. `hasVideos`: the videos of the session were not deleted.
 */
export function downloads(job, results, options, makeVisuals, { hasVideos = true } = {}) {
  const people = [...new Map(results.filter(({ person }) => person !== null).map(({ person, person_name: name }) => [person, name])).entries()]
    .sort(([one], [other]) => one - other);
  const ofAll = results.filter(({ person }) => person === null).sort((one, other) => ORDER.indexOf(one.kind) - ORDER.indexOf(other.kind));
  const isVisual = ({ kind }) => kind in VISUALS;
  const isShown = ({ kind }) => kind in VISUALS || kind === "blurred";
  return html`<section class="panel downloads" aria-labelledby="files-title">
    <div class="head"><h2 id="files-title" tabindex="-1">Files</h2>
      <a class="button small primary" href=${addressed(job.urls.results_zip)} download>All as ZIP</a></div>
    ${revisionNote(job)}
    ${visualsNote(job, ofAll.filter(isVisual), makeVisuals, hasVideos)}
    ${group("To show", ofAll.filter(isShown), options)}
    ${people.map(([person, name]) => group(name, results.filter((result) => result.person === person), options))}
    ${group("Everybody", ofAll.filter((result) => !isShown(result)), options)}
  </section>`;
}

const of = (revision) => (revision === 0 ? "the take as found" : `revision ${revision}`);

function revisionNote({ revision, results_revision: shown, state }) {
  if (shown === revision) return nothing;
  const next = hasEnded({ state }) ? `Those of revision ${revision} were not made.` : `Those of revision ${revision} are being made.`;
  return html`<p class="notice">These are the files of ${of(shown)}. ${next}</p>`;
}

// Report, overlay videos and recording follow edits by a job of their own: on request, or when edits rest.
function visualsNote(job, visuals, makeVisuals, hasVideos) {
  const earlier = visuals.filter(({ revision }) => revision < job.revision);
  if (earlier.length === 0) return nothing;
  const kinds = Object.keys(VISUALS).filter((kind) => earlier.some((one) => one.kind === kind));
  const names = new Intl.ListFormat("en-GB").format(kinds.map((kind) => `the ${VISUALS[kind]}`));
  const verb = kinds.length > 1 || kinds[0] === "overlay" ? "show" : "shows";
  const shown = `${names.replace("the", "The")} ${verb} ${of(Math.min(...earlier.map(({ revision }) => revision)))}.`;
  const { state } = job.visuals_job ?? { state: null };
  if (state === "failed") return visualsBox(job, `${shown} Those of revision ${job.revision} could not be made.`, "Try again", makeVisuals);
  if (state !== null && !hasEnded({ state })) return visualsBox(job, `${shown} Those of revision ${job.revision} are being made.`);
  if (!hasVideos && (job.spec.overlay || job.spec.exports.includes("rerun"))) return visualsBox(job, `${shown} They can't be rebuilt, because the videos were deleted.`);
  return visualsBox(job, `${shown} They are rebuilt when you ask for it, or when nobody has edited for a while.`, "Make them now", makeVisuals);
}

function visualsBox(job, words, action = null, makeVisuals = null) {
  const canMake = action !== null && makeVisuals !== null && job.urls.visuals !== null;
  return html`<div class="notice visuals"><p>${words}</p>
    ${canMake ? html`<button type="button" class="button small" @click=${makeVisuals}>${action}</button>` : nothing}</div>`;
}
