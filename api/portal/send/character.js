// Character of one's own that moves as the people of a take: a stored one or a file, and its bones to correct.

import { characters } from "../shared/characters.js";
import { count, size } from "../shared/format.js";
import { html, live, nothing, svg } from "../shared/lit.js";
import { problemBox } from "../shared/problem.js";

const FINGER = /Hand(Thumb|Index|Middle|Ring|Pinky)/;
const FIGURE_PX = 220;

// The field of a form. `set(id)` gets undefined for no character.
export function characterField({ id, chosen, set }) {
  const list = characters.list ?? [];
  const character = characters.opened.get(chosen);
  const choose = (value) => { set(value || undefined); characters.load({ character: value }); };
  const add = async (event) => {
    const [file] = event.target.files;
    event.target.value = "";
    const added = file && await characters.add(file);
    if (added) set(added.id);
  };
  return html`<fieldset class="choice character"><legend>Character</legend>
    <p class="quiet">A figure with a skeleton, from a GLB, VRM or FBX file. Its bones are recognised; each person moves it in a file of its own.</p>
    <div class="pair">
      <label class="field"><span>Stored character</span>
        <select name="${id}-character" @change=${(event) => choose(event.target.value)}>
          <option value="" .selected=${live(!chosen)}>${characters.list === null ? "Loading …" : "None"}</option>
          ${list.map(({ id: one, name }) => html`<option value=${one} .selected=${live(one === chosen)}>${name}</option>`)}
        </select></label>
      <label class="field"><span>Or a file</span><input type="file" accept=".glb,.vrm,.fbx" ?disabled=${characters.reading !== null} @change=${add}></label>
    </div>
    ${characters.reading === null ? nothing : html`<p class="chosen" role="status"><b>${characters.reading}</b> <span class="quiet">Reading the character …</span></p>`}
    ${problemBox(characters.problem)}
    ${character ? bonesOf(character, id) : nothing}
  </fieldset>`;
}

function bonesOf(character, id) {
  const isFinger = ({ joint }) => FINGER.test(joint);
  const missing = character.joints.filter(({ bone, joint }) => bone === null && !FINGER.test(joint)).map(({ joint }) => joint);
  const table = (joints) => html`<div class="bones">${joints.map((joint) => boneField(character, joint, id))}</div>`;
  return html`<p class="chosen"><b>${character.name}</b>
      <span class="quiet">${character.format} · ${size(character.num_bytes)} · ${count(character.num_bones, "bone")}</span></p>
    <details .open=${characters.showsBones} @toggle=${(event) => { if (event.target === event.currentTarget) characters.showsBones = event.target.open; }}>
      <summary>Bones${missing.length ? ` (without: ${missing.join(", ")})` : ""}</summary>
      ${characters.showsBones ? html`
        <div class="figure-and-bones">${figure(character)}${table(character.joints.filter((joint) => !isFinger(joint)))}</div>
        <details><summary>Fingers</summary>${table(character.joints.filter(isFinger))}</details>
        ${character.at_rest.length ? html`<p class="quiet">At rest: ${character.at_rest.join(", ")}.</p>` : nothing}` : nothing}
    </details>
    ${character.notes.map((note) => html`<p class="quiet">${note}</p>`)}`;
}

function boneField(character, { joint, bone, is_required: isRequired }, id) {
  return html`<label class="field"><span>${joint}</span>
    <select name="${id}-bone-${joint}" @change=${(event) => characters.correct(character, joint, event.target.value || null)}>
      ${isRequired ? nothing : html`<option value="" .selected=${live(bone === null)}>none</option>`}
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
  return html`<svg class="figure" viewBox="0 0 ${FIGURE_PX + 20} ${FIGURE_PX + 20}" role="img" aria-label="The character's bones from the front">
    ${skeleton.filter(({ parent }) => parent !== null).map(line)}
    ${skeleton.map(({ bone }) => svg`<circle cx=${at(bone)[0]} cy=${at(bone)[1]} r="2.5" class=${moved.has(bone) ? "moved" : "at-rest"}><title>${bone}</title></circle>`)}
  </svg>`;
}
