// Entry of the viewer: `mount(element, source)` shows a job's motion, `mountPair` two jobs on the same clock.

import { el } from "./dom.js";
import { about, originOf } from "./motion/nearby.js";
import { MotionStore } from "./motion/store.js";
import { Figures } from "./panels/figures.js";
import { transport } from "./panels/transport.js";
import { Player, rangeOf } from "./player.js";
import { Wall } from "./video/wall.js";
import { Viewer } from "./viewer.js";

/**
 * Show a job's motion in an element.
 *
 * `source` is described in source.js. Returns a promise of the viewer, which has `player` and `close()`; it is rejected,
 * and the element tells why, if the motion can't be read.
 */
export async function mount(element, source) {
  const [description] = await describe(element, [source]);
  return viewJob(element, source, description, new Player(rangeOf([description])));
}

/**
 * Show two jobs of a session side by side, with one play head on the session's clock.
 *
 * Returns a promise of the first job's viewer; it closes both.
 */
export async function mountPair(element, sources, titles) {
  const descriptions = await describe(element, sources);
  const player = new Player(rangeOf(descriptions));
  const places = titles.map((title) => el("section", { class: "look-side", "aria-label": title }, el("h2", {}, title), el("div")));
  // One play head, one row of buttons: above both, so that they are in sight with the pictures.
  element.replaceChildren(el("div", { class: "look-pair" }, el("div", { class: "look-viewer look-shared" }, transport(player)), places));
  const viewers = places.map((place, number) => viewJob(place.lastChild, sources[number], descriptions[number], player, { isLeader: number === 0, hasTransport: false }));
  player.mustWait = (now) => viewers.some((viewer) => viewer.isLate(now));
  linkOrbits(viewers);
  const [first, second] = viewers;
  first.follower = second;
  return first;
}

function viewJob(element, source, description, player, options) {
  return new Viewer(element, new MotionStore(description, source), player, {
    source, videos: (viewer) => new Wall(viewer, source), figures: (viewer, shown) => new Figures(viewer, shown), ...options,
  });
}

async function describe(element, sources) {
  element.replaceChildren(el("p", { class: "look-loading", role: "status" }, "Loading the motion …"));
  try {
    const descriptions = await Promise.all(sources.map((source) => source.description()));
    const origin = originOf(descriptions[0]);
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
