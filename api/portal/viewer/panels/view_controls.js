// Controls over the 3D view: what is shown, from where, and the keys.

import { el } from "../dom.js";
import { KEYS } from "../keys.js";

const DIRECTIONS = [["Fit", null], ["Top", "top"], ["Front", "front"], ["Side", "side"]];
const LAYERS = [["body", "Bodies", true], ["skeleton", "Bones", false], ["trails", "Trails", true], ["contacts", "Foot contacts", true], ["cameras", "Cameras", true], ["names", "Names", true]];

/** `onoptions` is called with what is to be shown whenever that changes; `shapes` is the choice of what people look like. */
export function viewControls(viewer, shapes, onoptions) {
  const options = Object.fromEntries(LAYERS.map(([name, , isShown]) => [name, isShown]));
  const layers = LAYERS.map(([name, label]) => {
    const box = el("input", { type: "checkbox", checked: options[name], onchange: () => { options[name] = box.checked; onoptions(options); } });
    return el("label", {}, box, ` ${label}`);
  });
  const directions = directionBar(viewer, { Fit: "Fit the view (F)" });
  const element = el("div", { class: "look-overlay" }, directions.element,
    el("div", { class: "look-bar" }, menu("Show", [layers[0], shapes, ...layers.slice(1)]), menu("Keys", keys())));
  return { element, showSeen: directions.showSeen };
}

/** Buttons and a choice of where the view is from; `viewer` has `fit`, `see` and `description.cameras`, `titles` are of buttons. */
export function directionBar(viewer, titles = {}) {
  const seen = el("select", { class: "look-select", "aria-label": "View", onchange: () => viewer.see(seen.value === "" ? null : Number(seen.value)) },
    el("option", { value: "" }, "Orbit"),
    viewer.description.cameras.map(({ name }, number) => el("option", { value: number }, `Through ${name}`)));
  const element = el("div", { class: "look-bar", role: "group", "aria-label": "View" },
    DIRECTIONS.map(([label, direction]) => el("button", { type: "button", class: "look-button", title: titles[label] ?? null, onclick: () => viewer.fit(direction) }, label)),
    seen);
  return { element, showSeen: (number) => { seen.value = number === null ? "" : String(number); } };
}

function menu(label, content) {
  const element = el("details", { class: "look-menu" }, el("summary", { class: "look-button" }, label),
    // On a small screen the sheet scrolls: the keyboard has to get there.
    el("div", { class: "look-sheet", tabindex: 0, role: "group", "aria-label": label }, content));
  element.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || !element.open) return;
    element.open = false;
    element.firstChild.focus();
  });
  element.addEventListener("focusout", (event) => { if (event.relatedTarget && !element.contains(event.relatedTarget)) element.open = false; });
  return element;
}

function keys() {
  return el("dl", { class: "look-keys", id: "look-keys" }, KEYS.flatMap(([key, effect]) => [el("dt", {}, key), el("dd", {}, effect)]));
}
