// The capture that the page shows, and the requests that send it: both come from `captureOf` alone.

import { shownSpec } from "./choices.js";

// Start of the cameras that nobody knows: the service measures their clocks.
export const MEASURED = "measured";

// Description of a draft with its calibration and the choices that the service offers. What the page does not ask for
// has no value here, whatever the draft keeps for the next capture.
export function captureOf({ draft, rig, options }) {
  const files = draft.rows.filter(({ isUsed }) => isUsed);
  const has = (kind) => files.some((row) => row.kind === kind);
  const isMeasured = draft.clock === MEASURED;
  return {
    name: draft.name,
    files,
    views: files.filter(({ kind }) => kind !== "timestamps"),
    calibration: rig.record,
    start: draft.clock,
    clock: has("video") ? (isMeasured ? "declared" : draft.clock) : null,
    needsFrameRate: has("keypoints") && !has("timestamps"),
    frameRate_hz: has("keypoints") && !has("timestamps") ? draft.frameRate_hz : null,
    spec: options ? { ...shownSpec(draft.spec, options), sync: isMeasured ? "auto" : "declared" } : null,
  };
}

// Request that makes a session of a capture whose files are sent.
export function sessionBody({ name, files, calibration, clock, frameRate_hz, spec }) {
  const ids = (kind) => files.filter((row) => row.kind === kind).map(({ url }) => url.slice(url.lastIndexOf("/") + 1));
  const cameras = files.filter(({ kind }) => kind === "video").map((row) => ({
    name: row.camera, file: row.name, offset_s: row.offset_s, ...(row.rate !== null && { rate: row.rate }),
  }));
  const [timestamps] = ids("timestamps");
  const now = new Date().toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
  return {
    videos: ids("video"), keypoints: ids("keypoints"), ...(timestamps && { timestamps }),
    calibration_id: calibration.id,
    manifest: {
      name: name.trim() || `Take of ${now}`, cameras, ...(clock && { clock }), ...(frameRate_hz && { frame_rate_hz: frameRate_hz }),
      sync: spec.sync,
    },
  };
}

// Request that reconstructs it.
export const jobBody = ({ spec }) => spec;
