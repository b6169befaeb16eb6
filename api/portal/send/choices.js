// Form of a job's choices, made from what the service lists: purpose, people and quality, the rest folded.

import { size } from "../shared/format.js";
import { helpLink, html, live, nothing, problemBox, prose, svg, typed } from "../shared/lit.js";
import { characters, describeSpec } from "../shared/resources.js";
import { COMMON, COUNTS } from "../shared/strings/common.js";
import { OPTIONS } from "../shared/strings/send.js";

const ASKED = ["people", "quality"]; // groups of choices that are always asked, beside the purpose
const FOLDED = ["purpose", "advanced"];
const FEW_PEOPLE = 4;

// Values of a choice that can be had here: networks that a worker lacks are not offered.
function offered(choice, spec, options) {
  const lacks = new Map();
  if (choice.name === "detector") options.detectors.forEach(({ name, installed }) => lacks.set(name, installed === false));
  const networks = (profile, joints) => profile?.joints.find((entry) => entry.joints === joints);
  const findProfile = (name) => options.profiles.find((profile) => profile.name === name);
  if (choice.name === "profile") {
    for (const profile of options.profiles) lacks.set(profile.name, networks(profile, profile.default_joints)?.installed === false);
  }
  if (choice.name === "joints") {
    const profile = findProfile(spec.profile ?? options.choices.find(({ name }) => name === "profile")?.default);
    for (const entry of profile?.joints ?? []) lacks.set(entry.joints, entry.installed === false);
  }
  return choice.values.filter(({ name }) => !lacks.get(name));
}

// Part of a spec that the form shows: values that can't be had here, such as a network that was removed since, are left out.
export function shownSpec(spec, options) {
  const shown = {};
  for (const choice of options.choices) {
    if (!(choice.name in spec)) continue;
    const names = offered(choice, { ...spec, ...shown }, options).map(({ name }) => name);
    const value = spec[choice.name];
    if (choice.kind === "several") shown[choice.name] = value.filter((name) => names.includes(name));
    else if (choice.kind !== "one" || names.includes(value)) shown[choice.name] = value;
  }
  return { ...shown, ...pickCharacter(spec) };
}

// Character of a spec, which is none of the listed choices.
export const pickCharacter = ({ character }) => (character ? { character } : {});

// Value that a choice has in a spec: the default if it is not set.
export const choiceValue = (choice, spec) => (choice.name in spec ? spec[choice.name] : choice.default);

// The form. `id` tells two forms of a page apart; `onChange(name, value)` gets undefined for the default.
// `hidden` names choices that stand elsewhere, and `valueNote(choice, value)` gives a further note of a value.
export function choicesForm({ id, options, spec, onChange, hidden = [], valueNote = () => null }) {
  if (!options) return html`<p class="quiet">${OPTIONS.loading}</p>`;
  const set = (choice, value) => onChange(choice.name, value);
  const draw = (choice) => FIELDS[choice.kind]?.({ id, choice, spec, options, valueNote, set: (value) => set(choice, value) }) ?? nothing;
  const groupChoices = (group) => options.choices.filter((choice) => choice.group === group && !hidden.includes(choice.name));
  const isOfPurpose = ({ name }) => findPurpose(options, spec) && name in options.purposes[0].spec;
  const changed = describeSpec(spec, { choices: FOLDED.flatMap(groupChoices).filter((choice) => !isOfPurpose(choice)) });
  return html`
    <div class="fields asked">${purposeField({ id, options, spec, onChange })}${ASKED.flatMap(groupChoices).map(draw)}</div>
    <details class="customise">
      <summary>${OPTIONS.customise}</summary>
      ${FOLDED.map((group) => html`<div class="group" data-group=${group}><h3>${OPTIONS.groups[group]}</h3>
        <div class="fields grid">${groupChoices(group).map(draw)}</div></div>`)}
    </details>
    ${changed.length ? html`<ul class="choices" aria-label=${OPTIONS.set}>${changed.map(({ label, value }) => html`<li class="chip" title="${label}: ${value}">${label}: ${value}</li>`)}</ul>` : nothing}`;
}

