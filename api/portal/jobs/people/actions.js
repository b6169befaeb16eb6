// Actions on the chosen person and on the take, at the play head.

import { confirm, html, nothing, repeat, typed } from "../../shared/lit.js";
import { announce } from "../../shared/page.js";
import { COMMON, COUNTS } from "../../shared/strings/common.js";
import { PEOPLE } from "../../shared/strings/take.js";
import { numFrames, sharedFrames } from "./person_names.js";

const MAX_NAME = 100;

// Controls of a `PeoplePanel`.
export function actions(panel) {
  const { selected, people } = panel;
  const isCut = people.start_frame > 0 || people.stop_frame < people.num_frames;
  return html`<div class="at-head">
      <label class="field frame"><span>${PEOPLE.frame}</span>
        <input class="frame-field" type="number" min=${people.start_frame} max=${people.stop_frame - 1} step="1"
          @change=${(event) => seek(panel, event.target)} @keydown=${(event) => { if (event.key === "Enter") seek(panel, event.target); }}></label>
      <p class="quiet">${isCut ? PEOPLE.frameHintCut(people.start_frame, people.stop_frame - 1) : PEOPLE.frameHint}</p>
    </div>
    ${selected === null ? nothing : personActions(panel)}
    <fieldset class="doing"><legend>${PEOPLE.take}</legend><div class="actions">
      ${panel.button(PEOPLE.startHere, () => cut(panel, panel.frame, people.stop_frame))}
      ${panel.button(PEOPLE.endHere, () => cut(panel, people.start_frame, panel.frame + 1))}
      <span class="quiet">${PEOPLE.kept(COUNTS.frames(people.stop_frame - people.start_frame), people.num_frames)}</span></div></fieldset>`;
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
      <label class="field"><span class="unseen">${COMMON.newName(name)}</span>
        <input name="name" maxlength=${MAX_NAME} required autocomplete="off" .value=${typed(name)}></label>
      <button class="button small" aria-label=${COMMON.renameOf(name)}>${COMMON.rename}</button>
    </form>
    ${massForm(panel, people.people.find(({ id }) => id === person), name)}
    <div class="actions">
      ${panel.button(PEOPLE.splitHere, () => split(panel))}
      ${panel.button(PEOPLE.actions.remove(name), () => panel.add({ action: "remove", person }), { style: "danger-quiet" })}
    </div>
    ${other === null ? nothing : html`<div class="actions">
      <label class="with"><span>${PEOPLE.with}</span> <select aria-label=${PEOPLE.other} @change=${(event) => { panel.other = Number(event.target.value); panel.draw(); }}>
        ${others.map(({ id, name: label }) => html`<option value=${id} .selected=${id === other}>${label}</option>`)}</select></label>
      ${panel.button(PEOPLE.mergeInto(panel.personName(other)), () => merge(panel))}
      ${panel.button(PEOPLE.exchangeWith(panel.personName(other)), () => exchange(panel))}
    </div>`}
  </fieldset>`;
}

// Sex and mass of a person, for the centre of mass and momenta. A choice that is not set yet stays until another person is chosen.
function massForm(panel, { id, sex, mass_kg: mass }, name) {
  const describe = (event) => {
    event.preventDefault();
    const fields = event.target.elements;
    const stated = { sex: fields.sex.value || null, mass_kg: fields.mass.value === "" ? null : fields.mass.valueAsNumber };
    if (stated.sex === sex && stated.mass_kg === mass) return announce(PEOPLE.sameMass(name));
    return panel.add({ action: "describe", person: id, ...stated });
  };
  const form = () => html`<form class="actions" @submit=${describe}>
    <label class="with"><span>${PEOPLE.sex}</span> <select name="sex">
      ${Object.entries(PEOPLE.sexes).map(([value, label]) => html`<option value=${value} .selected=${value === (sex ?? "")}>${label}</option>`)}</select></label>
    <label class="with"><span>${PEOPLE.mass}</span> <input class="number" name="mass" type="number" min="1" max="500" step="any"
      placeholder=${PEOPLE.asOptions} value=${mass ?? ""}></label>
    <button class="button small" aria-label=${PEOPLE.setMassOf(name)}>${PEOPLE.setMass}</button>
  </form>`;
  return repeat([[id, sex, mass].join()], String, form);
}

function rename(panel, event) {
  event.preventDefault();
  const { selected: person } = panel;
  const name = event.target.elements.name.value.trim();
  if (name === panel.personName(person)) return announce(PEOPLE.sameName(name));
  return panel.add({ action: "rename", person, name });
}

function split(panel) {
  return panel.add({ action: "split", person: panel.selected, frame: panel.frame });
}

function exchange(panel) {
  return panel.add({ action: "exchange", person: panel.selected, other: panel.other, start_frame: panel.frame, stop_frame: null });
}

// One person is in one place: in frames of both, the frames of the one who is merged are lost.
async function merge(panel) {
  const { selected, other } = panel;
  const [lost, kept] = [selected, other].map((id) => panel.people.people.find((person) => person.id === id));
  const shared = sharedFrames(lost, kept);
  if (shared.num > 0) {
    const { title, text, action, refusal } = PEOPLE.merging;
    const facts = { ...shared, shared: COUNTS.frames(shared.num), kept: kept.name, lost: lost.name, total: COUNTS.frames(numFrames(lost)) };
    if (!await confirm({ title: title(lost.name, kept.name), text: text(facts), action, refusal })) return;
  }
  await panel.add({ action: "merge", person: other, other: selected });
  if (panel.people.people.every(({ id }) => id !== selected)) panel.select(other);
}

function cut(panel, start, stop) {
  const { people } = panel;
  if (start === people.start_frame && stop === people.stop_frame) {
    return announce(start === panel.frame ? PEOPLE.startsHere : PEOPLE.endsHere);
  }
  return panel.add({ action: "cut", start_frame: start, stop_frame: stop });
}
