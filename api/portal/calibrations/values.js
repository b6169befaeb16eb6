// Values of the fields of people and boards, as the service takes them.

// Metres or centimetres, with a decimal point or comma. A comma between numbers separates them.
const STATURE = /([0-2](?:[.,]\d{1,3})?(?!\d)|\d{2,3}(?:[.,]\d(?!\d))?)\s*(cm|m)?/gi;
const [MIN_STATURE_M, MAX_STATURE_M] = [0.5, 2.6];

/** Heights in metres of a text such as "178", "1,78 m; 165 cm"; null if it is none. */
export function readStatures(text) {
  const found = [...text.matchAll(STATURE)].map(([, number, unit]) => {
    const value = Number(number.replace(",", "."));
    return unit?.toLowerCase() === "cm" || (!unit && value > MAX_STATURE_M) ? Number((value / 100).toFixed(4)) : value;
  });
  const isRest = /^[\s,;]*$/.test(text.replace(STATURE, ""));
  return isRest && found.length && found.every((stature) => stature >= MIN_STATURE_M && stature <= MAX_STATURE_M) ? found : null;
}

export const emptyBoard = () => ({ kind: "charuco", cols: 7, rows: 5, square_mm: 60, marker_mm: 45, dictionary: "DICT_4X4_50" });

const metres = (millimetres) => Number((millimetres / 1000).toPrecision(9));

// Specification of the board for the service.
export function boardSpec({ kind, cols, rows, square_mm: square, marker_mm: marker, dictionary }) {
  const spec = `${kind}:${cols}x${rows}:${metres(square)}`;
  return kind === "charuco" ? `${spec}:${metres(marker)}:${dictionary}` : spec;
}
