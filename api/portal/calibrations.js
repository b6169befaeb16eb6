// Calibrations: the stored ones to choose, look at and delete; a form to add one from a file, a board or people.

import { at, call, clone, element, jsonPart, send, showProblem, sized } from "./common.js";

const REFRESH_MS = 30000;
const MOST = 100;
const FORMATS = [["multicap", "JSON"], ["anipose", "anipose TOML"], ["caliscope", "Caliscope TOML"], ["opencv", "OpenCV YAML"]];
const STATES = {
  queued: "waiting", running: "being made", canceling: "canceling", canceled: "canceled", failed: "failed", ready: "ready",
};

let refreshedAt = -Infinity; // time of the last request
let isMaking = false; // whether a calibration is being made

// Id of the stored calibration that the form of a capture names; empty for a file.
export const chosenCalibration = () => at("send").elements.calibration_id.value;

export async function refreshCalibrations() {
  if (!isMaking && performance.now() - refreshedAt < REFRESH_MS) return;
  const { calibrations } = await call(`/v1/calibrations?limit=${MOST}`);
  refreshedAt = performance.now();
  isMaking = calibrations.some(({ state }) => ["queued", "running", "canceling"].includes(state));
  fillSelect(calibrations.filter(({ state, report }) => state === "ready" && report?.has_extrinsics !== false));
  fillList(calibrations);
}

function fillSelect(ready) {
  const select = at("send").elements.calibration_id;
  const chosen = select.value;
  select.replaceChildren(new Option("From a file", ""), ...ready.map(({ id, name }) => new Option(name, id)));
  select.value = ready.some(({ id }) => id === chosen) ? chosen : "";
  at("stored").hidden = ready.length === 0;
  showFile();
}

// The file is wanted unless a stored calibration is chosen.
function showFile() {
  const isFile = chosenCalibration() === "";
  at("calibration-file").hidden = !isFile;
  at("send").elements.calibration.required = isFile;
}

function fillList(calibrations) {
  // A redrawn list would take the focus and close what is open.
  const shown = JSON.stringify(calibrations);
  if (at("calibration-list").dataset.shown === shown) return;
  at("calibration-list").dataset.shown = shown;
  at("calibration-list").replaceChildren(...calibrations.map(item));
  at("no-calibrations").hidden = calibrations.length > 0;
}

function item(calibration) {
  const made = clone("calibration");
  const say = (name, text) => { made.querySelector(name).textContent = text; };
  say(".name", calibration.name);
  say(".state", STATES[calibration.state]);
  made.querySelector(".state").dataset.state = calibration.state === "ready" ? "succeeded" : calibration.state;
  const errors = new Map((calibration.report?.cameras ?? []).map((one) => [one.name, one.reprojection_error_px]));
  made.querySelector("tbody").replaceChildren(...calibration.cameras.map((camera) => {
    const row = document.createElement("tr");
    const cells = [
      camera.name,
      camera.size_px ? camera.size_px.join(" × ") : "unknown",
      `${camera.matrix[0][0].toFixed(1)} px`,
      camera.position_m.map((value) => value.toFixed(2)).join(", "),
      errors.get(camera.name) == null ? "" : `${errors.get(camera.name).toFixed(2)} px`,
    ];
    row.append(...cells.map((cell) => element("td", cell)));
    return row;
  }));
  made.querySelector("table").hidden = calibration.cameras.length === 0;
  say(".world", calibration.report?.world ?? [calibration.source.format, calibration.source.axes].filter(Boolean).join("; "));
  if (calibration.error) showProblem(made.querySelector(".problems"), new Error(calibration.error.detail));
  const warnings = made.querySelector(".warnings");
  warnings.replaceChildren(...calibration.warnings.map((warning) => element("li", warning)));
  warnings.hidden = calibration.warnings.length === 0;
  if (calibration.links.file) {
    made.querySelector(".files").append(...FORMATS.map(([format, label]) => Object.assign(element("a", label), {
      href: `${calibration.links.file}?format=${format}`, download: "", ariaLabel: `${calibration.name} as ${label}`,
    })));
  }
  const remove = made.querySelector("button");
  remove.setAttribute("aria-label", `Delete ${calibration.name}`);
  remove.addEventListener("click", async () => {
    if (!window.confirm(`Delete the calibration ${calibration.name}?`)) return;
    try {
      await call(calibration.links.self, "DELETE");
      changed();
    } catch (problem) {
      showProblem(made.querySelector(".problems"), problem);
    }
  });
  return made;
}

function changed() {
  refreshedAt = -Infinity;
  document.dispatchEvent(new Event("changed"));
}

// Fields of the method that is chosen; the others are neither shown nor sent.
function showMethod() {
  const { source } = at("add-calibration").elements;
  for (const part of at("add-calibration").querySelectorAll("[data-method]")) {
    part.hidden = !part.dataset.method.split(" ").includes(source.value);
    for (const field of part.querySelectorAll("input")) field.disabled = part.hidden;
  }
}

function formOf(sent) {
  const { source, title, board, file, footage, stature, intrinsics } = sent.elements;
  const form = new FormData();
  const spec = { method: source.value };
  if (title.value.trim()) spec.name = title.value.trim();
  if (source.value === "board") spec.board = board.value.trim();
  if (source.value === "people") spec.stature_m = stature.value.split(",").map(Number);
  form.append("spec", jsonPart(spec));
  if (source.value === "people" && intrinsics.files.length) form.append("intrinsics", intrinsics.files[0]);
  if (source.value === "file") form.append("calibration", file.files[0]);
  else for (const video of footage.files) form.append("videos", video);
  return form;
}

at("add-calibration").addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.currentTarget;
  const submit = form.querySelector("[type=submit]");
  const progress = at("adding");
  submit.disabled = true;
  showProblem(at("calibration-problems"), null);
  try {
    const made = await send("/v1/calibrations", formOf(form), (loaded, total) => {
      progress.textContent = loaded < total ? `${sized(loaded)} of ${sized(total)} sent` : "Sent. Checking the files …";
    }, new AbortController().signal);
    form.reset();
    showMethod();
    progress.textContent = made.kind === "calibration" ? "The calibration is being made; see the jobs." : "Added.";
    changed();
  } catch (problem) {
    progress.textContent = "";
    showProblem(at("calibration-problems"), problem);
  } finally {
    submit.disabled = false;
  }
});

at("add-calibration").elements.source.addEventListener("change", showMethod);
at("send").elements.calibration_id.addEventListener("change", showFile);
at("send").addEventListener("reset", () => setTimeout(showFile));
showMethod();
