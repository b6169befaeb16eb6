// Files of a job to download, by person and format.

import { addressed } from "../shared/api.js";
import { size } from "../shared/format.js";
import { html, nothing } from "../shared/lit.js";

// Files of all people by their kind, in the order of the page.
const OF_ALL = {
  report: "Report, opens in a browser",
  overlay: "Video with the skeletons",
  skeletons: "Joints of everybody, JSON",
  metrics: "Quality figures, JSON",
  calibration: "Refined calibration, JSON",
};
const ORDER = Object.keys(OF_ALL);

/** What a file is: its format, and the application of a BVH file. */
function wordsOf({ kind, format, preset }, options) {
  const label = (name, value) => options?.choices.find((choice) => choice.name === name)?.values.find((one) => one.name === value)?.label ?? value;
  if (!format) return OF_ALL[kind] ?? kind;
  return preset && preset !== "default" ? `${label("exports", format)} for ${label("bvh", preset)}` : label("exports", format);
}

function fileLink(result, options) {
  return html`<li><a href=${addressed(result.link)} download>
    <span class="what">${wordsOf(result, options)}</span>
    <span class="name">${result.download_name}</span> <span class="quiet">${size(result.num_bytes)}</span></a></li>`;
}

function group(title, results, options) {
  return results.length === 0 ? nothing : html`<div class="of-person"><h3>${title}</h3>
    <ul class="results">${results.map((one) => fileLink(one, options))}</ul></div>`;
}

export function downloads(job, results, options) {
  const people = [...new Set(results.map(({ person }) => person).filter((person) => person !== null))]
    .sort((one, other) => one.localeCompare(other, "en", { numeric: true }));
  const ofAll = results.filter(({ person }) => person === null).sort((one, other) => ORDER.indexOf(one.kind) - ORDER.indexOf(other.kind));
  const isShown = ({ kind }) => kind === "report" || kind === "overlay";
  return html`<section class="panel downloads" aria-labelledby="files-title">
    <div class="head"><h2 id="files-title">Files</h2>
      <a class="button small primary" href=${addressed(job.links.results_zip)} download>All as ZIP</a></div>
    ${group("To show", ofAll.filter(isShown), options)}
    ${people.map((person) => group(person, results.filter((one) => one.person === person), options))}
    ${group("Everybody", ofAll.filter((one) => !isShown(one)), options)}
  </section>`;
}
