// View Calibrations: the stored ones to look at, download and delete; a form to add one.

import { announce } from "../shared/announce.js";
import { call } from "../shared/api.js";
import { persistently } from "../shared/away.js";
import { confirm } from "../shared/dialog.js";
import { feed } from "../shared/feed.js";
import { moment } from "../shared/format.js";
import { html, nothing, render, repeat } from "../shared/lit.js";
import { problemBox, warningList } from "../shared/problem.js";
import { AddForm } from "./add.js";

const MOST = 100;
const POLL_MS = 2000;
const FORMATS = [["multicap", "JSON"], ["anipose", "anipose TOML"], ["caliscope", "Caliscope TOML"], ["opencv", "OpenCV YAML"]];
const STATES = {
  queued: ["waiting", "wait"], running: ["being made", "run"], canceling: ["canceling", "wait"], canceled: ["canceled", "mute"],
  failed: ["failed", "bad"], ready: ["ready", "good"],
};
const MAKING = ["queued", "running", "canceling"];

export function open(place, route, caller) {
  let calibrations = null;
  let problem = null;
  let isClosed = false;
  let timer = 0;
  const problems = new Map();
  const add = caller.scopes.includes("write") ? new AddForm({ changed: () => load(), draw: () => draw() }) : null;

  async function load() {
    clearTimeout(timer);
    try {
      const away = (refused) => { problem = refused; draw(); };
      calibrations = (await persistently(() => call(`/v1/calibrations?limit=${MOST}`), { isOver: () => isClosed, away })).calibrations;
      problem = null;
    } catch (refused) {
      problem = refused;
    }
    draw();
    if (!isClosed && calibrations?.some(({ state }) => MAKING.includes(state))) timer = setTimeout(load, POLL_MS);
  }

  async function remove(calibration) {
    const text = "Captures that use it keep their copy.";
    if (!await confirm({ title: `Delete the calibration ${calibration.name}?`, text, action: "Delete the calibration" })) return;
    problems.delete(calibration.id);
    try {
      await call(calibration.links.self, { method: "DELETE" });
      announce(`The calibration ${calibration.name} is deleted.`);
      await load();
      place.querySelector("#calibrations-title").focus();
    } catch (refused) {
      problems.set(calibration.id, refused);
      draw();
    }
  }

  function cameraTable({ name, cameras, report, source }) {
    const errors = new Map((report?.cameras ?? []).map((one) => [one.name, one.reprojection_error_px]));
    const errorOf = (camera) => (errors.get(camera.name) == null ? "" : `${errors.get(camera.name).toFixed(2)} px`);
    return html`<details class="cameras"><summary>Cameras</summary>
      <p class="quiet">${report?.world ?? [source.format, source.axes].filter(Boolean).join("; ")}</p>
      <div class="scroll" role="group" aria-label="Cameras of ${name}" tabindex="0"><table>
        <thead><tr><th scope="col">Camera</th><th scope="col">Picture</th><th scope="col">Focal length</th><th scope="col">Position, m</th><th scope="col">Error</th></tr></thead>
        <tbody>${cameras.map((camera) => html`<tr><th scope="row">${camera.name}</th>
          <td>${camera.size_px ? camera.size_px.join(" × ") : "unknown"}</td><td>${camera.matrix[0][0].toFixed(1)} px</td>
          <td>${camera.position_m.map((value) => value.toFixed(2)).join(", ")}</td><td>${errorOf(camera)}</td></tr>`)}</tbody>
      </table></div></details>`;
  }

  function card(calibration) {
    const [words, tone] = STATES[calibration.state];
    return html`<li class="panel calibration">
      <div class="head"><div><h2>${calibration.name}</h2><p class="quiet facts"><span>${moment(calibration.created_at)}</span><span>${calibration.method === "file" ? calibration.source.file : `made from ${calibration.method === "board" ? "a board" : "people"}`}</span></p></div>
        <span class="state" data-tone=${tone}>${words}</span></div>
      ${problemBox(calibration.error && { message: calibration.error.detail, hint: calibration.error.hint })}
      ${problemBox(problems.get(calibration.id))}
      ${warningList(calibration.warnings, `Warnings of ${calibration.name}`)}
      ${calibration.cameras.length ? cameraTable(calibration) : nothing}
      <div class="actions">
        ${calibration.links.file ? FORMATS.map(([format, label]) => html`<a class="button small" download href="${calibration.links.file}?format=${format}" aria-label="${calibration.name} as ${label}">${label}</a>`) : nothing}
        ${add ? html`<button type="button" class="button small danger-quiet" aria-label="Delete ${calibration.name}" @click=${() => remove(calibration)}>Delete</button>` : nothing}
      </div></li>`;
  }

  function draw() {
    if (isClosed) return;
    render(html`<h1 class="title" id="calibrations-title" tabindex="-1">Calibrations</h1>
      <div class="split">
        <div>
          ${problemBox(problem)}
          ${calibrations === null ? html`<p class="quiet">Loading …</p>` : nothing}
          ${calibrations?.length === 0 ? html`<p class="panel empty">No calibrations are stored yet.</p>` : nothing}
          <ul class="list">${repeat(calibrations ?? [], ({ id }) => id, card)}</ul>
        </div>
        ${add ? html`<div>${add.form()}</div>` : nothing}
      </div>`, place);
  }

  const onFeed = () => { if (calibrations?.some(({ state }) => MAKING.includes(state))) load(); };
  feed.addEventListener("change", onFeed);
  draw();
  load();
  return {
    title: "Calibrations",
    close() {
      isClosed = true;
      clearTimeout(timer);
      feed.removeEventListener("change", onFeed);
    },
  };
}
