// Measured clocks: the offset of each camera, and how well other offsets would fit.

import { html, render, svg } from "../../shared/lit.js";
import { el, figure } from "../dom.js";

const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM] = [420, 150, 44, 10, 10, 26];

/** Panel of the clocks that the job measured; null if it took the declared times. */
export function clocksPanel({ clocks }) {
  if (!clocks) return null;
  const panel = el("div", { class: "look-clocks" });
  render(html`<p class="look-quiet">Offsets were measured from people in motion. A curve shows the share of moving joints that disagree with the other cameras, were the offset another one: one narrow valley is a good answer.</p>
    <div class="look-curves">${clocks.map((clock) => html`<figure>${curve(clock)}<figcaption>${caption(clock)}</figcaption></figure>`)}</div>`, panel);
  return panel;
}

function caption({ camera, offset_s: offsetS, sigma_s: sigmaS, rate }) {
  const spread = sigmaS === null ? ", standard deviation unknown" : ` ± ${figure(sigmaS * 1000, 1)} ms`;
  const drift = (1 - rate) * 1e6;
  const fast = Math.abs(drift) < 0.05 ? "" : `, clock ${drift > 0 ? "fast" : "slow"} by ${figure(Math.abs(drift), 1)} ppm`;
  return html`<b>${camera}</b> starts at ${figure(offsetS, 3)} s${spread}${fast}`;
}

function curve({ camera, offset_s: foundS, sigma_s: sigmaS, offsets_s: offsetsS, disagreement }) {
  const [lowS, highS] = [Math.min(foundS, ...offsetsS), Math.max(foundS, ...offsetsS)];
  const x = (valueS) => LEFT + ((valueS - lowS) / Math.max(highS - lowS, 1e-6)) * (WIDTH - LEFT - RIGHT);
  const y = (share) => TOP + (1 - share) * (HEIGHT - TOP - BOTTOM);
  const seconds = Array.from({ length: Math.max(0, Math.floor(highS) - Math.ceil(lowS) + 1) }, (_, number) => Math.ceil(lowS) + number);
  const spread = Math.max(2, x(foundS + (sigmaS ?? 0)) - x(foundS - (sigmaS ?? 0)));
  const points = offsetsS.map((valueS, number) => [x(valueS), y(disagreement[number]), valueS]);
  return html`<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label="${camera}: disagreement over the offset">
    <path class="look-axis" d="M${LEFT},${y(0)}H${WIDTH - RIGHT}M${LEFT},${y(1)}H${WIDTH - RIGHT}"></path>
    ${[0, 0.5, 1].map((share) => svg`<text x=${LEFT - 6} y=${y(share) + 4} text-anchor="end">${100 * share} %</text>`)}
    ${seconds.map((second) => svg`<text x=${x(second)} y=${HEIGHT - 8} text-anchor="middle">${second} s</text>`)}
    <rect class="look-found" x=${x(foundS) - spread / 2} y=${y(1)} width=${spread} height=${y(0) - y(1)}></rect>
    <path class="look-curve" d=${path(points)}></path>
  </svg>`;
}

// The curve is broken where no offset was compared.
function path(points) {
  const steps = points.slice(1).map(([, , valueS], number) => valueS - points[number][2]).sort((one, other) => one - other);
  const usual = steps[Math.floor(steps.length / 2)] ?? 0;
  return points.map(([x, y, valueS], number) => {
    const isNew = number === 0 || valueS - points[number - 1][2] > 1.5 * usual;
    return `${isNew ? "M" : "L"}${x.toFixed(1)},${y.toFixed(1)}`;
  }).join("");
}