function tile({ id, choice, value, label, note, isChecked, onPick, type = "radio" }) {
  return html`<label class="tile">
    <input type=${type} name="${id}-${choice.name}" value=${value} .checked=${live(isChecked)} @change=${onPick}>
    <span class="tile-label">${label}</span>${note ? html`<span class="tile-note">${note}</span>` : nothing}
  </label>`;
}

const isSame = (one, other) => JSON.stringify(one) === JSON.stringify(other);

const findChoice = ({ choices }, wanted) => choices.find(({ name }) => name === wanted);

// Purpose whose choices a spec has; undefined if they are others.
function findPurpose(options, spec) {
  return options.purposes.find((purpose) => Object.entries(purpose.spec).every(([name, value]) => isSame(choiceValue(findChoice(options, name), spec), value)));
}

// Purposes of a take, each of which sets several choices at once; none is checked if they were set otherwise.
function purposeField({ id, options, spec, onChange }) {
  const chosen = findPurpose(options, spec);
  const pick = (purpose) => {
    for (const [name, value] of Object.entries(purpose.spec)) onChange(name, isSame(value, findChoice(options, name).default) ? undefined : value);
  };
  const tiles = options.purposes.map((purpose) => tile({
    id, choice: { name: "purpose" }, value: purpose.name, label: purpose.label,
    isChecked: purpose === chosen, onPick: () => pick(purpose),
  }));
  const setCharacter = (character) => onChange("character", character);
  return html`${frame({ name: "what-for", label: OPTIONS.purpose, description: chosen?.note ?? OPTIONS.purposeOwn }, tiles)}
    ${spec.character || chosen?.name === "character" ? characterField({ id, chosen: spec.character, set: setCharacter }) : nothing}`;
}

function frame(choice, content) {
  return html`<fieldset class="choice"><legend>${choice.label}</legend>${optionHelp(choice)}
    <p class="quiet">${prose(choice.description)}</p><div class="tiles">${content}</div></fieldset>`;
}

function numberField({ id, choice, value, onInput, isWhole, placeholder, inputId, least }) {
  return html`<input type="number" class="number" name="${id}-${choice.name}" id=${inputId ?? nothing} aria-describedby=${inputId ? `${inputId}-about` : nothing}
    step=${isWhole ? 1 : "any"} min=${least ?? choice.minimum ?? nothing} max=${choice.maximum ?? nothing}
    .value=${typed(value)} placeholder=${placeholder ?? ""} @input=${onInput}>`;
}

const optionHelp = ({ name, label }) => helpLink(`options#${name}`, label);

// A field with its label, what it means, and help beside the label. `input(id)` is the input of the label.
function field({ id, choice }, input) {
  const inputId = `${id}-${choice.name}`;
  return html`<div class="field"><span class="with-help"><label for=${inputId}>${choice.label}</label>${optionHelp(choice)}</span>
    ${input(inputId)}<span class="quiet" id="${inputId}-about">${prose(choice.description)}</span></div>`;
}

const numberIn = (event) => (event.target.value === "" ? undefined : event.target.valueAsNumber);

