// Fields of the people or the board that calibrate cameras.

import { html, nothing, selectField, svg, typed } from "../shared/lit.js";
import { CALIBRATIONS } from "../shared/strings/calibrations.js";
import { readStatures } from "./values.js";

const { add: ADD, board: BOARD_FIELDS } = CALIBRATIONS;

/** Field for the heights of people, which says how it reads them. `hintId` names a paragraph about it. */
export function statureField({ value = "", isOff = false, hintId = nothing, change = () => {} } = {}) {
  const read = ({ target }) => {
    const found = readStatures(target.value);
    target.setCustomValidity(found || !target.value ? "" : ADD.statureUnread);
    target.nextElementSibling.textContent = found ? ADD.statureRead(found.map((stature) => `${stature} m`).join(", ")) : "";
    change(target.value);
  };
  return html`<label class="field"><span>${ADD.stature}</span><input name="stature" required maxlength="100" placeholder=${ADD.staturePlaceholder}
    autocomplete="off" aria-describedby=${hintId} .value=${typed(value)} ?disabled=${isOff} @input=${read}><span class="quiet"></span></label>`;
}

const DICTIONARIES = ["4X4", "5X5", "6X6", "7X7"].flatMap((bits) => [50, 100, 250, 1000].map((size) => `DICT_${bits}_${size}`)).concat("DICT_ARUCO_ORIGINAL");
const MOST = 99; // numbers of squares that are drawn

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
export function boardFields(board, change) {
  const isChessboard = board.kind === "chessboard";
  const [across, down] = isChessboard ? BOARD_FIELDS.corners : BOARD_FIELDS.squares;
  const number = (name, label, { least, most, step = 1 }) => html`<label class="field"><span>${label}</span>
    <input type="number" name=${name} required min=${least} max=${most} step=${step} .value=${typed(board[name])}
      @input=${(event) => change({ [name]: event.target.valueAsNumber })}></label>`;
  const list = (name, label, pairs) => selectField(label, pairs, { name, chosen: board[name], choose: (value) => change({ [name]: value }) });
  return html`${list("kind", BOARD_FIELDS.kind, BOARD_FIELDS.kinds)}
    <div class="pair">${number("cols", across, { least: isChessboard ? 2 : 3, most: MOST })}
      ${number("rows", down, { least: isChessboard ? 2 : 3, most: MOST })}</div>
    <div class="pair">${number("square_mm", BOARD_FIELDS.square, { least: 2, most: 2000, step: "any" })}
      ${isChessboard ? nothing : number("marker_mm", BOARD_FIELDS.marker, { least: 1, most: 2000, step: "any" })}</div>
    ${isChessboard ? nothing : list("dictionary", BOARD_FIELDS.dictionary, DICTIONARIES.map((name) => [name, name]))}
    ${boardPicture(board)}
    <p class="quiet">${BOARD_FIELDS.hint}</p>`;
}
