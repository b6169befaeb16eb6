// Form that adds a calibration: from a file, from footage of a board, or from footage of people.

import { call, jsonPart } from "../shared/api.js";
import { announce } from "../shared/announce.js";
import { feed } from "../shared/feed.js";
import { size } from "../shared/format.js";
import { html, nothing } from "../shared/lit.js";
import { problemBox } from "../shared/problem.js";
import { rowOf } from "../send/draft.js";
import { ACCEPTED_CALIBRATIONS, AXES } from "../send/files.js";
import { UploadQueue } from "../send/uploads.js";
import { boardFields, boardSpec, emptyBoard } from "./board.js";

const SOURCES = [["file", "A file"], ["board", "Footage of a board"], ["people", "Footage of people"], ["session", "People of a capture"]];
const MOST_SESSIONS = 100;

function specOf({ source, title, board, stature, units, up, session }) {
  return {
    method: source.value === "session" ? "people" : source.value,
    ...(title.value.trim() && { name: title.value.trim() }),
    ...(source.value === "board" && { board: boardSpec(board) }),
    ...(stature && { stature_m: stature.value.split(",").map(Number) }),
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

const idOf = ({ url }) => url.slice(url.lastIndexOf("/") + 1);

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
    const spec = specOf(fields);
    if (file) return call("/v1/calibrations", { method: "POST", form: fileForm(spec, file.files[0]) });
    const files = [...(footage?.files ?? []), ...(intrinsics?.files ?? [])];
    const rows = files.map((file) => rowOf({ name: file.name, size: file.size, kind: "footage" }, file));
    const total = rows.reduce((sum, row) => sum + row.size, 0);
    const uploads = new UploadQueue(() => {
      this.#text = `${size(rows.reduce((sum, row) => sum + row.sent, 0))} of ${size(total)} sent`;
      this.draw();
    });
    await uploads.send(() => rows);
    this.#text = "Sent. Checking the files …";
    this.draw();
    const ids = rows.map(idOf);
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
      this.#text = isJob ? "The calibration is being made." : "Added.";
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
    return html`<label class="field"><span>File</span><input name="file" type="file" accept=${ACCEPTED_CALIBRATIONS} required></label>
      <label class="field"><span>Unit of length</span><select name="units">
        <option value="">as the file states, or metres</option><option value="m">metres</option><option value="cm">centimetres</option><option value="mm">millimetres</option></select></label>
      <label class="field"><span>Axis that points up</span><select name="up">${AXES.map(([axis, label]) => html`<option value=${axis}>${label}</option>`)}</select></label>`;
  }

  #footageField() {
    return html`<label class="field"><span>Footage: one file a camera, synchronised</span><input name="footage" type="file" accept="video/*" multiple required></label>`;
  }

  #boardFields() {
    const change = (facts) => {
      Object.assign(this.#board, facts);
      this.draw();
    };
    return html`${this.#footageField()}${boardFields(this.#board, change)}`;
  }

  #statureField() {
    return html`<label class="field"><span>Stature of the people, metres</span><input name="stature" required maxlength="100" placeholder="1.78, 1.65" inputmode="decimal" pattern="\\s*[0-9.]+(\\s*,\\s*[0-9.]+)*\\s*" autocomplete="off" aria-describedby="people-help"></label>`;
  }

  #peopleFields() {
    return html`${this.#footageField()}${this.#statureField()}
      <label class="field"><span>Calibration whose lens values are kept, if there is one</span><input name="intrinsics" type="file" accept=${ACCEPTED_CALIBRATIONS}></label>
      <p id="people-help" class="quiet">Let one or two people walk about for a minute where several cameras see them whole. One stature is enough.</p>`;
  }

  #sessionFields() {
    return html`<label class="field"><span>Capture</span><select name="session" required>
        ${(this.#sessions ?? []).map(({ id, name }) => html`<option value=${id}>${name}</option>`)}</select></label>
      ${this.#statureField()}
      <p id="people-help" class="quiet">The cameras are placed anew from the people of the capture, and keep their lens values.</p>`;
  }

  form() {
    const fields = { file: () => this.#fileFields(), board: () => this.#boardFields(), people: () => this.#peopleFields(), session: () => this.#sessionFields() };
    return html`<form class="panel add" aria-labelledby="add-title" @submit=${(event) => this.#submit(event)}>
      <h2 id="add-title">Add a calibration</h2>
      <label class="field"><span>From</span><select name="source" @change=${(event) => this.#choose(event.target.value)}>
        ${SOURCES.map(([value, label]) => html`<option value=${value} .selected=${value === this.#source}>${label}</option>`)}</select></label>
      <label class="field"><span>Title</span><input name="title" maxlength="200" placeholder="Studio B, March" autocomplete="off"></label>
      ${fields[this.#source]()}
      <div class="actions"><button class="button primary" aria-disabled=${this.#isBusy ? "true" : nothing}>Add</button></div>
      ${this.#text ? html`<p class="quiet" role="status">${this.#text}</p>` : nothing}
      ${problemBox(this.#problem)}
    </form>`;
  }
}
