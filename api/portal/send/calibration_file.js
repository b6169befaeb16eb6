// Calibration files as stored calibrations: a file whose content is stored already is not sent again.

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

// Digest of 53 bits (cyrb53) that tells a user's own files apart. Browsers offer SHA-256 only where pages come encrypted.
function digest(bytes) {
  let [high, low] = [0xdeadbeef, 0x41c6ce57];
  for (const byte of bytes) {
    high = Math.imul(high ^ byte, 2654435761);
    low = Math.imul(low ^ byte, 1597334677);
  }
  high = Math.imul(high ^ (high >>> 16), 2246822507) ^ Math.imul(low ^ (low >>> 13), 3266489909);
  low = Math.imul(low ^ (low >>> 16), 2246822507) ^ Math.imul(high ^ (high >>> 13), 3266489909);
  return (4294967296 * (2097151 & low) + (high >>> 0)).toString(36);
}

// A calibration that was deleted since is sent again.
function unlessAway(problem) {
  if (problem.isAway) throw problem;
  return null;
}

// Stored calibration of a file, which the service checks.
export async function storedCalibration(file, units, up) {
  const name = [digest(new Uint8Array(await file.arrayBuffer())), file.size, file.name.split(".").pop(), units, ...(up ? [up] : [])].join("|");
  const id = known()[name];
  const earlier = id ? await call(`/v1/calibrations/${id}`).catch(unlessAway) : null;
  if (earlier?.state === "ready") return earlier;
  const form = new FormData();
  form.append("spec", jsonPart({ method: "file", name: stem(file.name), units, ...(up && { up }) }));
  form.append("calibration", file, file.name); // a file of a chosen folder would have its path as its name
  const calibration = await call("/v1/calibrations", { method: "POST", form });
  remember(name, calibration.id);
  return calibration;
}
