// Form that adds a calibration: from a file, from footage of a board, or from footage of people.

import { ACCEPTED_CALIBRATIONS, AXES, makeRow } from "../send/files.js";
import { UploadQueue } from "../send/uploads.js";
import { call, jsonPart } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { size } from "../shared/format.js";
import { html, nothing, problemBox, selectField } from "../shared/lit.js";
import { address, announce } from "../shared/page.js";
import { CALIBRATIONS } from "../shared/strings/calibrations.js";
import { SEND } from "../shared/strings/send.js";
import { boardFields, statureField } from "./fields.js";
import { boardSpec, emptyBoard, readStatures } from "./values.js";

const { add: ADD } = CALIBRATIONS;
const MOST_SESSIONS = 100;

function calibrationSpec({ source, title, board, stature, units, up, session }) {
  return {
    method: source.value === "session" ? "people" : source.value,
    ...(title.value.trim() && { name: title.value.trim() }),
    ...(source.value === "board" && { board: boardSpec(board) }),
    ...(stature && { stature_m: readStatures(stature.value) }),
    ...(units?.value && { units: units.value }),
    ...(up?.value && { up: up.value }),
    ...(session && { session_id: session.value }),
  };
}

function fileForm(spec, file) {
  const form = new FormData();
  form.append("spec", jsonPart(spec));
  form.append("calibration", file, file.name);
  return form;
}

const uploadId = ({ url }) => url.slice(url.lastIndexOf("/") + 1);

export class AddForm {
  #source = "file";
  #problem = null;
  #text = "";
  #isBusy = false;
  #board = emptyBoard();
  #sessions = null; // captures whose people may serve, once they are asked for

  constructor({ changed, draw }) {
    Object.assign(this, { changed, draw });
  }

  // Footage goes by resumable uploads; a calibration file is small.
  async #send({ file, footage, intrinsics, ...fields }) {
    const spec = calibrationSpec(fields);
    if (file) return call("/v1/calibrations", { method: "POST", form: fileForm(spec, file.files[0]) });
    const files = [...(footage?.files ?? []), ...(intrinsics?.files ?? [])];
    const rows = files.map((file) => makeRow({ name: file.name, size: file.size, kind: "footage" }, file));
    const total = rows.reduce((sum, row) => sum + row.size, 0);
    const uploads = new UploadQueue(() => {
      this.#text = ADD.sent(size(rows.reduce((sum, row) => sum + row.sent, 0)), size(total));
      this.draw();
    });
    await uploads.send(() => rows);
    this.#text = ADD.checking;
    this.draw();
    const ids = rows.map(uploadId);
    const numVideos = footage?.files.length ?? 0;
    const body = { ...spec, ...(numVideos && { videos: ids.slice(0, numVideos) }), ...(ids[numVideos] && { intrinsics: ids[numVideos] }) };
    return call("/v1/calibrations", { method: "POST", body });
  }

  async #submit(event) {
    event.preventDefault();
    const form = event.target;
    if (this.#isBusy) return;
    this.#isBusy = true;
    this.#problem = null;
    this.draw();
    try {
      const { source, title, file, footage, stature, intrinsics, units, up, session } = form.elements;
      const made = await this.#send({ source, title, board: this.#board, file, footage, stature, intrinsics, units, up, session });
      const isJob = made.kind === "calibration";
      if (isJob) feed.put(made);
      form.reset();
      this.#board = emptyBoard();
      this.#source = "file";
      this.#text = isJob ? ADD.running : ADD.added;
      announce(this.#text);
      this.changed();
    } catch (problem) {
      this.#text = "";
      this.#problem = problem;
    }
    this.#isBusy = false;
    this.draw();
  }

  async #choose(source) {
    this.#source = source;
    this.draw();
    if (source !== "session" || this.#sessions !== null) return;
    try {
      this.#sessions = (await call(`/v1/sessions?limit=${MOST_SESSIONS}`)).sessions;
    } catch (problem) {
      this.#problem = problem;
    }
    this.draw();
  }

  #fileFields() {
    return html`<label class="field"><span>${ADD.file}</span><input name="file" type="file" accept=${ACCEPTED_CALIBRATIONS} required></label>
      ${selectField(SEND.calibration.unit, SEND.calibration.units, { name: "units" })}${selectField(SEND.calibration.up, AXES, { name: "up" })}`;
  }

  #footageField() {
    return html`<label class="field"><span>${ADD.footage}</span><input name="footage" type="file" accept="video/*" multiple required aria-describedby="footage-help"></label>
      <p id="footage-help" class="quiet">${ADD.footageHint}</p>`;
  }

  #boardFields() {
    const change = (facts) => {
      Object.assign(this.#board, facts);
      this.draw();
    };
    return html`${this.#footageField()}${boardFields(this.#board, change)}`;
  }

  #peopleFields() {
    return html`${this.#footageField()}${statureField({ hintId: "people-help" })}
      <label class="field"><span>${ADD.intrinsics}</span><input name="intrinsics" type="file" accept=${ACCEPTED_CALIBRATIONS} aria-describedby="intrinsics-help"></label>
      <p id="intrinsics-help" class="quiet">${ADD.intrinsicsHint}</p>
      <p id="people-help" class="quiet">${ADD.peopleHint}</p>`;
  }

  #sessionFields() {
    return html`<label class="field"><span>${ADD.session}</span><select name="session" required>
        ${(this.#sessions ?? []).map(({ id, name }) => html`<option value=${id}>${name}</option>`)}</select></label>
      ${statureField({ hintId: "people-help" })}
      <p id="people-help" class="quiet">${ADD.sessionHint}</p>`;
  }

  form() {
    const fields = { file: () => this.#fileFields(), board: () => this.#boardFields(), people: () => this.#peopleFields(), session: () => this.#sessionFields() };
    const isScene = this.#source === "scene";
    return html`<form class="panel add" aria-labelledby="add-title" @submit=${(event) => this.#submit(event)}>
      <h2 id="add-title">${ADD.title}</h2>
      ${selectField(ADD.from, ADD.sources, { name: "source", chosen: this.#source, choose: (source) => this.#choose(source) })}
      ${isScene ? html`<p class="quiet">${ADD.sceneHint}</p><div class="actions"><a class="button primary" href=${address("scene")}>${ADD.scene}</a></div>` : html`
        <label class="field"><span>${ADD.name}</span><input name="title" maxlength="200" placeholder=${ADD.namePlaceholder} autocomplete="off"></label>
        ${fields[this.#source]()}
        <div class="actions"><button class="button primary" aria-disabled=${this.#isBusy ? "true" : nothing}>${ADD.submit}</button></div>`}
      ${this.#text ? html`<p class="quiet" role="status">${this.#text}</p>` : nothing}
      ${problemBox(this.#problem)}
    </form>`;
  }
}
