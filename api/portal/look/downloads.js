// Files of a job to download, by person.

import { addressed } from "../shared/api.js";
import { size } from "../shared/format.js";
import { html } from "../shared/lit.js";

function fileLink({ name, link, num_bytes: bytes }) {
  return html`<li><a href=${addressed(link)} download>${name} <span class="quiet">${size(bytes)}</span></a></li>`;
}

export function downloads(job, results) {
  const people = [...new Set(results.map(({ person }) => person))].sort((one, other) => (one === null) - (other === null));
  return html`<section class="panel downloads" aria-labelledby="files-title">
    <div class="head"><h2 id="files-title">Files</h2>
      <a class="button small primary" href=${addressed(job.links.results_zip)} download>All as ZIP</a></div>
    ${people.map((person) => html`<div class="of-person"><h3>${person ?? "Everybody"}</h3>
      <ul class="results">${results.filter((one) => one.person === person).map(fileLink)}</ul></div>`)}
  </section>`;
}
