// Entry of the viewer: `mount(element, source)` shows a job's motion, `mountPair` two jobs on the same clock.

import { VIEWER } from "../shared/strings/viewer.js";
import { transport } from "./controls.js";
import { el } from "./dom.js";
import { FigureTabs } from "./figures.js";
import { about, chooseOrigin } from "./motion/records.js";
import { MotionStore } from "./motion/store.js";
import { Player, frameRange } from "./player.js";
import { Wall } from "./video/wall.js";
import { Viewer } from "./viewer.js";

/**
 * Show a job's motion in an element.
 *
 * `source` has the methods of `ApiSource`, `options` are of `Viewer`. Returns a promise of the viewer, which has `player` and `close()`; it is rejected,
 * and the element tells why, if the motion can't be read.
 */
export async function mount(element, source, options) {
  const [description] = await describe(element, [source]);
  return viewJob(element, source, description, new Player(frameRange([description])), options);
}

/**
 * Show two jobs of a session side by side, with one play head on the session's clock.
 *
 * Returns a promise of the first job's viewer; it closes both.
 */
export async function mountPair(element, sources, titles) {
  const descriptions = await describe(element, sources);
  const player = new Player(frameRange(descriptions));
  const places = titles.map((title) => el("section", { class: "look-side", "aria-label": title }, el("h2", {}, title), el("div")));
  // One play head, one row of buttons: above both, so that they are in sight with the pictures.
  element.replaceChildren(el("div", { class: "look-pair" }, el("div", { class: "look-viewer look-shared look-row" }, transport(player)), places));
  const viewers = places.map((place, number) => viewJob(place.lastChild, sources[number], descriptions[number], player, { isLeader: number === 0, hasTransport: false }));
  player.mustWait = (now) => viewers.some((viewer) => viewer.isLate(now));
  linkOrbits(viewers);
  const [first, second] = viewers;
  element.querySelector(".look-shared").append(first.tools.element);
  first.follower = second;
  return first;
}

function viewJob(element, source, description, player, options) {
  return new Viewer(element, new MotionStore(description, source), player, {
    source, videos: (viewer) => new Wall(viewer, source), figures: (viewer, shown) => new FigureTabs(viewer, shown), ...options,
  });
}

async function describe(element, sources) {
  element.replaceChildren(el("p", { class: "look-loading", role: "status" }, VIEWER.loadingMotion));
  try {
    const descriptions = await Promise.all(sources.map((source) => source.description()));
    const origin = chooseOrigin(descriptions[0]);
    return descriptions.map((description) => about(description, origin));
  } catch (error) {
    element.replaceChildren(el("p", { class: "look-problem", role: "alert" }, error.message));
    throw error;
  }
}

/** Turn the other view when one is turned. */
function linkOrbits(viewers) {
  const stages = viewers.flatMap(({ view }) => (view ? [view.stage] : []));
  let isCopying = false;
  for (const stage of stages) {
    stage.controls.addEventListener("change", () => {
      if (isCopying) return;
      isCopying = true;
      for (const other of stages) if (other !== stage) other.stand(stage.standpoint);
      isCopying = false;
    });
  }
}

// Source of a viewer's data by the web API. Anything with the same methods will do, such as data embedded in a report.

/**
 * A source has
 * - `description()`: promise of the description of the motion, from GET /v1/jobs/{id}/motion/description;
 * - `frames(from, to, signal)`: promise of an `ArrayBuffer` from GET /v1/jobs/{id}/motion;
 * - `video(camera)`: promise of `{ url, startS }`, the address of a camera's video that a browser can play and the time of
 *   its first frame on the video's own clock; null if there is none;
 * - `characters(signal)`, if it has files of a character in motion: promise of those, one a person, `{ id, name, numBytes, read }`.
 *   `read(from, to, { signal, onbytes })` is a promise of an `ArrayBuffer` with bytes of the file; `onbytes` is told of bytes that came.
 */
export class ApiSource {
  #videos;
  #hasCharacter;

  /**
   * `cameras` are the session's cameras, with the URLs of their videos; `addressed` completes addresses, as by the secret of a link;
   * `hasCharacter`: the job moves a character. `fileRateHz` is the frame rate of the job's files, null for the capture's.
   */
  constructor(jobId, cameras = [], addressed = (address) => address, { hasCharacter = false, fileRateHz = null } = {}) {
    this.fileRateHz = fileRateHz;
    this.job = `/v1/jobs/${encodeURIComponent(jobId)}`;
    this.address = `${this.job}/motion`;
    this.addressed = addressed;
    this.#hasCharacter = hasCharacter;
    this.#videos = new Map(cameras.map(({ name, video_url: url, media_start_s: startS }) => [name, url ? { url: addressed(url), startS: startS ?? 0 } : null]));
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
    return results.filter(isShown).map(({ person: id, name, url, num_bytes: numBytes }) => {
      // The page may ask its own service alone, not a store of files.
      const address = this.addressed(`${url}?redirect=false`);
      return { id, name, numBytes, read: (from, to, how) => part(address, from, to, how) };
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
  if (place !== bytes.length) throw new Error(VIEWER.fileChanged);
  return bytes.buffer;
}

async function get(address, signal, headers = {}) {
  const answer = await fetch(address, { signal, headers });
  if (answer.ok) return answer;
  const problem = await answer.json().catch(() => ({}));
  throw new Error([problem.detail ?? VIEWER.answers(answer.status), problem.hint].filter(Boolean).join(" "));
}
