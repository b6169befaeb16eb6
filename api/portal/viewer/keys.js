// Keyboard of the viewer.

import { VIEWER } from "../shared/strings/viewer.js";
import { el } from "./dom.js";

const TURN_RAD = 0.12;

/** Sheet of all keys, shown by `showModal`. */
export function keySheet() {
  const sheet = el("dialog", { class: "look-sheet look-keys", "aria-label": VIEWER.keys },
    el("dl", { tabindex: 0 }, VIEWER.keyTable.flatMap(([key, effect]) => [el("dt", {}, key), el("dd", {}, effect)])),
    el("button", { type: "button", class: "look-button", onclick: () => sheet.close() }, VIEWER.close));
  return sheet;
}

/** Listen to the keys while the focus is in the viewer or nowhere; returns a function that ends it. */
export function listenToKeys(viewer) {
  if (!viewer.isLeader) return () => {};
  const listen = (event) => {
    const { target } = event;
    const isElsewhere = target !== document.body && !(viewer.element.closest(".look-pair") ?? viewer.element).contains(target);
    if (isElsewhere || viewer.sheet.open || event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    if (isBusy(target, event.key)) return;
    if (act(viewer, event)) event.preventDefault();
  };
  document.addEventListener("keydown", listen);
  return () => document.removeEventListener("keydown", listen);
}

/** True if a control needs the key itself. */
function isBusy(target, key) {
  if (target.matches?.("input:not([type=range]):not([type=checkbox]), textarea, select, [contenteditable]")) return true;
  if (key === " " || key === "Enter") return target.matches?.("button, input[type=checkbox], a, summary") ?? false;
  if (target.matches?.("input[type=range]")) return ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"].includes(key);
  if (target.matches?.("[role=tab], .look-scroll, .look-sheet")) return key.startsWith("Arrow") || key === "Home" || key === "End";
  return false;
}

function act(viewer, { key, shiftKey }) {
  const { player } = viewer;
  const orbit = (...angles) => viewer.view?.stage.orbit(...angles);
  const actions = {
    " ": () => player.toggle(),
    ArrowLeft: () => player.step(shiftKey ? -10 : -1),
    ArrowRight: () => player.step(shiftKey ? 10 : 1),
    Home: () => { player.pause(); player.seek(0); },
    End: () => { player.pause(); player.seek(player.numFrames - 1); },
    n: () => viewer.strips.goToConcern(1),
    p: () => viewer.strips.goToConcern(-1),
    y: () => viewer.strips.accept(viewer.editor),
    c: () => viewer.correct?.(),
    f: () => (shiftKey ? viewer.fillScreen() : viewer.fit()),
    l: () => player.setLooping(!player.isLooping),
    "-": () => viewer.changeSpeed(-1),
    "+": () => viewer.changeSpeed(1),
    "=": () => viewer.changeSpeed(1),
    a: () => orbit(-TURN_RAD, 0),
    d: () => orbit(TURN_RAD, 0),
    w: () => orbit(0, -TURN_RAD),
    s: () => orbit(0, TURN_RAD),
    q: () => orbit(0, 0, 0.88),
    e: () => orbit(0, 0, 1 / 0.88),
    0: () => viewer.see(null),
    i: () => player.setSpan({ from: player.frame }),
    o: () => player.setSpan({ to: player.frame }),
    x: () => player.setSpan(),
    v: () => viewer.nextLayout(),
    "?": () => viewer.sheet.showModal(),
  };
  if (/^[1-9]$/.test(key)) {
    viewer.see(Number(key) - 1);
    return true;
  }
  const action = actions[key.length === 1 ? key.toLowerCase() : key];
  action?.();
  return action !== undefined;
}
