// Page of the board: full screen, sized by a bank card that is laid on the screen, or printed.

import { html, nothing, render, svg, typed } from "../../shared/lit.js";
import { FRAME } from "../../shared/strings/frame.js";
import { BOARD } from "../../shared/strings/phone.js";
import { blackParts, boardName, COLS, keepBoard, ROWS, shownBoard } from "./charuco.js";

const CARD_MM = [85.6, 53.98]; // ISO/IEC 7810 ID-1
const KEY = "multicap.px_per_mm";
const [USUAL_PX_PER_MM, MIN_PX_PER_MM, MAX_PX_PER_MM] = [3.78, 2, 12];
const MARGIN = 0.5; // white around the board, in squares
const PAPERS = { a4: { name: "A4", squareMm: 36 }, a3: { name: "A3", squareMm: 52 } };
const RULER_MM = 100;

const place = document.getElementById("board");
let pxPerMm = readScale();
let isShown = false;
let paper = "a4";

function readScale() {
  const kept = Number(localStorage.getItem(KEY));
  return kept >= MIN_PX_PER_MM && kept <= MAX_PX_PER_MM ? kept : USUAL_PX_PER_MM;
}

const picture = (width, height, label) => html`<svg width=${width} height=${height} viewBox="${-MARGIN} ${-MARGIN} ${COLS + 2 * MARGIN} ${ROWS + 2 * MARGIN}" role="img" aria-label=${label} shape-rendering="crispEdges">
  <rect class="paper" x=${-MARGIN} y=${-MARGIN} width=${COLS + 2 * MARGIN} height=${ROWS + 2 * MARGIN}></rect>
  ${blackParts().map(([x, y, width, height]) => svg`<rect class="ink" x=${x} y=${y} width=${width} height=${height}></rect>`)}</svg>`;

// Whole pixels of the screen a square, so that its edges are sharp.
function squarePx() {
  const across = (isShown ? innerWidth : innerWidth - 40) / (COLS + 2 * MARGIN);
  const down = (isShown ? innerHeight : innerHeight / 2) / (ROWS + 2 * MARGIN);
  return Math.max(1, Math.floor(Math.min(across, down) * devicePixelRatio)) / devicePixelRatio;
}

function rescale(event) {
  pxPerMm = event.target.valueAsNumber;
  localStorage.setItem(KEY, String(pxPerMm));
  draw();
}

async function show() {
  isShown = true;
  draw();
  await document.documentElement.requestFullscreen?.().catch(() => null);
  await navigator.wakeLock?.request("screen").catch(() => null);
  draw();
}

function hide() {
  if (!isShown) return;
  isShown = false;
  if (document.fullscreenElement) document.exitFullscreen().catch(() => null);
  draw();
}

function print(name) {
  paper = name;
  keepBoard(boardName(PAPERS[name].squareMm));
  draw();
  globalThis.print();
}

function printed() {
  const { name, squareMm } = PAPERS[paper];
  const [width, height] = [COLS, ROWS].map((count) => `${(count + 2 * MARGIN) * squareMm}mm`);
  return html`<div class="board-print ${paper}" aria-hidden="true">${picture(width, height, BOARD.ofPaper(name))}
    <p><svg width="${RULER_MM}mm" height="4mm" viewBox="0 0 ${RULER_MM} 4"><path class="rule" d="M0 0v4M${RULER_MM} 0v4M0 2H${RULER_MM}"></path></svg>
      ${BOARD.rule(RULER_MM, boardName(squareMm))}</p></div>`;
}

function draw() {
  const side = squarePx();
  const squareMm = side / pxPerMm;
  const name = boardName(squareMm);
  const shown = picture((COLS + 2 * MARGIN) * side, (ROWS + 2 * MARGIN) * side, BOARD.ofSquares(COLS, ROWS));
  if (isShown) keepBoard(name);
  document.body.classList.toggle("board-shown", isShown);
  const [cardWidth, cardHeight] = CARD_MM.map((side) => side * pxPerMm);
  render(isShown ? html`<div class="board-full" @click=${hide}>${shown}</div>` : html`
    <h1 class="title">${BOARD.title}</h1>
    <section class="panel" aria-labelledby="screen-title"><h2 id="screen-title">${BOARD.screen}</h2>
      <p>${BOARD.screenSteps}</p>
      <label class="field"><span>${BOARD.size}</span><input type="range" min=${MIN_PX_PER_MM} max=${MAX_PX_PER_MM} step="0.005" .value=${typed(pxPerMm)} @input=${rescale}></label>
      <svg class="board-card" width=${cardWidth} height=${cardHeight} role="img" aria-label=${BOARD.frame}><rect x="1" y="1" width=${cardWidth - 2} height=${cardHeight - 2} rx=${3 * pxPerMm}></rect></svg>
      <p class="quiet">${BOARD.screenHint}</p>
      <div class="actions"><button type="button" class="button primary" @click=${show}>${BOARD.show}</button></div>
      ${shownBoard() ? html`<p>${BOARD.last} <code class="board-name">${shownBoard()}</code></p>` : nothing}</section>
    <section class="panel" aria-labelledby="print-title"><h2 id="print-title">${BOARD.paper}</h2>
      <p>${BOARD.paperSteps}</p>
      <div class="actions">${Object.entries(PAPERS).map(([key, { name: label, squareMm: mm }]) => html`<button type="button" class="button" @click=${() => print(key)}>${BOARD.print(label, mm)}</button>`)}</div></section>
    ${printed()}`, place);
}

addEventListener("resize", draw);
document.addEventListener("fullscreenchange", () => { if (!document.fullscreenElement) hide(); });
addEventListener("keydown", ({ key }) => { if (key === "Escape") hide(); });
place.replaceChildren();
document.title = FRAME.title(BOARD.title);
draw();
