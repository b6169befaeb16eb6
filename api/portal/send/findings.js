// Findings of the check of a capture's files, with the picture that shows each.

import { html, nothing } from "../shared/lit.js";

const TONES = { error: "bad", warning: "warn", info: "note", note: "note" };

function evidenceOf(finding) {
  const pictures = (finding.evidence?.thumbnails ?? []).filter((one) => typeof one === "string" && one.startsWith("data:image/"));
  return pictures.map((picture) => html`<img class="evidence" src=${picture} alt="Picture of ${finding.camera ?? "the capture"}">`);
}

// `wrap` puts the list where it belongs; nothing without findings.
export function findingList(findings, wrap = (list) => list) {
  if (findings.length === 0) return nothing;
  return wrap(html`<ul class="findings">${findings.map((finding) => html`<li data-tone=${TONES[finding.severity] ?? "note"}>
    ${evidenceOf(finding)}
    <p>${finding.message}${finding.hint ? html` <span class="hint">${finding.hint}</span>` : nothing}</p>
  </li>`)}</ul>`);
}