const FIELDS = {
  one({ id, choice, spec, options, valueNote, set }) {
    const values = offered(choice, spec, options);
    const chosen = choiceValue(choice, spec);
    const pick = (name) => set(name === choice.default ? undefined : name);
    if (ASKED.includes(choice.group)) {
      const note = values.find(({ name }) => name === chosen)?.note ?? "";
      return frame({ ...choice, description: `${choice.description} ${note}` }, values.map(({ name, label }) => tile({
        id, choice, value: name, label, note: valueNote(choice, name), isChecked: name === chosen, onPick: () => pick(name),
      })));
    }
    return field({ id, choice }, (inputId) => html`<select name=${inputId} id=${inputId} aria-describedby="${inputId}-about" @change=${(event) => pick(event.target.value)}>
      ${values.map(({ name, label }) => html`<option value=${name} .selected=${live(name === chosen)}>${label}</option>`)}</select>`);
  },
  several({ id, choice, spec, options, set }) {
    const chosen = new Set(choiceValue(choice, spec));
    const toggle = (name) => (event) => {
      if (event.target.checked) chosen.add(name); else chosen.delete(name);
      const list = choice.values.map((value) => value.name).filter((value) => chosen.has(value));
      set(isSame(list, choice.default) ? undefined : list);
    };
    return frame(choice, offered(choice, spec, options).map(({ name, label, note }) => tile({
      id, choice, value: name, label, note, isChecked: chosen.has(name), onPick: toggle(name), type: "checkbox",
    })));
  },
  whole_number({ id, choice, spec, set }) {
    const chosen = choiceValue(choice, spec);
    const pick = (value) => set(value === choice.default ? undefined : value);
    if (choice.group === "advanced" || choice.values.length === 0) return FIELDS.number({ id, choice, spec, set, isWhole: true });
    const few = Array.from({ length: FEW_PEOPLE }, (_, index) => (choice.minimum ?? 1) + index);
    const tiles = [...choice.values.map(({ name, label }) => [name, label]), ...few.map((number) => [number, number])];
    const isOther = typeof chosen === "number" && !few.includes(chosen);
    return frame(choice, [
      ...tiles.map(([value, label]) => tile({ id, choice, value, label, isChecked: value === chosen, onPick: () => pick(value) })),
      html`<label class="tile other"><span class="tile-label">${OPTIONS.more}</span>${numberField({
        id: `${id}-more`, choice, value: isOther ? chosen : "", isWhole: true, onInput: (event) => pick(numberIn(event) ?? choice.default),
      })}</label>`,
    ]);
  },
  flag({ id, choice, spec, set }) {
    const change = (event) => set(event.target.checked === choice.default ? undefined : event.target.checked);
    const inputId = `${id}-${choice.name}`;
    return html`<div class="field"><span class="with-help"><input type="checkbox" name=${inputId} id=${inputId} aria-describedby="${inputId}-about"
      .checked=${live(choiceValue(choice, spec))} @change=${change}><label for=${inputId}>${choice.label}</label>${optionHelp(choice)}</span>
      <span class="quiet" id="${inputId}-about">${prose(choice.description)}</span></div>`;
  },
  number({ id, choice, spec, set, isWhole = false }) {
    const named = choice.values.find(({ name }) => name === choice.default);
    return field({ id, choice }, (inputId) => numberField({
      id, choice, isWhole, inputId, value: typeof spec[choice.name] === "number" ? spec[choice.name] : "",
      placeholder: named?.label ?? choice.unset ?? choice.default, onInput: (event) => set(numberIn(event)),
    }));
  },
  frame_range({ id, choice, spec, set }) {
    const range = spec[choice.name] ?? [null, null];
    const bound = (index) => (event) => {
      const [first, stop] = range.map((end, place) => (place === index ? numberIn(event) ?? null : end));
      set(first === null && stop === null ? undefined : [first ?? 0, stop]);
    };
    return html`<fieldset class="field"><legend>${OPTIONS.range(choice.label, choice.unset)}</legend>${optionHelp(choice)}
      <div class="pair">${OPTIONS.rangeEnds.map((label, index) => html`<label><span>${label}</span>${numberField({
        id, choice, value: range[index], isWhole: true, onInput: bound(index), least: Math.max(choice.minimum ?? 0, index),
      })}</label>`)}</div><span class="quiet">${prose(choice.description)}</span></fieldset>`;
  },
};

// Character of one's own that moves as the people of a take: a stored one or a file, and its bones to correct.

const FINGER = /Hand(Thumb|Index|Middle|Ring|Pinky)/;
const FIGURE_PX = 220;

// The field of a form. `set(id)` gets undefined for no character.
function characterField({ id, chosen, set }) {
  const list = characters.list ?? [];
  const character = characters.opened.get(chosen);
  const choose = (value) => { set(value || undefined); characters.load({ character: value }); };
  const add = async (event) => {
    const [file] = event.target.files;
    event.target.value = "";
    const added = file && await characters.add(file);
    if (added) set(added.id);
  };
  return html`<fieldset class="choice character"><legend>${OPTIONS.character}</legend>${helpLink("own-character", OPTIONS.character)}
    <p class="quiet">${OPTIONS.characterHint}</p>
    <div class="pair">
      <label class="field"><span>${OPTIONS.characterStored}</span>
        <select name="${id}-character" @change=${(event) => choose(event.target.value)}>
          <option value="" .selected=${live(!chosen)}>${characters.list === null ? COMMON.loading : COMMON.none}</option>
          ${list.map(({ id: one, name }) => html`<option value=${one} .selected=${live(one === chosen)}>${name}</option>`)}
        </select></label>
      <label class="field"><span>${COMMON.fileOr}</span><input type="file" accept=".glb,.vrm,.fbx" ?disabled=${characters.reading !== null} @change=${add}></label>
    </div>
    ${characters.reading === null ? nothing : html`<p class="chosen" role="status"><b>${characters.reading}</b> <span class="quiet">${OPTIONS.characterReading}</span></p>`}
    ${problemBox(characters.problem)}
    ${character ? boneList(character, id) : nothing}
  </fieldset>`;
}

