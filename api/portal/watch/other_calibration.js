// Form that makes a capture of the footage of another one, with another calibration; nothing is uploaded.

import { announce } from "../shared/announce.js";
import { call } from "../shared/api.js";
import { dated } from "../shared/calibrations.js";
import { html } from "../shared/lit.js";

export function otherCalibrationForm(view, session) {
  const calibrations = view.recalibrated.get(session.id);
  const close = () => {
    view.recalibrated.delete(session.id);
    view.draw();
    view.place.querySelector(`#recalibrate-${session.id}`)?.focus();
  };
  const submit = (event) => {
    event.preventDefault();
    const { name, calibration } = event.target.elements;
    return view.act(session.id, async () => {
      const body = { session_id: session.id, calibration_id: calibration.value, manifest: { name: name.value.trim() || session.name } };
      const made = await call("/v1/sessions", { method: "POST", body });
      close();
      await view.load();
      announce(`${made.name} is there. Reconstruct it.`);
      view.place.querySelector(`#run-${made.id}`)?.focus();
    });
  };
  return html`<form class="again" aria-label="Other calibration for ${session.name}" @submit=${submit}>
    <div class="pair">
      <label class="field"><span>Calibration</span><select name="calibration" required>
        ${calibrations.map((calibration) => html`<option value=${calibration.id}>${dated(calibration)}</option>`)}</select></label>
      <label class="field"><span>Name of the new capture</span><input name="name" maxlength="200" value=${session.name} autocomplete="off"></label>
    </div>
    ${calibrations.length ? "" : html`<p class="quiet">No calibration is stored. <a href="#/calibrations">Add one.</a></p>`}
    <div class="actions"><button class="button primary" ?disabled=${calibrations.length === 0}>Make a capture of the same footage</button>
      <button type="button" class="button" @click=${close}>Close</button></div>
  </form>`;
}
