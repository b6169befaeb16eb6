// Gait and movements of the people as tables; a movement leads to its frame.

import { el, figure } from "../dom.js";
import { goTo, table } from "./tables.js";

// Heading, figure, decimals and unit of each column.
const FIGURES = [
  ["Stride length", "stride_length_m", 2, " m"],
  ["Step width", "step_width_m", 2, " m"],
  ["Cadence", "cadence_steps_per_min", 0, " steps/min"],
  ["Speed", "speed_m_s", 2, " m/s"],
  ["Stance", "stance_percent", 0, " %"],
  ["Double support", "double_support_percent", 0, " %"],
];
const KINDS = { jump: "Jump", squat: "Squat", sit_to_stand: "Stands up from a seat", stand_to_sit: "Sits down" };

/** Panel of gait and movements; null if nobody walks, jumps, squats or sits down. */
export function gaitPanel(description, player) {
  const walkers = description.people.filter(({ gait }) => gait);
  const movers = description.people.filter(({ movements }) => movements?.length > 0);
  if (walkers.length === 0 && movers.length === 0) return null;
  return el("div", {},
    walkers.length === 0 ? null : table("Gait", ["Person", "Side", "Strides", ...FIGURES.map(([heading]) => heading), "Confidence"], walkers.flatMap(gaitRows)),
    movers.length === 0 ? null : table("Movements", ["Person", "Movement", "Frame", "Duration", "Height or depth", "Confidence"],
      movers.flatMap((person) => person.movements.map((movement) => movementRow(description, player, person, movement)))));
}

function gaitRows({ name, gait }) {
  return ["both", "left", "right"].map((side) => el("tr", {},
    el("th", { scope: "row" }, name),
    el("td", {}, side),
    el("td", {}, String(gait[side].stride_time_s?.num ?? 0)),
    FIGURES.map(([, key, decimals, unit]) => el("td", {}, spread(gait[side][key], decimals, unit))),
    el("td", {}, figure(gait.confidence * 100, 0, " %"))));
}

function movementRow({ start_time_s: startS, frame_rate_hz: rate }, player, { name }, movement) {
  const frame = Math.max(0, Math.round((movement.start_s - startS) * rate));
  return el("tr", {},
    el("th", { scope: "row" }, name),
    el("td", {}, KINDS[movement.kind] ?? movement.kind),
    el("td", {}, goTo(player, frame, String(frame), `${name}, ${KINDS[movement.kind] ?? movement.kind}:`)),
    el("td", {}, figure(movement.duration_s, 2, " s")),
    el("td", {}, amount(movement)),
    el("td", {}, figure(movement.confidence * 100, 0, " %")));
}

function amount({ height_by_flight_m: byFlightM, height_by_hips_m: byHipsM, depth_m: depthM }) {
  if (depthM !== undefined) return figure(depthM, 2, " m deep");
  return [byFlightM === undefined ? null : figure(byFlightM, 2, " m by flight time"), figure(byHipsM, 2, " m by the hips")]
    .filter((text) => text !== null).join(", ");
}

/** Mean, and the standard deviation if there is one. */
function spread(value, decimals, unit) {
  if (!value) return "–";
  return value.std === null ? figure(value.mean, decimals, unit) : `${figure(value.mean, decimals)} ± ${figure(value.std, decimals, unit)}`;
}
