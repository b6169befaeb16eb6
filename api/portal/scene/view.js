// View Scene: known points are marked in a picture of each camera, and calibrate the cameras.

import { call, jsonPart, readFile } from "../shared/api.js";
import { stem } from "../shared/format.js";
import { helpLink, html, nothing, problemBox, render, selectField, typed, warningList } from "../shared/lit.js";
import { announce, save } from "../shared/page.js";
import { listed, readCalibrations } from "../shared/resources.js";
import { COMMON } from "../shared/strings/common.js";
import { SCENE } from "../shared/strings/scene.js";
import { PointMarks } from "./marks.js";
import { MarkedPicture, Still } from "./picture.js";

// Marks are the work of minutes: they stay while the page is open.
const kept = { stills: [], current: null, marks: new PointMarks(), text: "", wrong: [], made: null, isMarkedSince: false };

export function open(place) {
  const { marks } = kept;
  const picture = new MarkedPicture(marks, () => changed(), () => undo());
  let isClosed = false;
  let isBusy = false;
  let problem = null;
  let unread = []; // names of files that the browser can't show
  let lenses = [];

  // Errors are of the marks that were sent.
  function changed() {
    kept.isMarkedSince = true;
    draw();
  }

  const cameras = () => kept.stills.map(({ camera }) => camera);
  const choose = (still) => {
    kept.current = still;
    if (still) marks.begin(still.camera);
    draw();
  };

  async function addFiles(files) {
    unread = [];
    kept.made = null; // of other pictures
    for (const file of files) {
      const still = new Still(file, stem(file.name));
      try {
        await still.load();
      } catch {
        still.close();
        unread.push(file.name);
        continue;
      }
      kept.stills.find(({ camera }) => camera === still.camera)?.close();
      kept.stills = [...kept.stills.filter(({ camera }) => camera !== still.camera), still].sort((one, other) => one.camera.localeCompare(other.camera));
    }
    choose(kept.stills[0] ?? null);
  }

  function readPoints(text) {
    Object.assign(kept, { text, wrong: marks.read(text), isMarkedSince: true });
    choose(kept.current);
  }

  // Undo the last change, and show its camera.
  function undo() {
    const camera = marks.undo();
    kept.current = kept.stills.find((each) => each.camera === camera) ?? kept.current;
    changed();
  }

  const isReady = () => !isBusy && kept.stills.length > 0 && marks.points.length > 0;

  // The lens of a stored calibration goes along as a file.
  async function form({ lens, title }) {
    const parts = new FormData();
    const sizes = Object.fromEntries(kept.stills.map(({ camera, size }) => [camera, size]));
    parts.append("spec", jsonPart({ method: "scene", known_points: marks.known(cameras()), sizes_px: sizes, ...(title && { name: title }) }));
    const chosen = lenses.find(({ id }) => id === lens);
    if (chosen) parts.append("intrinsics", await readFile(chosen.urls.file), "lenses.json");
    return parts;
  }

  async function submit(event) {
    event.preventDefault();
    if (!isReady()) return;
    const { lens, title } = event.target.elements;
    isBusy = true;
    problem = null;
    draw();
    try {
      const made = await call("/v1/calibrations", { method: "POST", form: await form({ lens: lens.value, title: title.value.trim() }) });
      // Calibrating again replaces the calibration.
      if (kept.made) await call(kept.made.urls.self, { method: "DELETE" }).catch(() => null);
      Object.assign(kept, { made, isMarkedSince: false });
      announce(SCENE.stored(made.name));
    } catch (refused) {
      problem = refused;
    }
    isBusy = false;
    draw();
  }

  const fitsOf = (camera) => new Map(kept.isMarkedSince ? [] : kept.made?.report.cameras.find(({ name }) => name === camera)?.points?.map((point) => [point.name, point]));

  function pointList(still) {
    const fits = fitsOf(still.camera);
    return html`<ol class="points" aria-label=${SCENE.points}>${marks.points.map(({ name, xyz_m }) => {
      const pixel = marks.of(still.camera).get(name);
      return html`<li><button type="button" class="button small" aria-pressed=${String(name === marks.next || name === marks.held)}
        @click=${() => { marks.choose(still.camera, name); draw(); place.querySelector(".still").focus(); }}>
        <b>${name}</b><span class="quiet">${xyz_m.join(", ")} m</span>
        <span>${pixel ? SCENE.pixel(...pixel) : SCENE.unmarked}${fits.has(name) ? html` <b>${SCENE.off(fits.get(name).error_px)}</b>` : nothing}</span></button></li>`;
    })}</ol>`;
  }

  function workplace(still) {
    const seek = ({ target }) => still.seek(target.valueAsNumber).then(draw);
    const next = marks.points.find(({ name }) => name === marks.next);
    return html`<section class="panel work" aria-label=${SCENE.pictures}>
      <div class="choices">${kept.stills.map((each) => html`<button type="button" class="button small" aria-pressed=${String(each === still)} @click=${() => choose(each)}>
        ${SCENE.camera(each.camera, marks.marked(each.camera).length, marks.points.length)}</button>`)}</div>
      <p role="status">${next ? SCENE.click(next.name) : marks.points.length ? SCENE.complete : SCENE.noPoints}</p>
      ${picture.draw(still, fitsOf(still.camera))}
      ${still.duration_s ? html`<label class="field"><span>${SCENE.time(still.time_s.toFixed(1))}</span>
        <input type="range" min="0" max=${still.duration_s} step="0.1" .value=${typed(still.time_s)} @change=${seek}></label>` : nothing}
      <div class="actions"><button type="button" class="button small" ?disabled=${!marks.canUndo} @click=${undo}>${SCENE.undo}</button>
        <button type="button" class="button small" ?disabled=${marks.held === null} @click=${() => { marks.remove(still.camera); changed(); }}>${SCENE.remove(marks.held ?? "")}</button>
        <button type="button" class="button small" @click=${() => save(new File([marks.table(cameras())], "points.csv"))}>${SCENE.save}</button></div>
      <p class="quiet" id="scene-keys">${SCENE.keys}</p>
      ${pointList(still)}</section>`;
  }

  function result() {
    if (!kept.made) return nothing;
    const { name, report, warnings } = kept.made;
    return html`<section class="panel add" aria-labelledby="scene-result"><h2 id="scene-result">${SCENE.stored(name)}</h2>
      <p class="quiet">${report.world}</p>
      <ul>${report.cameras.map((camera) => html`<li>${SCENE.worst(camera.name, camera.reprojection_error_px,
        camera.points.reduce((worst, point) => (point.error_px > worst.error_px ? point : worst)))}</li>`)}</ul>
      ${warningList(warnings, COMMON.warningsOf(name))}
      <p class="quiet">${SCENE.again} <a href="#/calibrations">${SCENE.all}</a></p></section>`;
  }

  function draw() {
    if (isClosed) return;
    render(html`<link rel="stylesheet" href="/portal/scene/scene.css"><div class="with-help"><h1 class="title">${SCENE.title}</h1>${helpLink("calibration", SCENE.title)}</div>
      <div class="split">
        <div class="list">${kept.current ? workplace(kept.current) : html`<p class="panel empty">${SCENE.empty}</p>`}</div>
        <div class="list"><form class="panel add" aria-label=${SCENE.title} @submit=${submit}>
          <label class="field"><span>${SCENE.files}</span><input type="file" multiple accept="video/*,image/*" aria-describedby="scene-files" @change=${({ target }) => addFiles([...target.files])}></label>
          <p id="scene-files" class="quiet">${SCENE.filesHint}</p>
          ${unread.length ? html`<p class="problem" role="alert">${SCENE.unread(unread.join(", "))}</p>` : nothing}
          <label class="field"><span>${SCENE.table}</span><textarea rows="8" spellcheck="false" placeholder=${SCENE.placeholder} aria-describedby="scene-table"
            .value=${typed(kept.text)} @input=${({ target }) => readPoints(target.value)}></textarea></label>
          <p id="scene-table" class="quiet">${kept.wrong.length ? SCENE.wrong(kept.wrong.join(", ")) : SCENE.read(marks.points.length)}</p>
          ${selectField(SCENE.lens, [["", SCENE.estimated], ...listed(lenses)], { name: "lens" })}
          <label class="field"><span>${SCENE.name}</span><input name="title" maxlength="200" placeholder=${SCENE.namePlaceholder} autocomplete="off"></label>
          <div class="actions"><button class="button primary" aria-disabled=${isReady() ? nothing : "true"}>${SCENE.submit}</button></div>
          ${problemBox(problem)}</form>${result()}</div>
      </div>`, place);
  }

  draw();
  readCalibrations().then((found) => {
    lenses = found.filter(({ state }) => state === "ready");
    draw();
  }).catch((refused) => {
    problem = refused;
    draw();
  });
  return { title: SCENE.title, close() { isClosed = true; } };
}
