// Findings of the check of a capture's files.

import { html, nothing } from "../shared/lit.js";

const TONES = { error: "bad", warning: "warn", info: "note" };
const WORDS = { error: "Error", warning: "Warning", info: "Note" };
// Findings that tell of the load of the service rather than of the files.
const OF_LOAD = ["pictures_left_out"];

// Picture in the middle of a camera's time; nothing for keypoints.
export function pictureOf(camera) {
  const { thumbnails = [] } = camera ?? {};
  if (thumbnails.length === 0) return nothing;
  return html`<img class="thumb" src=${thumbnails[Math.floor(thumbnails.length / 2)].link} alt="" loading="lazy">`;
}

// Pictures that a finding names, with their cameras and times; beside a copy the camera that it repeats.
function evidenceOf({ code, camera, evidence }, cameras) {
  const names = code === "same_video" ? [camera, evidence?.other_camera] : [camera];
  const shown = names.flatMap((name) => {
    const { thumbnails = [] } = cameras.find((camera) => camera.name === name) ?? {};
    return (evidence?.pictures ?? []).map((number) => ({ name, ...thumbnails[number] })).filter(({ link }) => link);
  });
  if (shown.length === 0) return nothing;
  return html`<div class="pictures">${shown.map(({ name, link, time_s: time }) => html`<figure>
    <img class="evidence" src=${link} alt="Picture of ${name} at ${time.toFixed(1)} s" loading="lazy"><figcaption>${name}, ${time.toFixed(1)} s</figcaption>
  </figure>`)}</div>`;
}

// `wrap` puts the list where it belongs; nothing without findings. `cameras` are those of the check, with their pictures.
export function findingList(findings, cameras = [], wrap = (list) => list) {
  if (findings.length === 0) return nothing;
  return wrap(html`<ul class="findings">${findings.map((finding) => html`<li data-tone=${TONES[finding.severity] ?? "note"}>
    <b>${OF_LOAD.includes(finding.code) ? "The service was busy" : WORDS[finding.severity] ?? "Note"}</b>
    <div><p>${finding.message}${finding.hint ? html` <span class="hint">${finding.hint}</span>` : nothing}</p>${evidenceOf(finding, cameras)}</div>
  </li>`)}</ul>`);
}
