// Templates of the page (lit-html). A value in a template becomes text, never markup: names come from clients.

import { Directive, directive } from "../vendor/lit-html/directive.js";
import { live } from "../vendor/lit-html/directives/live.js";
import { ref } from "../vendor/lit-html/directives/ref.js";
import { html, noChange, nothing, render } from "../vendor/lit-html/lit-html.js";
import { COMMON } from "./strings/common.js";

export { html, live, nothing, ref, render };
export { svg } from "../vendor/lit-html/lit-html.js";
export { repeat } from "../vendor/lit-html/directives/repeat.js";

class Typed extends Directive {
  render() { return noChange; }

  update({ element }, [value]) {
    const text = value === null || value === undefined ? "" : String(value);
    if (element !== document.activeElement && element.value !== text) element.value = text;
    return noChange;
  }
}

// Value of a field, as `.value=${typed(value)}`: it is left alone while it has the focus.
export const typed = directive(Typed);

class Styled extends Directive {
  render() { return noChange; }

  update({ element }, [properties]) {
    for (const [name, value] of Object.entries(properties)) element.style.setProperty(name, value);
    return noChange;
  }
}

// Custom properties of an element, as `<span ${styled({ "--tint": color })}>`: the page's policy allows no style attributes.
export const styled = directive(Styled);

// Text of the service, with `code` in backticks.
export const prose = (text) => text.split("`").map((part, index) => (index % 2 ? html`<code>${part}</code>` : part));

// Parts of forms and lists.

// Field with a list of pairs of value and text. With `choose` it shows the chosen value; without, it keeps its own.
export const selectField = (label, pairs, { name = nothing, chosen = "", choose = null, isOff = false, style = "" } = {}) => html`<label class="field ${style}"><span>${label}</span>
  <select name=${name} ?disabled=${isOff} @change=${choose ? (event) => choose(event.target.value) : nothing}>
    ${pairs.map(([value, text]) => html`<option value=${value} .selected=${choose ? live(value === (chosen ?? "")) : noChange}>${text}</option>`)}</select></label>`;

// Table that is scrolled in itself; `heads` are the texts of its head.
export const scrollTable = (label, heads, rows) => html`<div class="scroll" role="group" aria-label=${label} tabindex="0"><table>
  <thead><tr>${heads.map((head) => html`<th scope="col">${head}</th>`)}</tr></thead><tbody>${rows}</tbody></table></div>`;

const begin = (field) => queueMicrotask(() => { field?.focus(); field?.select(); }); // once it is in the page

// Form with a new name: `rename(name)` gets it, and `end()` hears that none is wanted.
export function renameForm({ name, rename, end }) {
  const submit = (event) => {
    event.preventDefault();
    const wanted = event.target.elements.name.value.trim();
    return wanted && wanted !== name ? rename(wanted) : end();
  };
  return html`<form class="rename" @submit=${submit} @keydown=${(event) => { if (event.key === "Escape") end(); }}>
    <input name="name" maxlength="200" required aria-label=${COMMON.newName(name)} value=${name} autocomplete="off" ${ref(begin)}>
    <button class="button small primary">${COMMON.save}</button>
    <button type="button" class="button small" @click=${end}>${COMMON.cancel}</button>
  </form>`;
}

// A question before something is lost. The focus returns to where it was.

export function confirm({ title, text, action, refusal = COMMON.keep }) {
  return new Promise((resolve) => {
    const dialog = document.createElement("dialog");
    dialog.setAttribute("aria-labelledby", "dialog-title");
    dialog.className = "dialog";
    document.body.append(dialog);
    render(html`<form method="dialog">
      <h2 id="dialog-title">${title}</h2>
      <p>${text}</p>
      <div class="actions end">
        <button class="button" value="no" autofocus>${refusal}</button>
        <button class="button danger" value="yes">${action}</button>
      </div>
    </form>`, dialog);
    dialog.addEventListener("close", () => {
      resolve(dialog.returnValue === "yes");
      dialog.remove();
    });
    dialog.showModal();
  });
}

// The problem, and the remedy.

function where(item) {
  return [item.file, item.camera, item.field].filter(Boolean).join(", ") || item.pointer || "";
}

// Link to a page of the documentation, beside what it is about.
export const helpLink = (topic, about) => html`<a class="help" href="/help/${topic}" target="_blank" rel="noopener"
  aria-label=${COMMON.help(about)} title=${COMMON.help(about)}>?</a>`;

// Link to what a code of a problem, a finding or a warning means, and what to do.
export const moreLink = (code) => (code ? html` <a class="more" href="/help/problems#${code}" target="_blank" rel="noopener"
  aria-label=${COMMON.moreAbout(code)}>${COMMON.more}</a>` : nothing);

// Box with a problem and its parts; nothing without a problem.
export function problemBox(problem) {
  if (!problem) return nothing;
  return html`<div class="problem" role="alert">
    <p>${prose(problem.message ?? problem.detail)}${problem.hint ? html` <span class="hint">${prose(problem.hint)}</span>` : nothing}${moreLink(problem.code)}</p>
    ${problem.items?.length ? html`<ul>${problem.items.map((item) => html`<li>
      ${where(item) ? html`<b>${where(item)}:</b> ` : nothing}${prose(item.message)}
      ${item.hint ? html`<span class="hint">${prose(item.hint)}</span>` : nothing}${moreLink(item.code)}</li>`)}</ul>` : nothing}
  </div>`;
}

// List of warnings; nothing without any. `notes` has what is known of warnings, by their codes.
export function warningList(warnings, label, notes = {}) {
  if (!warnings?.length) return nothing;
  return html`<ul class="warnings" aria-label=${label}>${warnings.map(({ code, message, hint }) => html`<li>${prose(message)}
    ${hint ? html`<span class="hint">${prose(hint)}</span>` : nothing} ${notes[code] ?? nothing}${moreLink(code)}</li>`)}</ul>`;
}
