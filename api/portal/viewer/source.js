// Source of a viewer's data by the web API. Anything with the same methods will do, such as data embedded in a report.

/**
 * A source has
 * - `description()`: promise of the description of the motion, as of GET /v1/jobs/{id}/motion/description;
 * - `frames(from, to, signal)`: promise of an `ArrayBuffer` as of GET /v1/jobs/{id}/motion;
 * - `video(camera)`: promise of `{ url, startS }`, the address of a camera's video that a browser can play and the time of
 *   its first frame on the video's own clock; null if there is none;
 * - `characters(signal)`, if it has files of a character in motion: promise of those, one a person, `{ id, name, numBytes, read }`.
 *   `read(from, to, { signal, onbytes })` is a promise of an `ArrayBuffer` with bytes of the file; `onbytes` is told of bytes that came.
 */
export class ApiSource {
  #videos;
  #hasCharacter;

  /**
   * `cameras` are those of the session, which link their videos; `addressed` completes addresses, as by the secret of a link;
   * `hasCharacter`: the job moves a character.
   */
  constructor(jobId, cameras = [], addressed = (address) => address, { hasCharacter = false } = {}) {
    this.job = `/v1/jobs/${encodeURIComponent(jobId)}`;
    this.address = `${this.job}/motion`;
    this.addressed = addressed;
    this.#hasCharacter = hasCharacter;
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

  async characters(signal) {
    if (!this.#hasCharacter) return [];
    const { results } = await (await get(this.addressed(`${this.job}/results`), signal)).json();
    const isShown = ({ kind, person, media_type: type }) => kind === "character" && person !== null && type === "model/gltf-binary";
    return results.filter(isShown).map(({ person, name, link, num_bytes: numBytes }) => {
      // The page may ask its own service alone, not a store of files.
      const address = this.addressed(`${link}?redirect=false`);
      return { id: Number(person.split("-").at(-1)), name, numBytes, read: (from, to, how) => part(address, from, to, how) };
    });
  }
}

/** Bytes `from` to `to` of a file. */
async function part(address, from, to, { signal, onbytes = () => {} }) {
  const answer = await get(address, signal, { Range: `bytes=${from}-${to - 1}` });
  const bytes = new Uint8Array(to - from);
  const reader = answer.body.getReader();
  let place = 0;
  for (let { done, value } = await reader.read(); !done; { done, value } = await reader.read()) {
    if (place + value.length <= bytes.length) bytes.set(value, place);
    place += value.length;
    onbytes(value.length);
  }
  if (place !== bytes.length) throw new Error("The service sent another part of the file than it was asked for.");
  return bytes.buffer;
}

async function get(address, signal, headers = {}) {
  const answer = await fetch(address, { signal, headers });
  if (answer.ok) return answer;
  const problem = await answer.json().catch(() => ({}));
  throw new Error([problem.detail ?? `The service answers with ${answer.status}.`, problem.hint].filter(Boolean).join(" "));
}
