// ChArUco board of 7 x 5 squares, as OpenCV draws it: what is black, and how a board of a size is named.

export const [COLS, ROWS] = [7, 5];
const MARKER_SHARE = 0.75; // of a square's side
const BITS = 4;
const CELLS = BITS + 2; // with the black border
// Markers of OpenCV's DICT_4X4_50 by their ids: their bits row by row, 1 is white.
const MARKERS = [
  0xb532, 0x0f9a, 0x332d, 0x9946, 0x549e, 0x79cd, 0x9e2e, 0xc4f2, 0xfeda, 0xcf56, 0xf991, 0x11a7, 0x0eb7, 0x2a0f, 0x24b1, 0x263e, 0x4665,
];
const KEY = "multicap.board";

/** Black rectangles `[x, y, width, height]` of the board; its squares have sides of 1. */
export function blackParts() {
  const parts = [];
  let marker = 0;
  for (let y = 0; y < ROWS; y++) {
    for (let x = 0; x < COLS; x++) {
      if ((x + y) % 2 === 0) parts.push([x, y, 1, 1]);
      else parts.push(...markerParts(MARKERS[marker++], x + (1 - MARKER_SHARE) / 2, y + (1 - MARKER_SHARE) / 2));
    }
  }
  return parts;
}

// Runs of black cells of a marker, row by row: few rectangles have few edges between them.
function markerParts(bits, left, top) {
  const side = MARKER_SHARE / CELLS;
  const isWhite = (column, row) => column > 0 && column <= BITS && row > 0 && row <= BITS && ((bits >> (BITS * BITS - 1 - (BITS * (row - 1) + column - 1))) & 1) === 1;
  const parts = [];
  for (let row = 0; row < CELLS; row++) {
    for (let column = 0; column < CELLS;) {
      let end = column;
      while (end < CELLS && !isWhite(end, row)) end += 1;
      if (end > column) parts.push([left + column * side, top + row * side, (end - column) * side, side]);
      column = end + 1;
    }
  }
  return parts;
}

const metres = (millimetres) => Number((millimetres / 1000).toFixed(5));

/** Name of the board with squares of a side, as the service takes it. */
export const boardName = (squareMm) => `charuco:${COLS}x${ROWS}:${metres(squareMm)}:${metres(MARKER_SHARE * squareMm)}:DICT_4X4_50`;

/** Keep the name of the board that this browser shows, for the form that asks for it. */
export function keepBoard(name) {
  try {
    localStorage.setItem(KEY, name);
  } catch { /* storage is off: the name is typed */ }
}

/** Board that this browser showed last; empty if none. */
export function shownBoard() {
  try {
    return localStorage.getItem(KEY) ?? "";
  } catch {
    return "";
  }
}
