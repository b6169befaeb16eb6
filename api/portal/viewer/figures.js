// Figures of a take: tables of people and cameras, plots, gait, clocks, warnings.

import { html, render, svg } from "../shared/lit.js";
import { COMMON } from "../shared/strings/common.js";
import { FIGURES } from "../shared/strings/viewer.js";
import { el, figure } from "./dom.js";
import { Plots } from "./plots.js";

/** Tabs of figures of a viewer's store, which are in the order of how often they are needed. */
export class FigureTabs {
  #plots;

  /** `shown` is the tab of the figures before these, for the same tab and plot. */
  constructor({ store, player, strips }, { tab = null, kind } = {}) {
    const { description } = store;
    this.#plots = new Plots(store, player, { kind });
    const clocks = clocksPanel(description);
    const gait = gaitPanel(description, player);
    const { warnings } = description;
    this.element = tabs([
      { id: "people", label: FIGURES.tabs.people, element: peopleTable(description, player, strips.spots) },
      { id: "plots", label: FIGURES.tabs.plots, element: this.#plots.element, onshow: () => this.#plots.draw(true) },
      ...(gait ? [{ id: "gait", label: FIGURES.tabs.gait, element: gait }] : []),
      ...(description.cameras.length ? [{ id: "cameras", label: FIGURES.tabs.cameras, element: camerasTable(description) }] : []),
      ...(clocks ? [{ id: "clocks", label: FIGURES.tabs.clocks, element: clocks }] : []),
      ...(warnings.length > 0 ? [{ id: "warnings", label: FIGURES.warnings(warnings.length), element: el("ul", { class: "look-warnings" }, warnings.map(({ message, code }) => el("li", {}, `${message} `, code ? moreLink(code) : null))) }] : []),
    ], tab);
  }

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

/** Link to what a warning means, and what to do. */
function moreLink(code) {
  return el("a", { href: `/help/problems#${code}`, target: "_blank", rel: "noopener", "aria-label": COMMON.moreAbout(code) }, COMMON.more);
}

/** Table of the people: where they are and how well they were seen. */
function peopleTable(description, player, spots) {
  const rate = description.frame_rate_hz;
  const rows = description.people.map((person, number) => el("tr", {},
    el("th", { scope: "row" }, el("span", { class: "look-swatch" }), person.name),
    el("td", {}, goTo(player, person.start_frame, `${person.start_frame} – ${person.start_frame + person.num_frames - 1}`, FIGURES.framesOf(person.name))),
    el("td", {}, figure(person.num_frames / rate, 1, " s")),
    el("td", {}, figure((person.coverage ?? NaN) * 100, 0, " %")),
    el("td", {}, figure(person.reprojection_error_px, 1, " px")),
    el("td", {}, figure(person.stature_m, 2, " m")),
    el("td", {}, figure(person.identity.confidence * 100, 0, " %"), doubts(player, person)),
    el("td", {}, String(person.contacts.length)),
    el("td", {}, spots[number].length === 0 ? FIGURES.none : goTo(player, spots[number][0], String(spots[number].length), FIGURES.spotsOf(person.name)))));
  rows.forEach((row, number) => row.style.setProperty("--tint", description.people[number].color));
  return table(FIGURES.tabs.people, FIGURES.people, rows);
}

function camerasTable(description) {
  const { by_camera: errors } = description.reprojection_error_px;
  return table(description.is_refined ? FIGURES.refined : FIGURES.tabs.cameras, FIGURES.cameras,
    description.cameras.map((camera) => el("tr", {},
      el("th", { scope: "row" }, camera.name),
      el("td", {}, `${camera.size_px[0]} × ${camera.size_px[1]}`),
      el("td", {}, figure(camera.matrix[0][0], 0, " px")),
      el("td", {}, FIGURES.lenses[camera.lens === "fisheye" ? "fisheye" : camera.distortion.some((value) => value !== 0) ? "distorted" : "ideal"]),
      el("td", {}, figure(errors[camera.name] ?? NaN, 1, " px")),
      el("td", {}, camera.video ?? FIGURES.unknown))));
}

function doubts(player, { name, identity }) {
  return identity.doubts.map(({ frame, confidence }) => el("span", {}, " ", goTo(player, frame, FIGURES.doubt(figure(confidence * 100, 0, " %"), frame), FIGURES.identityOf(name))));
}

// Tables of figures, and buttons in them that go to a frame.

/** Button that goes to a frame; `about` tells it from the others in its name. */
export function goTo(player, frame, text, about) {
  return el("button", { type: "button", class: "look-link", title: FIGURES.goTo(frame), "aria-label": `${about} ${text}`, onclick: () => { player.pause(); player.seek(frame); } }, text);
}

/** Table with a caption, in a box that scrolls. */
export function table(caption, heads, rows) {
  return el("div", { class: "look-scroll", tabindex: 0, role: "group", "aria-label": caption },
    el("table", {}, el("caption", {}, caption),
      el("thead", {}, el("tr", {}, heads.map((head) => el("th", { scope: "col" }, head)))), el("tbody", {}, rows)));
}

// Gait and movements of the people as tables; a movement leads to its frame.

// Figure, decimals and unit of each column.
const GAIT_FIGURES = [
  ["stride_length_m", 2, " m"],
  ["step_width_m", 2, " m"],
  ["cadence_steps_per_min", 0, FIGURES.stepsPerMinute],
  ["speed_m_s", 2, " m/s"],
  ["stance_percent", 0, " %"],
  ["double_support_percent", 0, " %"],
];

/** Panel of gait and movements; null without walks, jumps, squats and sitting. */
function gaitPanel(description, player) {
  const walkers = description.people.filter(({ gait }) => gait);
  const movers = description.people.filter(({ movements }) => movements?.length > 0);
  if (walkers.length === 0 && movers.length === 0) return null;
  return el("div", {},
    walkers.length === 0 ? null : table(FIGURES.gait, [...FIGURES.gaitHead, ...FIGURES.gaitFigures, FIGURES.confidence], walkers.flatMap(gaitRows)),
    movers.length === 0 ? null : table(FIGURES.movements, FIGURES.movementHead,
      movers.flatMap((person) => person.movements.map((movement) => movementRow(description, player, person, movement)))));
}

function gaitRows({ name, gait }) {
  return ["both", "left", "right"].map((side) => el("tr", {},
    el("th", { scope: "row" }, name),
    el("td", {}, FIGURES.sides[side]),
    el("td", {}, String(gait[side].stride_time_s?.num ?? 0)),
    GAIT_FIGURES.map(([key, decimals, unit]) => el("td", {}, spread(gait[side][key], decimals, unit))),
    el("td", {}, figure(gait.confidence * 100, 0, " %"))));
}

function movementRow({ start_time_s: startS, frame_rate_hz: rate }, player, { name }, movement) {
  const frame = Math.max(0, Math.round((movement.start_s - startS) * rate));
  const kind = FIGURES.movementKinds[movement.kind] ?? movement.kind;
  return el("tr", {},
    el("th", { scope: "row" }, name),
    el("td", {}, kind),
    el("td", {}, goTo(player, frame, String(frame), FIGURES.movementOf(name, kind))),
    el("td", {}, figure(movement.duration_s, 2, " s")),
    el("td", {}, amount(movement)),
    el("td", {}, figure(movement.confidence * 100, 0, " %")));
}

function amount({ height_by_flight_m: byFlightM, height_by_hips_m: byHipsM, depth_m: depthM }) {
  if (depthM !== undefined) return figure(depthM, 2, FIGURES.deep);
  return [byFlightM === undefined ? null : figure(byFlightM, 2, FIGURES.byFlight), figure(byHipsM, 2, FIGURES.byHips)]
    .filter((text) => text !== null).join(", ");
}

/** Mean, and the standard deviation if there is one. */
function spread(value, decimals, unit) {
  if (!value) return FIGURES.unknown;
  return value.std === null ? figure(value.mean, decimals, unit) : `${figure(value.mean, decimals)} ± ${figure(value.std, decimals, unit)}`;
}

// Measured clocks: the offset of each camera, and how well other offsets would fit.

const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM] = [420, 150, 44, 10, 10, 26];

/** Panel of the clocks that the job measured; null if it took the declared times. */
function clocksPanel({ clocks }) {
  if (!clocks) return null;
  const panel = el("div", { class: "look-clocks" });
  render(html`<p class="look-quiet">${FIGURES.clocks}</p>
    <div class="look-curves">${clocks.map((clock) => html`<figure>${curve(clock)}<figcaption>${caption(clock)}</figcaption></figure>`)}</div>`, panel);
  return panel;
}

function caption({ camera, offset_s: offsetS, sigma_s: sigmaS, rate }) {
  const spread = sigmaS === null ? FIGURES.spreadUnknown : FIGURES.spread(figure(sigmaS * 1000, 1));
  const drift = (1 - rate) * 1e6;
  const fast = Math.abs(drift) < 0.05 ? "" : FIGURES.drift(drift > 0, figure(Math.abs(drift), 1));
  return html`<b>${camera}</b>${FIGURES.startsAt(figure(offsetS, 3), spread, fast)}`;
}

function curve({ camera, offset_s: foundS, sigma_s: sigmaS, offsets_s: offsetsS, disagreement }) {
  const [lowS, highS] = [Math.min(foundS, ...offsetsS), Math.max(foundS, ...offsetsS)];
  const x = (valueS) => LEFT + ((valueS - lowS) / Math.max(highS - lowS, 1e-6)) * (WIDTH - LEFT - RIGHT);
  const y = (share) => TOP + (1 - share) * (HEIGHT - TOP - BOTTOM);
  const seconds = Array.from({ length: Math.max(0, Math.floor(highS) - Math.ceil(lowS) + 1) }, (_, number) => Math.ceil(lowS) + number);
  const spread = Math.max(2, x(foundS + (sigmaS ?? 0)) - x(foundS - (sigmaS ?? 0)));
  const points = offsetsS.map((valueS, number) => [x(valueS), y(disagreement[number]), valueS]);
  return html`<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label=${FIGURES.clockCurve(camera)}>
    <path class="look-axis" d="M${LEFT},${y(0)}H${WIDTH - RIGHT}M${LEFT},${y(1)}H${WIDTH - RIGHT}"></path>
    ${[0, 0.5, 1].map((share) => svg`<text x=${LEFT - 6} y=${y(share) + 4} text-anchor="end">${100 * share} %</text>`)}
    ${seconds.map((second) => svg`<text x=${x(second)} y=${HEIGHT - 8} text-anchor="middle">${second} s</text>`)}
    <rect class="look-found" x=${x(foundS) - spread / 2} y=${y(1)} width=${spread} height=${y(0) - y(1)}></rect>
    <path class="look-curve" d=${path(points)}></path>
  </svg>`;
}

// The curve is broken where no offset was compared.
function path(points) {
  const steps = points.slice(1).map(([, , valueS], number) => valueS - points[number][2]).sort((one, other) => one - other);
  const usual = steps[Math.floor(steps.length / 2)] ?? 0;
  return points.map(([x, y, valueS], number) => {
    const isNew = number === 0 || valueS - points[number - 1][2] > 1.5 * usual;
    return `${isNew ? "M" : "L"}${x.toFixed(1)},${y.toFixed(1)}`;
  }).join("");
}

// Tabs, by the pattern of WAI-ARIA: arrows move between them, only the chosen one is in the order of Tab.

let numGroups = 0;

/** Tabs of `{ id, label, element, onshow }`; `data-shown` of the element is the id of the one that is shown: at first `first`, or else the first. */
export function tabs(items, first = null) {
  const group = `look-tabs-${++numGroups}`;
  const buttons = items.map(({ id, label }, number) => el("button", {
    type: "button", role: "tab", id: `${group}-${id}`, "aria-controls": `${group}-panel-${id}`, class: "look-tab", onclick: () => show(number),
  }, label));
  const panels = items.map(({ id, element }) => el("div", { role: "tabpanel", id: `${group}-panel-${id}`, "aria-labelledby": `${group}-${id}` }, element));
  const list = el("div", { role: "tablist", class: "look-tablist", "aria-label": FIGURES.title }, buttons);
  const show = (chosen) => {
    buttons.forEach((button, number) => {
      button.setAttribute("aria-selected", String(number === chosen));
      button.tabIndex = number === chosen ? 0 : -1;
      panels[number].hidden = number !== chosen;
    });
    element.dataset.shown = items[chosen].id;
    items[chosen].onshow?.();
  };
  list.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: -1, ArrowRight: 1 };
    const current = buttons.indexOf(document.activeElement);
    const chosen = event.key === "Home" ? 0 : event.key === "End" ? items.length - 1 : event.key in steps ? (current + steps[event.key] + items.length) % items.length : null;
    if (chosen === null || current < 0) return;
    event.preventDefault();
    show(chosen);
    buttons[chosen].focus();
  });
  const element = el("div", { class: "look-tabs" }, list, panels);
  show(Math.max(0, items.findIndex(({ id }) => id === first)));
  return element;
}
