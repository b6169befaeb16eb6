// Fields that describe a board, and a picture of it.

import { html, live, nothing, svg, typed } from "../shared/lit.js";

const KINDS = [["charuco", "ChArUco board, with markers"], ["chessboard", "Chessboard"]];
const DICTIONARIES = ["4X4", "5X5", "6X6", "7X7"].flatMap((bits) => [50, 100, 250, 1000].map((size) => `DICT_${bits}_${size}`)).concat("DICT_ARUCO_ORIGINAL");
const MOST = 99; // numbers of squares that are drawn

export const emptyBoard = () => ({ kind: "charuco", cols: 7, rows: 5, square_mm: 60, marker_mm: 45, dictionary: "DICT_4X4_50" });

const metres = (millimetres) => Number((millimetres / 1000).toPrecision(9));

// Specification of the board for the service.
export function boardSpec({ kind, cols, rows, square_mm: square, marker_mm: marker, dictionary }) {
  const spec = `${kind}:${cols}x${rows}:${metres(square)}`;
  return kind === "charuco" ? `${spec}:${metres(marker)}:${dictionary}` : spec;
}

// Numbers of squares along the width and the height; a chessboard is described by its inner corners.
const squaresOf = ({ kind, cols, rows }) => (kind === "chessboard" ? [cols + 1, rows + 1] : [cols, rows]);

function marker(x, y, share) {
  const margin = (1 - share) / 2;
  return svg`<rect class="ink" x=${x + margin} y=${y + margin} width=${share} height=${share} />
    <rect class="paper" x=${x + 0.5 - share / 4} y=${y + 0.5 - share / 4} width=${share / 4} height=${share / 4} />`;
}

// Picture of a board, black squares at its first corner; nothing while its fields make no board.
export function boardPicture(board) {
  const [across, down] = squaresOf(board);
  const { kind, square_mm: square, marker_mm: side } = board;
  if (![across, down].every((count) => Number.isInteger(count) && count >= 2 && count <= MOST) || !(square > 0)) return nothing;
  const cells = Array.from({ length: across * down }, (_, number) => [number % across, Math.floor(number / across)]);
  const share = side > 0 && side < square ? side / square : 0;
  const text = `${across} x ${down} squares, ${Number((across * square).toPrecision(6))} x ${Number((down * square).toPrecision(6))} mm`;
  const corners = kind === "chessboard" ? cells.filter(([x, y]) => x > 0 && y > 0) : [];
  return html`<figure class="board"><svg viewBox="-0.5 -0.5 ${across + 1} ${down + 1}" role="img" aria-label=${`Picture of the board: ${text}`}>
    <rect class="paper" x="-0.5" y="-0.5" width=${across + 1} height=${down + 1} />
    ${cells.map(([x, y]) => ((x + y) % 2 === 0 ? svg`<rect class="ink" x=${x} y=${y} width="1" height="1" />` : kind === "charuco" && share ? marker(x, y, share) : nothing))}
    ${corners.map(([x, y]) => svg`<circle class="corner" cx=${x} cy=${y} r="0.13" />`)}
  </svg><figcaption class="quiet">${text}${corners.length ? `; ${board.cols} x ${board.rows} inner corners, as marked` : ""}. Compare it with your print.</figcaption></figure>`;
}

// `change(facts)` gets the fields that somebody changes.
export function boardFields(board, change) {
  const isChessboard = board.kind === "chessboard";
  const counted = isChessboard ? "Inner corners" : "Squares";
  const number = (name, label, { least, most, step = 1 }) => html`<label class="field"><span>${label}</span>
    <input type="number" name=${name} required min=${least} max=${most} step=${step} .value=${typed(board[name])}
      @input=${(event) => change({ [name]: event.target.valueAsNumber })}></label>`;
  return html`<label class="field"><span>Kind of board</span><select name="kind" @change=${(event) => change({ kind: event.target.value })}>
      ${KINDS.map(([kind, label]) => html`<option value=${kind} .selected=${live(kind === board.kind)}>${label}</option>`)}</select></label>
    <div class="pair">${number("cols", `${counted} along the width`, { least: isChessboard ? 2 : 3, most: MOST })}
      ${number("rows", `${counted} along the height`, { least: isChessboard ? 2 : 3, most: MOST })}</div>
    <div class="pair">${number("square_mm", "Side of a square, mm", { least: 2, most: 2000, step: "any" })}
      ${isChessboard ? nothing : number("marker_mm", "Side of a marker, mm", { least: 1, most: 2000, step: "any" })}</div>
    ${isChessboard ? nothing : html`<label class="field"><span>Dictionary of the markers</span><select name="dictionary" @change=${(event) => change({ dictionary: event.target.value })}>
      ${DICTIONARIES.map((name) => html`<option .selected=${live(name === board.dictionary)}>${name}</option>`)}</select></label>`}
    ${boardPicture(board)}
    <p class="quiet">Measure a square of the print: printers scale. Begin with the board flat on the floor.</p>`;
}
