// Stored calibrations as lists for people.

import { call } from "./api.js";
import { day } from "./format.js";

const MOST = 100;

export const readCalibrations = async () => (await call(`/v1/calibrations?limit=${MOST}`)).calibrations;

// Calibrations of which none has the cameras of another: the newest of equal ones, each as `{ newest, all }`.
export function distinct(calibrations) {
  const groups = new Map();
  for (const calibration of calibrations) {
    const key = calibration.sha256 ?? calibration.id;
    if (groups.has(key)) groups.get(key).all.push(calibration);
    else groups.set(key, { newest: calibration, all: [calibration] });
  }
  return [...groups.values()];
}

// Calibrations that can reconstruct, equal ones once.
export function usable(calibrations) {
  const isUsable = ({ state, report }) => state === "ready" && report?.has_extrinsics !== false;
  return distinct(calibrations.filter(isUsable)).map(({ newest }) => newest);
}

// Name and day of a calibration, as in a list to choose from.
export const dated = ({ name, created_at: created }) => (created ? `${name} (${day(created)})` : name);
