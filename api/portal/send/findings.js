// Findings of the check of a capture's files.

import { html, nothing } from "../shared/lit.js";

const TONES = { error: "bad", warning: "warn", info: "note" };
const WORDS = { error: "Error", warning: "Warning", info: "Note" };

// `wrap` puts the list where it belongs; nothing without findings.
export function findingList(findings, wrap = (list) => list) {
  if (findings.length === 0) return nothing;
  return wrap(html`<ul class="findings">${findings.map((finding) => html`<li data-tone=${TONES[finding.severity] ?? "note"}>
    <b>${WORDS[finding.severity] ?? "Note"}</b>
    <p>${finding.message}${finding.hint ? html` <span class="hint">${finding.hint}</span>` : nothing}</p>
  </li>`)}</ul>`);
}
