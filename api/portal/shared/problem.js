// What went wrong, and what to do.

import { html, nothing } from "./lit.js";

function where(item) {
  return [item.file, item.camera, item.field].filter(Boolean).join(", ") || item.pointer || "";
}

// Box with a problem and its parts; nothing without a problem.
export function problemBox(problem) {
  if (!problem) return nothing;
  return html`<div class="problem" role="alert">
    <p>${problem.message ?? problem.detail}${problem.hint ? html` <span class="hint">${problem.hint}</span>` : nothing}</p>
    ${problem.items?.length ? html`<ul>${problem.items.map((item) => html`<li>
      ${where(item) ? html`<b>${where(item)}:</b> ` : nothing}${item.message}
      ${item.hint ? html`<span class="hint">${item.hint}</span>` : nothing}</li>`)}</ul>` : nothing}
  </div>`;
}

export function warningList(warnings, label = "Warnings") {
  if (!warnings?.length) return nothing;
  return html`<ul class="warnings" aria-label=${label}>${warnings.map((warning) => html`<li>${warning}</li>`)}</ul>`;
}
