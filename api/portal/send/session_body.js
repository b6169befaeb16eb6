// Request that makes a session of a draft whose files are sent.

export function sessionBody({ rows, name, calibrationId, clock, spec }) {
  const used = rows.filter(({ isUsed }) => isUsed);
  const ids = (kind) => used.filter((row) => row.kind === kind).map(({ url }) => url.slice(url.lastIndexOf("/") + 1));
  const cameras = used.filter(({ kind }) => kind === "video").map((row) => ({
    name: row.camera, file: row.name, offset_s: row.offset_s, ...(row.rate !== null && { rate: row.rate }),
  }));
  const [timestamps] = ids("timestamps");
  const now = new Date().toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
  return {
    videos: ids("video"), keypoints: ids("keypoints"), ...(timestamps && { timestamps }),
    calibration_id: calibrationId, manifest: {
      name: name.trim() || `Take of ${now}`, cameras, clock, ...(spec.sync && { sync: spec.sync }),
    },
  };
}
