// Figures of a live capture from cameras: what happened in the last second, and what each camera does.

import { length } from "../shared/format.js";
import { html, nothing, scrollTable } from "../shared/lit.js";
import { COMMON, COUNTS } from "../shared/strings/common.js";
import { LIVE } from "../shared/strings/live.js";

/** List of `[name, value]`. */
export const figureList = (facts) => html`<dl class="live-figures">${facts.map(([name, value]) => html`<div><dt>${name}</dt><dd>${value}</dd></div>`)}</dl>`;

/** Figures of a message `status`, with the number of people who are shown. */
export function statusFigures({ time_s: timeS, instants_hz: rateHz, latency_s: { p50, p95 } }, people) {
  const { figures } = LIVE;
  return figureList([
    [figures.time, length(timeS)],
    [figures.people, people],
    [figures.instants, COMMON.hz(rateHz)],
    [figures.latency, p50 === null ? LIVE.unknown : LIVE.latency((1000 * p50).toFixed(0), (1000 * p95).toFixed(0))],
  ]);
}

/** Tables of the cameras and outputs of a message `status`. */
export const states = ({ cameras, outputs }) => [cameras.length ? cameraStates(cameras) : nothing, outputs.length ? outputStates(outputs) : nothing];

const outputStates = (outputs) => html`<section class="panel" aria-labelledby="outputs-title"><h2 id="outputs-title">${LIVE.outputs.states}</h2>
  ${scrollTable(LIVE.outputs.states, LIVE.outputs.table, outputs.map((output) => html`<tr><th scope="row">${output.address}</th><td>${LIVE.outputs.state[output.state]}${output.message ? `: ${output.message}` : ""}</td>
    <td>${output.sent}</td><td>${COUNTS.instants(output.dropped)}</td><td>${COUNTS.instants(output.failed)}</td></tr>`))}
</section>`;

const cameraStates = (cameras) => html`<section class="panel" aria-labelledby="cameras-title"><h2 id="cameras-title">${LIVE.preview.cameras}</h2>
  ${scrollTable(LIVE.preview.cameras, LIVE.preview.table, cameras.map((camera) => html`<tr><th scope="row">${camera.name}</th><td>${LIVE.preview.states[camera.state]}</td>
    <td>${COMMON.hz(camera.decoded_hz)}</td><td>${COMMON.hz(camera.detected_hz)}</td><td>${COUNTS.frames(camera.dropped)}</td><td>${COUNTS.times(camera.lost)}</td></tr>`))}
</section>`;