function boneList(character, id) {
  const isFinger = ({ joint }) => FINGER.test(joint);
  const missing = character.joints.filter(({ bone, joint }) => bone === null && !FINGER.test(joint)).map(({ joint }) => joint);
  const table = (joints) => html`<div class="bones">${joints.map((joint) => boneField(character, joint, id))}</div>`;
  return html`<p class="chosen"><b>${character.name}</b>
      <span class="quiet">${character.format} · ${size(character.num_bytes)} · ${COUNTS.bones(character.num_bones)}</span></p>
    <details .open=${characters.showsBones} @toggle=${(event) => { if (event.target === event.currentTarget) characters.showsBones = event.target.open; }}>
      <summary>${missing.length ? OPTIONS.bonesMissing(missing.join(", ")) : OPTIONS.bones}</summary>
      ${characters.showsBones ? html`
        <div class="figure-and-bones">${figure(character)}${table(character.joints.filter((joint) => !isFinger(joint)))}</div>
        <details><summary>${OPTIONS.fingers}</summary>${table(character.joints.filter(isFinger))}</details>
        ${character.at_rest.length ? html`<p class="quiet">${OPTIONS.atRest(character.at_rest.join(", "))}</p>` : nothing}` : nothing}
    </details>
    ${character.warnings.map(({ message }) => html`<p class="quiet">${message}</p>`)}`;
}

function boneField(character, { joint, bone, is_required: isRequired }, id) {
  return html`<label class="field"><span>${joint}</span>
    <select name="${id}-bone-${joint}" @change=${(event) => characters.correct(character, joint, event.target.value || null)}>
      ${isRequired ? nothing : html`<option value="" .selected=${live(bone === null)}>${OPTIONS.noBone}</option>`}
      ${character.skeleton.map(({ bone: name }) => html`<option value=${name} .selected=${live(name === bone)}>${name}</option>`)}
    </select></label>`;
}

// The bones from the front: those that move with a joint, and those at rest.
function figure({ skeleton, joints }) {
  const places = new Map(skeleton.map(({ bone, position: [x, , z] }) => [bone, [x, -z]]));
  const moved = new Set(joints.map(({ bone }) => bone));
  const [xs, ys] = [0, 1].map((axis) => [...places.values()].map((place) => place[axis]));
  const [left, top] = [Math.min(...xs), Math.min(...ys)];
  const scale = FIGURE_PX / Math.max(Math.max(...xs) - left, Math.max(...ys) - top, Number.MIN_VALUE);
  const at = (bone) => places.get(bone).map((value, axis) => 10 + (value - [left, top][axis]) * scale);
  const line = ({ bone, parent }) => {
    const [[x1, y1], [x2, y2]] = [at(parent), at(bone)];
    return svg`<line x1=${x1} y1=${y1} x2=${x2} y2=${y2} class=${moved.has(parent) ? "moved" : "at-rest"}></line>`;
  };
  return html`<svg class="figure" viewBox="0 0 ${FIGURE_PX + 20} ${FIGURE_PX + 20}" role="img" aria-label=${OPTIONS.figure}>
    ${skeleton.filter(({ parent }) => parent !== null).map(line)}
    ${skeleton.map(({ bone }) => svg`<circle cx=${at(bone)[0]} cy=${at(bone)[1]} r="2.5" class=${moved.has(bone) ? "moved" : "at-rest"}><title>${bone}</title></circle>`)}
  </svg>`;
}
