// Form that adds a calibration: from a file, from footage of a board, or from footage of people.

import { jsonPart, Problem } from "../shared/api.js";
import { announce } from "../shared/announce.js";
import { feed } from "../shared/feed.js";
import { size } from "../shared/format.js";
import { html, nothing } from "../shared/lit.js";
import { problemBox } from "../shared/problem.js";
import { ACCEPTED_CALIBRATIONS } from "../send/files.js";

const SOURCES = [["file", "A file"], ["board", "Footage of a board"], ["people", "Footage of people"]];

// fetch does not report the progress of an upload; XMLHttpRequest does.
function sendForm(path, form, onProgress) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.responseType = "json";
    request.upload.addEventListener("progress", ({ loaded, total }) => onProgress(loaded, total));
    request.addEventListener("load", () => {
      if (request.status < 300) resolve(request.response); else reject(new Problem(request.response, request.status));
    });
    request.addEventListener("error", () => reject(new Problem(null)));
    request.open("POST", path);
    request.send(form);
  });
}

function formOf({ source, title, board, file, footage, stature, intrinsics, units }) {
  const form = new FormData();
  const spec = { method: source.value };
  if (title.value.trim()) spec.name = title.value.trim();
  if (board) spec.board = board.value.trim();
  if (stature) spec.stature_m = stature.value.split(",").map(Number);
  if (units) spec.units = units.value;
  form.append("spec", jsonPart(spec));
  if (intrinsics?.files.length) form.append("intrinsics", intrinsics.files[0]);
  if (file) form.append("calibration", file.files[0]);
  for (const video of footage?.files ?? []) form.append("videos", video);
  return form;
}

export class AddForm {
  #source = "file";
  #problem = null;
  #text = "";
  #isBusy = false;

  constructor({ changed, draw }) {
    Object.assign(this, { changed, draw });
  }

  async #submit(event) {
    event.preventDefault();
    const form = event.target;
    this.#isBusy = true;
    this.#problem = null;
    try {
      const made = await sendForm("/v1/calibrations", formOf(form.elements), (loaded, total) => {
        this.#text = loaded < total ? `${size(loaded)} of ${size(total)} sent` : "Sent. Checking the files …";
        this.draw();
      });
      const isJob = made.kind === "calibration";
      if (isJob) feed.put(made);
      form.reset();
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

  #fileFields() {
    return html`<label class="field"><span>File</span><input name="file" type="file" accept=${ACCEPTED_CALIBRATIONS} required></label>
      <label class="field"><span>Unit of length, if the file does not state it</span><select name="units">
        <option value="m">metres</option><option value="cm">centimetres</option><option value="mm">millimetres</option></select></label>`;
  }

  #footageField() {
    return html`<label class="field"><span>Footage: one file a camera, synchronised</span><input name="footage" type="file" accept="video/*" multiple required></label>`;
  }

  #boardFields() {
    return html`${this.#footageField()}
      <label class="field"><span>Board</span><input name="board" required maxlength="100" placeholder="charuco:7x5:0.06:0.045:DICT_4X4_50" spellcheck="false" autocomplete="off" aria-describedby="board-help"></label>
      <p id="board-help" class="quiet">chessboard:COLSxROWS:SQUARE_M counts inner corners; charuco:COLSxROWS:SQUARE_M:MARKER_M:DICTIONARY counts squares. Begin with the board flat on the floor.</p>`;
  }

  #peopleFields() {
    return html`${this.#footageField()}
      <label class="field"><span>Stature of the people, metres</span><input name="stature" required maxlength="100" placeholder="1.78, 1.65" inputmode="decimal" pattern="\\s*[0-9.]+(\\s*,\\s*[0-9.]+)*\\s*" autocomplete="off" aria-describedby="people-help"></label>
      <label class="field"><span>Calibration whose lens values are kept, if there is one</span><input name="intrinsics" type="file" accept=${ACCEPTED_CALIBRATIONS}></label>
      <p id="people-help" class="quiet">Let one or two people walk about for a minute where several cameras see them whole. One stature is enough.</p>`;
  }

  form() {
    const fields = { file: () => this.#fileFields(), board: () => this.#boardFields(), people: () => this.#peopleFields() };
    return html`<form class="panel add" aria-labelledby="add-title" @submit=${(event) => this.#submit(event)}>
      <h2 id="add-title">Add a calibration</h2>
      <label class="field"><span>From</span><select name="source" @change=${(event) => { this.#source = event.target.value; this.draw(); }}>
        ${SOURCES.map(([value, label]) => html`<option value=${value} .selected=${value === this.#source}>${label}</option>`)}</select></label>
      <label class="field"><span>Title</span><input name="title" maxlength="200" placeholder="Studio B, March" autocomplete="off"></label>
      ${fields[this.#source]()}
      <div class="actions"><button class="button primary" ?disabled=${this.#isBusy}>Add</button></div>
      ${this.#text ? html`<p class="quiet" role="status">${this.#text}</p>` : nothing}
      ${problemBox(this.#problem)}
    </form>`;
  }
}
