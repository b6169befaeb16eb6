// Buttons of the play head: play, step, speed, loop, and where it is.

import { clockText, el, icon, iconButton } from "../dom.js";
import { SPEEDS } from "../player.js";

export function transport(player) {
  const play = iconButton("play", "Play", () => player.toggle(), { class: "look-button look-icon look-play" });
  const loop = iconButton("loop", "Loop", () => player.setLooping(!player.isLooping), { "aria-pressed": "true" });
  const speed = el("select", { class: "look-select", "aria-label": "Speed", onchange: () => player.setSpeed(Number(speed.value)) },
    SPEEDS.map((value) => el("option", { value, selected: value === 1 }, `${value} ×`)));
  const where = el("output", { class: "look-where" });
  const element = el("div", { class: "look-transport", role: "group", "aria-label": "Playing" },
    iconButton("start", "Go to the first frame (Home)", () => { player.pause(); player.seek(0); }),
    iconButton("back", "One frame back (Left)", () => player.step(-1)),
    play,
    iconButton("forward", "One frame forward (Right)", () => player.step(1)),
    iconButton("end", "Go to the last frame (End)", () => { player.pause(); player.seek(player.numFrames - 1); }),
    loop, speed, where);
  const showState = () => {
    const label = player.isPlaying ? "Pause (Space)" : "Play (Space)";
    play.replaceChildren(icon(player.isPlaying ? "pause" : "play"));
    play.setAttribute("aria-label", label);
    play.title = label;
    loop.setAttribute("aria-pressed", String(player.isLooping));
    speed.value = String(player.speed);
  };
  const showPlace = () => {
    const source = player.firstSourceFrame === 0 ? "" : ` (${player.firstSourceFrame + player.frame} of the source)`;
    where.textContent = `${clockText(player.frame / player.rateHz)} / ${clockText((player.numFrames - 1) / player.rateHz)} · frame ${player.frame} of ${player.numFrames}${source}`;
  };
  // Screen readers read a changing output again and again: not while it runs.
  player.addEventListener("change", () => { showState(); where.setAttribute("aria-live", player.isPlaying ? "off" : "polite"); });
  player.addEventListener("time", showPlace);
  showState();
  showPlace();
  return element;
}
