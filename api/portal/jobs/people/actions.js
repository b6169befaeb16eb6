// What can be done with the chosen person and with the take, at the play head.

import { count } from "../../shared/format.js";
import { confirm, html, nothing, typed } from "../../shared/lit.js";
import { announce } from "../../shared/page.js";
import { numFrames, sharedFrames } from "./person_names.js";

const MAX_NAME = 100;

// Controls of a `PeoplePanel`.
export function actions(panel) {
  const { selected, people } = panel;
  const isCut = people.start_frame > 0 || people.stop_frame < people.num_frames;
  return html`<div class="at-head">
      <label class="field frame"><span>Frame</span>
        <input class="frame-field" type="number" min=${people.start_frame} max=${people.stop_frame - 1} step="1"
          @change=${(event) => seek(panel, event.target)} @keydown=${(event) => { if (event.key === "Enter") seek(panel, event.target); }}></label>
      <p class="quiet">The frame at the play head. ${isCut ? `Frames count from the start of the whole take; ${people.start_frame} to ${people.stop_frame - 1} are kept.` : ""}</p>
    </div>
    ${selected === null ? nothing : personActions(panel)}
    <fieldset class="doing"><legend>The take</legend><div class="actions">
      ${panel.button("Start the take here", () => cut(panel, panel.frame, people.stop_frame))}
      ${panel.button("End the take here", () => cut(panel, people.start_frame, panel.frame + 1))}
      <span class="quiet">${panel.lengthText} of ${people.num_frames} kept</span></div></fieldset>`;
}

function seek(panel, field) {
  if (field.value !== "") panel.seek(Math.round(Number(field.value)));
  field.value = panel.frame;
}

function personActions(panel) {
  const { selected: person, other, people } = panel;
  const name = panel.personName(person);
  const others = people.people.filter(({ id }) => id !== person);
  return html`<fieldset class="doing"><legend>${name}</legend>
    <form class="actions" @submit=${(event) => rename(panel, event)}>
      <label class="field"><span class="unseen">New name of ${name}</span>
        <input name="name" maxlength=${MAX_NAME} required autocomplete="off" .value=${typed(name)}></label>
      <button class="button small" aria-label="Rename ${name}">Rename</button>
    </form>
    <div class="actions">
      ${panel.button("Split here", () => split(panel))}
      ${panel.button(`Delete ${name}`, () => panel.add({ action: "remove", person }), { style: "danger-quiet" })}
    </div>
    ${other === null ? nothing : html`<div class="actions">
      <label class="with"><span>With</span> <select aria-label="Other person" @change=${(event) => { panel.other = Number(event.target.value); panel.draw(); }}>
        ${others.map(({ id, name: label }) => html`<option value=${id} .selected=${id === other}>${label}</option>`)}</select></label>
      ${panel.button(`Merge into ${panel.personName(other)}`, () => merge(panel))}
      ${panel.button(`Exchange with ${panel.personName(other)} from here on`, () => exchange(panel))}
    </div>`}
  </fieldset>`;
}

function rename(panel, event) {
  event.preventDefault();
  const { selected: person } = panel;
  const name = event.target.elements.name.value.trim();
  if (name === panel.personName(person)) return announce(`The name is ${name} already.`);
  return panel.add({ action: "rename", person, name });
}

function split(panel) {
  return panel.add({ action: "split", person: panel.selected, frame: panel.frame });
}

function exchange(panel) {
  return panel.add({ action: "exchange", person: panel.selected, other: panel.other, start_frame: panel.frame });
}

// One person is in one place: in frames of both, the frames of the one who is merged are lost.
async function merge(panel) {
  const { selected, other } = panel;
  const [lost, kept] = [selected, other].map((id) => panel.people.people.find((person) => person.id === id));
  const shared = sharedFrames(lost, kept);
  if (shared.num > 0) {
    const text = `Both are there in ${count(shared.num, "frame")}, from ${shared.first} to ${shared.last}. There ${kept.name} counts, and ${shared.num} of the ${count(numFrames(lost), "frame")} of ${lost.name} are lost. Undo brings them back.`;
    if (!await confirm({ title: `Merge ${lost.name} into ${kept.name}?`, text, action: "Merge", refusal: "Keep both" })) return;
  }
  await panel.add({ action: "merge", person: other, other: selected });
  if (panel.people.people.every(({ id }) => id !== selected)) panel.select(other);
}

function cut(panel, start, stop) {
  const { people } = panel;
  if (start === people.start_frame && stop === people.stop_frame) {
    return announce(start === panel.frame ? "The take starts here already." : "The take ends here already.");
  }
  return panel.add({ action: "cut", start_frame: start, stop_frame: stop });
}
