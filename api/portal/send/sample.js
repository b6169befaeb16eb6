// One click to try the service: the sample capture, if the machine of the service has it.

import { call, RequestProblem } from "../shared/api.js";
import { html } from "../shared/lit.js";

let isLoading = false;

async function fetchFile({ name, link, media_type: type }) {
  const response = await fetch(link);
  if (!response.ok) throw new RequestProblem(await response.json().catch(() => null), response.status);
  return new File([await response.blob()], name, { type, lastModified: 0 });
}

async function fetchSample() {
  const sample = await call("/v1/sample");
  if (!sample.installed) {
    throw new RequestProblem({ detail: "The sample capture is not installed on the service.", hint: sample.install });
  }
  return { ...sample, files: await Promise.all(sample.files.map(fetchFile)) };
}

// Add the sample to the capture; false if other files were chosen meanwhile.
async function addSample(sending) {
  const { files, attribution } = await fetchSample();
  if (sending.rows.length) return false;
  sending.draft.name ||= "Sample capture";
  await sending.add(files);
  sending.notes.push(attribution);
  return true;
}

export function sampleButton({ sending, draw, failed }) {
  const load = async () => {
    isLoading = true;
    draw();
    try {
      if (await sending.reading("the sample capture", addSample(sending))) await sending.send();
    } catch (problem) {
      failed(problem);
    } finally {
      isLoading = false;
      draw();
    }
  };
  return html`<button type="button" class="button ghost" ?disabled=${isLoading} @click=${load}>${isLoading ? "Loading the sample …" : "Try the sample capture"}</button>`;
}
