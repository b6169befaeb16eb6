// View Calibrations: the stored ones to look at, download, rename and delete; a form to add one.

import { call, persistently, readFile } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { moment } from "../shared/format.js";
import { confirm, helpLink, html, nothing, problemBox, render, renameForm, repeat, scrollTable, warningList } from "../shared/lit.js";
import { address, announce, save } from "../shared/page.js";
import { distinct, readCalibrations } from "../shared/resources.js";
import { CALIBRATIONS } from "../shared/strings/calibrations.js";
import { COMMON } from "../shared/strings/common.js";
import { AddForm } from "./add.js";

const POLL_MS = 2000;
const STATE_TONES = { queued: "wait", running: "run", canceling: "wait", canceled: "mute", failed: "bad", ready: "good" };
const MAKING = ["queued", "running", "canceling"];

export function open(place, route, caller) {
  let calibrations = null;
  let problem = null;
  let isClosed = false;
  let timer = 0;
  let renamed = null; // id of the calibration whose name is being changed
  const problems = new Map();
  const add = caller.scopes.includes("write") ? new AddForm({ changed: () => load(), draw: () => draw() }) : null;

  async function load() {
    clearTimeout(timer);
    try {
      const away = (refused) => { problem = refused; draw(); };
      calibrations = await persistently(readCalibrations, { isOver: () => isClosed, away });
      problem = null;
    } catch (refused) {
      problem = refused;
    }
    draw();
    if (!isClosed && calibrations?.some(({ state }) => MAKING.includes(state))) timer = setTimeout(load, POLL_MS);
  }

  // Do something with a calibration, and show its problem beside it.
  async function act(id, action) {
    problems.delete(id);
    try {
      await action();
    } catch (refused) {
      problems.set(id, refused);
    }
    draw();
  }

  async function remove({ newest: { id, name }, all }) {
    const { title, copies, text, action, said } = CALIBRATIONS.deleting;
    if (!await confirm({ title: title(name), text: `${all.length > 1 ? copies(all.length) : ""}${text}`, action })) return;
    await act(id, async () => {
      for (const { urls } of all) await call(urls.self, { method: "DELETE" });
      announce(said(name));
      await load();
      place.querySelector("#calibrations-title").focus();
    });
  }

  function nameForm({ id, name, urls }) {
    const end = () => {
      renamed = null;
      draw();
      place.querySelector(`#rename-${id}`)?.focus();
    };
    const rename = (wanted) => act(id, async () => {
      await call(urls.self, { method: "PATCH", body: { name: wanted } });
      await load();
      end();
      announce(COMMON.renamed(wanted));
    });
    return renameForm({ name, rename, end });
  }

  function cameraTable({ name, cameras, report, source }) {
    const errors = new Map((report?.cameras ?? []).map((camera) => [camera.name, camera.reprojection_error_px]));
    const describeError = (camera) => (errors.get(camera.name) == null ? "" : CALIBRATIONS.px(errors.get(camera.name).toFixed(2)));
    return html`<details class="cameras"><summary>${COMMON.cameras}</summary>
      <p class="quiet">${report?.world ?? [source.format, source.axes].filter(Boolean).join("; ")}</p>
      ${scrollTable(CALIBRATIONS.camerasOf(name), CALIBRATIONS.table, cameras.map((camera) => html`<tr><th scope="row">${camera.name}</th>
          <td>${camera.size_px ? camera.size_px.join(" × ") : CALIBRATIONS.sizeUnknown}</td><td>${CALIBRATIONS.px(camera.matrix[0][0].toFixed(1))}</td>
          <td>${camera.position_m.map((value) => value.toFixed(2)).join(", ")}</td><td>${describeError(camera)}</td></tr>`))}</details>`;
  }

  // A format that can't hold a lens is refused, beside the calibration.
  function downloadForm({ id, name, urls }) {
    const submit = (event) => {
      event.preventDefault();
      const { value } = event.target.elements.format;
      return act(id, async () => save(await readFile(`${urls.file}?format=${value}`)));
    };
    return html`<form class="download" @submit=${submit}><select name="format" aria-label=${CALIBRATIONS.formatOf(name)}>
        ${Object.entries(CALIBRATIONS.formats).map(([format, label]) => html`<option value=${format}>${label}</option>`)}</select>
      <button class="button small" aria-label=${CALIBRATIONS.downloadOf(name)}>${CALIBRATIONS.download}</button></form>`;
  }

  function card(group) {
    const { newest: calibration, all } = group;
    const origin = calibration.method === "file" ? CALIBRATIONS.fromFile(calibration.source.file) : CALIBRATIONS.fromMethod[calibration.method];
    const facts = [moment(calibration.created_at), origin, ...(all.length > 1 ? [CALIBRATIONS.storedTimes(all.length)] : [])];
    return html`<li class="panel calibration">
      <div class="head"><div>${renamed === calibration.id ? nameForm(calibration) : html`<h2>${calibration.name}</h2>`}
        <p class="quiet facts">${facts.map((fact) => html`<span>${fact}</span>`)}</p></div>
        <span class="state" data-tone=${STATE_TONES[calibration.state]}>${CALIBRATIONS.states[calibration.state]}</span></div>
      ${problemBox(calibration.error && { message: calibration.error.detail, hint: calibration.error.hint, code: calibration.error.code })}
      ${problemBox(problems.get(calibration.id))}
      ${warningList(calibration.warnings, COMMON.warningsOf(calibration.name))}
      ${calibration.cameras.length ? cameraTable(calibration) : nothing}
      <div class="actions">
        ${calibration.urls.file ? downloadForm(calibration) : nothing}
        ${add ? html`<button type="button" class="button small" id="rename-${calibration.id}" aria-label=${COMMON.renameOf(calibration.name)} @click=${() => { renamed = calibration.id; draw(); }}>${COMMON.rename}</button>
          <button type="button" class="button small danger-quiet" aria-label=${CALIBRATIONS.deleteOf(calibration.name)} @click=${() => remove(group)}>${COMMON.delete}</button>` : nothing}
      </div></li>`;
  }

  function draw() {
    if (isClosed) return;
    render(html`<div class="with-help"><h1 class="title" id="calibrations-title" tabindex="-1">${CALIBRATIONS.title}</h1>${helpLink("calibration", CALIBRATIONS.title)}</div>
      <div class="split">
        <div>
          ${problemBox(problem)}
          ${calibrations === null ? html`<p class="quiet">${COMMON.loading}</p>` : nothing}
          ${calibrations?.length === 0 ? html`<p class="panel empty">${CALIBRATIONS.none}</p>` : nothing}
          <ul class="list">${repeat(distinct(calibrations ?? []), ({ newest }) => newest.id, card)}</ul>
        </div>
        <div class="list">${add?.form() ?? nothing}<p><a href=${address("plan")}>${CALIBRATIONS.plan}</a></p></div>
      </div>`, place);
  }

  const onFeed = () => { if (calibrations?.some(({ state }) => MAKING.includes(state))) load(); };
  feed.addEventListener("change", onFeed);
  draw();
  load();
  return {
    title: CALIBRATIONS.title,
    close() {
      isClosed = true;
      clearTimeout(timer);
      feed.removeEventListener("change", onFeed);
    },
  };
}
