// Calibration files as stored calibrations: the same file is sent once.

import { call, jsonPart } from "../shared/api.js";
import { stem } from "../shared/format.js";

const KEY = "multicap.calibrations";
const MOST = 50;

function known() {
  try {
    return JSON.parse(localStorage.getItem(KEY)) ?? {};
  } catch {
    return {};
  }
}

function remember(name, id) {
  const entries = Object.entries({ ...known(), [name]: id }).slice(-MOST);
  try {
    localStorage.setItem(KEY, JSON.stringify(Object.fromEntries(entries)));
  } catch { /* storage is off or full: the file is sent again next time */ }
}

// Stored calibration of a file, which the service checks.
export async function storedCalibration(file, units) {
  const name = [file.name, file.size, file.lastModified, units].join("|");
  const id = known()[name];
  const earlier = id ? await call(`/v1/calibrations/${id}`).catch(() => null) : null;
  if (earlier?.state === "ready") return earlier;
  const form = new FormData();
  form.append("spec", jsonPart({ method: "file", name: stem(file.name), units }));
  form.append("calibration", file);
  const calibration = await call("/v1/calibrations", { method: "POST", form });
  remember(name, calibration.id);
  return calibration;
}
