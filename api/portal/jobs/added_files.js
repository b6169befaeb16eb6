// Form that adds files to a finished job: nothing is reconstructed again.

import { call } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { html, nothing, problemBox, selectField } from "../shared/lit.js";
import { announce } from "../shared/page.js";
import { characters } from "../shared/resources.js";
import { COMMON } from "../shared/strings/common.js";
import { ADDED } from "../shared/strings/take.js";

const OF_ALL_FILES = ["preset", "body", "timeline"];
const FLAGS = ["report", "overlay", "blur_faces"];

export class AddedFiles {
  problem = null;

  // `draw` shows the form again.
  constructor(draw) {
    this.draw = draw;
  }

  // The form for a job; `options` is what the service offers.
  form(job, options) {
    const choices = new Map(options.choices.map((choice) => [choice.name, choice]));
    const formats = choices.get("exports").values.filter(({ name }) => !job.spec.exports.includes(name));
    const flags = FLAGS.filter((name) => !job.spec[name]).map((name) => choices.get(name));
    return html`<details class="added" @toggle=${(event) => { if (event.target.open) characters.load({}).then(this.draw); }}>
      <summary>${ADDED.title}</summary>
      <form @submit=${(event) => this.#submit(event, job)}>
        <fieldset class="choice"><legend>${ADDED.formats}</legend><div class="tiles">
          ${formats.map(({ name, label }) => html`<label class="tile"><input type="checkbox" name="exports" value=${name}><span class="tile-label">${label}</span></label>`)}</div></fieldset>
        <div class="fields grid">
          ${OF_ALL_FILES.map((name) => this.#select(choices.get(name), job.spec[name]))}
          ${selectField(ADDED.character, [["", job.spec.character ? ADDED.sameCharacter : COMMON.none], ...(characters.list ?? []).map(({ id, name }) => [id, name])], { name: "character" })}
        </div>
        ${flags.length === 0 ? nothing : html`<fieldset class="choice"><legend>${ADDED.toShow}</legend><div class="tiles">
          ${flags.map(({ name, label }) => html`<label class="tile"><input type="checkbox" name=${name}><span class="tile-label">${label}</span></label>`)}</div></fieldset>`}
        <p class="quiet">${ADDED.hint}</p>
        ${problemBox(this.problem)}
        <div class="actions"><button class="button primary">${ADDED.submit}</button></div>
      </form></details>`;
  }

  #select({ name, label, values }, chosen) {
    return html`<label class="field"><span>${label}</span><select name=${name}>
      ${values.map((value) => html`<option value=${value.name} ?selected=${value.name === chosen}>${value.label}</option>`)}</select></label>`;
  }

  async #submit(event, job) {
    event.preventDefault();
    const fields = new FormData(event.target);
    const body = { exports: fields.getAll("exports") };
    for (const name of OF_ALL_FILES) if (fields.get(name) !== job.spec[name]) body[name] = fields.get(name);
    for (const name of FLAGS) if (fields.has(name)) body[name] = true;
    if (fields.get("character")) body.character = fields.get("character");
    try {
      feed.put(await call(job.urls.files, { method: "POST", body }));
      this.problem = null;
      announce(ADDED.said);
      event.target.closest("details").open = false;
    } catch (problem) {
      this.problem = problem;
    }
    this.draw();
  }
}
