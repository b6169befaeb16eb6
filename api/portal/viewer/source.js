// Source of a viewer's data by the web API. Anything with the same methods will do, such as data embedded in a report.

/**
 * A source has
 * - `description()`: promise of the description of the motion, as of GET /v1/jobs/{id}/motion/description;
 * - `frames(from, to, signal)`: promise of an `ArrayBuffer` as of GET /v1/jobs/{id}/motion;
 * - `video(camera)`: promise of `{ url, startS }`, the address of a camera's video that a browser can play and the time of
 *   its first frame on the video's own clock; null if there is none.
 */
export class ApiSource {
  #videos;

  /** `cameras` are those of the session, which link their videos; `addressed` completes addresses, as by the secret of a link. */
  constructor(jobId, cameras = [], addressed = (address) => address) {
    this.address = `/v1/jobs/${encodeURIComponent(jobId)}/motion`;
    this.addressed = addressed;
    this.#videos = new Map(cameras.map(({ name, video_link: url, media_start_s: startS }) => [name, url ? { url: addressed(url), startS: startS ?? 0 } : null]));
  }

  async video(camera) {
    return this.#videos.get(camera.name) ?? null;
  }

  async description() {
    return (await get(this.addressed(`${this.address}/description`))).json();
  }

  async frames(from, to, signal) {
    return (await get(this.addressed(`${this.address}?from=${from}&to=${to}`), signal)).arrayBuffer();
  }
}

async function get(address, signal) {
  const answer = await fetch(address, { signal });
  if (answer.ok) return answer;
  const problem = await answer.json().catch(() => ({}));
  throw new Error([problem.detail ?? `The service answers with ${answer.status}.`, problem.hint].filter(Boolean).join(" "));
}
