// Figures of a take: tables of people and cameras, plots, gait, clocks, warnings.

import { clocksPanel } from "./clocks.js";
import { gaitPanel } from "./gait.js";
import { Plots } from "./plots.js";
import { goTo, table } from "./tables.js";
import { tabs } from "./tabs.js";
import { el, figure } from "../dom.js";

/** Tabs of figures of a viewer's store, which are in the order of how often they are needed. */
export class Figures {
  #plots;

  /** `shown` is that of the figures before these, for the same tab and plot. */
  constructor({ store, player, strips }, { tab = null, kind } = {}) {
    const { description } = store;
    this.#plots = new Plots(store, player, { kind });
    const clocks = clocksPanel(description);
    const gait = gaitPanel(description, player);
    const { warnings } = description;
    this.element = tabs([
      { id: "people", label: "People", element: peopleTable(description, player, strips.spots) },
      { id: "plots", label: "Plots", element: this.#plots.element, onshow: () => this.#plots.draw(true) },
      ...(gait ? [{ id: "gait", label: "Gait and movement", element: gait }] : []),
      { id: "cameras", label: "Cameras", element: camerasTable(description) },
      ...(clocks ? [{ id: "clocks", label: "Clocks", element: clocks }] : []),
      ...(warnings.length > 0 ? [{ id: "warnings", label: `Warnings (${warnings.length})`, element: el("ul", { class: "look-warnings" }, warnings.map((warning) => el("li", {}, warning))) }] : []),
    ], tab);
  }

  /** Tab and kind of plot that are shown. */
  get shown() {
    return { tab: this.element.dataset.shown, kind: this.#plots.kind };
  }

  focus() {
    this.element.querySelector("[aria-selected=true]").focus({ preventScroll: true });
  }

  close() {
    this.#plots.close();
  }
}

/** Table of the people: where they are and how well they were seen. */
function peopleTable(description, player, spots) {
  const rate = description.frame_rate_hz;
  const rows = description.people.map((person, number) => el("tr", {},
    el("th", { scope: "row" }, el("span", { class: "look-swatch" }), person.name),
    el("td", {}, goTo(player, person.start_frame, `${person.start_frame} – ${person.start_frame + person.num_frames - 1}`, `${person.name}, frames`)),
    el("td", {}, figure(person.num_frames / rate, 1, " s")),
    el("td", {}, figure((person.coverage ?? NaN) * 100, 0, " %")),
    el("td", {}, figure(person.reprojection_error_px, 1, " px")),
    el("td", {}, figure(person.stature_m, 2, " m")),
    el("td", {}, figure(person.identity.confidence * 100, 0, " %"), doubts(player, person)),
    el("td", {}, String(person.contacts.length)),
    el("td", {}, spots[number].length === 0 ? "none" : goTo(player, spots[number][0].from, String(spots[number].length), `${person.name}, spots to look at:`))));
  rows.forEach((row, number) => row.style.setProperty("--tint", description.people[number].color));
  return table("People", ["Person", "Frames", "Length", "Measured", "Reprojection error", "Stature", "Identity", "Foot contacts", "Spots to look at"], rows);
}

/** Table of the cameras: pictures, lens, error. */
function camerasTable(description) {
  const { by_camera: errors } = description.reprojection_error_px;
  return table(description.is_refined ? "Cameras (refined)" : "Cameras", ["Camera", "Picture", "Focal length", "Lens", "Median error", "Video"],
    description.cameras.map((camera) => el("tr", {},
      el("th", { scope: "row" }, camera.name),
      el("td", {}, `${camera.size_px[0]} × ${camera.size_px[1]}`),
      el("td", {}, figure(camera.matrix[0][0], 0, " px")),
      el("td", {}, camera.lens === "fisheye" ? "fisheye" : camera.distortion.some((value) => value !== 0) ? "distorted" : "ideal"),
      el("td", {}, figure(errors[camera.name] ?? NaN, 1, " px")),
      el("td", {}, camera.video ?? "–"))));
}

function doubts(player, { name, identity }) {
  return identity.doubts.map(({ frame, confidence }) => el("span", {}, " ", goTo(player, frame, `${figure(confidence * 100, 0, " %")} at ${frame}`, `${name}, identity:`)));
}
