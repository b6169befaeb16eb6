// Form that adds a calibration: from a file, from footage of a board, or from footage of people.

import { ACCEPTED_CALIBRATIONS, AXES, makeRow } from "../send/files.js";
import { UploadQueue } from "../send/uploads.js";
import { call, jsonPart } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { size } from "../shared/format.js";
import { html, live, nothing, problemBox, svg, typed } from "../shared/lit.js";
import { announce } from "../shared/page.js";
import { CALIBRATIONS } from "../shared/strings/calibrations.js";
import { SEND } from "../shared/strings/send.js";

const { add: ADD, board: BOARD_FIELDS } = CALIBRATIONS;
const MOST_SESSIONS = 100;

function calibrationSpec({ source, title, board, stature, units, up, session }) {
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
      <label class="field"><span>${SEND.calibration.unit}</span><select name="units">
        ${SEND.calibration.units.map(([unit, label]) => html`<option value=${unit}>${label}</option>`)}</select></label>
      <label class="field"><span>${SEND.calibration.up}</span><select name="up">${AXES.map(([axis, label]) => html`<option value=${axis}>${label}</option>`)}</select></label>`;
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

  #statureField() {
    return html`<label class="field"><span>${ADD.stature}</span><input name="stature" required maxlength="100" placeholder="1.78, 1.65" inputmode="decimal" pattern="\\s*[0-9.]+(\\s*,\\s*[0-9.]+)*\\s*" autocomplete="off" aria-describedby="people-help"></label>`;
  }

  #peopleFields() {
    return html`${this.#footageField()}${this.#statureField()}
      <label class="field"><span>${ADD.intrinsics}</span><input name="intrinsics" type="file" accept=${ACCEPTED_CALIBRATIONS} aria-describedby="intrinsics-help"></label>
      <p id="intrinsics-help" class="quiet">${ADD.intrinsicsHint}</p>
      <p id="people-help" class="quiet">${ADD.peopleHint}</p>`;
  }

  #sessionFields() {
    return html`<label class="field"><span>${ADD.session}</span><select name="session" required>
        ${(this.#sessions ?? []).map(({ id, name }) => html`<option value=${id}>${name}</option>`)}</select></label>
      ${this.#statureField()}
      <p id="people-help" class="quiet">${ADD.sessionHint}</p>`;
  }

  form() {
    const fields = { file: () => this.#fileFields(), board: () => this.#boardFields(), people: () => this.#peopleFields(), session: () => this.#sessionFields() };
    return html`<form class="panel add" aria-labelledby="add-title" @submit=${(event) => this.#submit(event)}>
      <h2 id="add-title">${ADD.title}</h2>
      <label class="field"><span>${ADD.from}</span><select name="source" @change=${(event) => this.#choose(event.target.value)}>
        ${ADD.sources.map(([value, label]) => html`<option value=${value} .selected=${value === this.#source}>${label}</option>`)}</select></label>
      <label class="field"><span>${ADD.name}</span><input name="title" maxlength="200" placeholder=${ADD.namePlaceholder} autocomplete="off"></label>
      ${fields[this.#source]()}
      <div class="actions"><button class="button primary" aria-disabled=${this.#isBusy ? "true" : nothing}>${ADD.submit}</button></div>
      ${this.#text ? html`<p class="quiet" role="status">${this.#text}</p>` : nothing}
      ${problemBox(this.#problem)}
    </form>`;
  }
}

// Fields that describe a board, and a picture of it.

const DICTIONARIES = ["4X4", "5X5", "6X6", "7X7"].flatMap((bits) => [50, 100, 250, 1000].map((size) => `DICT_${bits}_${size}`)).concat("DICT_ARUCO_ORIGINAL");
const MOST = 99; // numbers of squares that are drawn

const emptyBoard = () => ({ kind: "charuco", cols: 7, rows: 5, square_mm: 60, marker_mm: 45, dictionary: "DICT_4X4_50" });

const metres = (millimetres) => Number((millimetres / 1000).toPrecision(9));

// Specification of the board for the service.
function boardSpec({ kind, cols, rows, square_mm: square, marker_mm: marker, dictionary }) {
  const spec = `${kind}:${cols}x${rows}:${metres(square)}`;
  return kind === "charuco" ? `${spec}:${metres(marker)}:${dictionary}` : spec;
}

// Numbers of squares along the width and the height; a chessboard is described by its inner corners.
const countSquares = ({ kind, cols, rows }) => (kind === "chessboard" ? [cols + 1, rows + 1] : [cols, rows]);

function marker(x, y, share) {
  const margin = (1 - share) / 2;
  return svg`<rect class="ink" x=${x + margin} y=${y + margin} width=${share} height=${share} />
    <rect class="paper" x=${x + 0.5 - share / 4} y=${y + 0.5 - share / 4} width=${share / 4} height=${share / 4} />`;
}

// Picture of a board, black squares at its first corner; nothing while its fields make no board.
function boardPicture(board) {
  const [across, down] = countSquares(board);
  const { kind, square_mm: square, marker_mm: side } = board;
  if (![across, down].every((count) => Number.isInteger(count) && count >= 2 && count <= MOST) || !(square > 0)) return nothing;
  const cells = Array.from({ length: across * down }, (_, number) => [number % across, Math.floor(number / across)]);
  const share = side > 0 && side < square ? side / square : 0;
  const text = BOARD_FIELDS.size(across, down, Number((across * square).toPrecision(6)), Number((down * square).toPrecision(6)));
  const corners = kind === "chessboard" ? cells.filter(([x, y]) => x > 0 && y > 0) : [];
  return html`<figure class="board"><svg viewBox="-0.5 -0.5 ${across + 1} ${down + 1}" role="img" aria-label=${BOARD_FIELDS.picture(text)}>
    <rect class="paper" x="-0.5" y="-0.5" width=${across + 1} height=${down + 1} />
    ${cells.map(([x, y]) => ((x + y) % 2 === 0 ? svg`<rect class="ink" x=${x} y=${y} width="1" height="1" />` : kind === "charuco" && share ? marker(x, y, share) : nothing))}
    ${corners.map(([x, y]) => svg`<circle class="corner" cx=${x} cy=${y} r="0.13" />`)}
  </svg><figcaption class="quiet">${corners.length ? BOARD_FIELDS.caption(text, board.cols, board.rows) : BOARD_FIELDS.caption(text)}</figcaption></figure>`;
}

// `change(facts)` gets the changed fields.
function boardFields(board, change) {
  const isChessboard = board.kind === "chessboard";
  const [across, down] = isChessboard ? BOARD_FIELDS.corners : BOARD_FIELDS.squares;
  const number = (name, label, { least, most, step = 1 }) => html`<label class="field"><span>${label}</span>
    <input type="number" name=${name} required min=${least} max=${most} step=${step} .value=${typed(board[name])}
      @input=${(event) => change({ [name]: event.target.valueAsNumber })}></label>`;
  return html`<label class="field"><span>${BOARD_FIELDS.kind}</span><select name="kind" @change=${(event) => change({ kind: event.target.value })}>
      ${BOARD_FIELDS.kinds.map(([kind, label]) => html`<option value=${kind} .selected=${live(kind === board.kind)}>${label}</option>`)}</select></label>
    <div class="pair">${number("cols", across, { least: isChessboard ? 2 : 3, most: MOST })}
      ${number("rows", down, { least: isChessboard ? 2 : 3, most: MOST })}</div>
    <div class="pair">${number("square_mm", BOARD_FIELDS.square, { least: 2, most: 2000, step: "any" })}
      ${isChessboard ? nothing : number("marker_mm", BOARD_FIELDS.marker, { least: 1, most: 2000, step: "any" })}</div>
    ${isChessboard ? nothing : html`<label class="field"><span>${BOARD_FIELDS.dictionary}</span><select name="dictionary" @change=${(event) => change({ dictionary: event.target.value })}>
      ${DICTIONARIES.map((name) => html`<option .selected=${live(name === board.dictionary)}>${name}</option>`)}</select></label>`}
    ${boardPicture(board)}
    <p class="quiet">${BOARD_FIELDS.hint}</p>`;
}
