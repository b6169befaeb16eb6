// Text alternative: people and cameras as tables of figures, and the warnings of the take.

import { el, figure } from "../dom.js";

/** Table of the people: where they are and how well they were seen. */
export function peopleTable(description, player, spots) {
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
export function camerasTable(description) {
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

/** Warnings of the take; null without any. */
export function warningList(description) {
  if (description.warnings.length === 0) return null;
  return el("ul", { class: "look-warnings" }, description.warnings.map((warning) => el("li", {}, warning)));
}

function doubts(player, { name, identity }) {
  return identity.doubts.map(({ frame, confidence }) => el("span", {}, " ", goTo(player, frame, `${figure(confidence * 100, 0, " %")} at ${frame}`, `${name}, identity:`)));
}

/** Button that goes to a frame; `about` tells it from the others in its name. */
export function goTo(player, frame, text, about) {
  return el("button", { type: "button", class: "look-link", title: `Go to frame ${frame}`, "aria-label": `${about} ${text}`, onclick: () => { player.pause(); player.seek(frame); } }, text);
}

/** Table with a caption, in a box that scrolls. */
export function table(caption, heads, rows) {
  return el("div", { class: "look-scroll", tabindex: 0, role: "group", "aria-label": caption },
    el("table", {}, el("caption", {}, caption),
      el("thead", {}, el("tr", {}, heads.map((head) => el("th", { scope: "col" }, head)))), el("tbody", {}, rows)));
}
