// Tables of figures, and buttons in them that go to a frame.

import { el } from "../dom.js";

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
