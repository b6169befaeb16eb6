// Tool of the viewer to correct joints: dragged in 3D or in cameras' pictures, or put to a place by numbers; and what cameras
// see, sides and contacts in a range of frames.

import { html, render } from "../../shared/lit.js";
import { FIX } from "../../shared/strings/take.js";
import { el } from "../../viewer/dom.js";
import { positionsAt } from "../../viewer/motion/kinematics.js";
import { prepareLens } from "../../viewer/video/overlay.js";
import * as THREE from "../../vendor/three/three.module.js";
import { cameraSight, foot, meet, nearestOn, onPlane, through } from "./lines.js";
import { Preview, SIDES } from "./moved_joints.js";

const NEAR_PX = 18;
const PARTS = ["joint", "left_arm", "right_arm", "left_leg", "right_leg", "head", "all"];
const LIMBS = ["left_foot", "right_foot", "left_hand", "right_hand"];
const PREVIEWED = ["key", "exchange_sides"];
const AXES = ["x", "y", "z"];

export class JointTool {
  #viewer;
  #editor;
  #pending = []; // corrections whose files are not there yet
  #firstFrame = 0; // frame of the session that is the run's first one
  #draft = null; // key that is being made
  #drag = null; // { id, start, place(event) }
  #sights = []; // of the cameras in whose pictures the joint was placed last
  #markers;
  #chosen = { person: 0, joint: null, way: "plane", camera: null, part: "joint", sides: "arms", limb: LIMBS[0] };
  #ending = new AbortController();

  /** `editor` has `add(edit)`, with frames of the run and the numbers of people in it. */
  constructor(viewer, editor) {
    this.#viewer = viewer;
    this.#editor = editor;
    const { description } = viewer;
    Object.assign(this.#chosen, { joint: description.joint_names.find((name) => name === "left_elbow") ?? description.joint_names[0], camera: description.cameras[0]?.name });
    this.button = el("button", { type: "button", class: "look-button", title: FIX.title, "aria-pressed": "false", onclick: () => this.toggle() }, FIX.open);
    this.element = el("section", { class: "look-fix", "aria-label": FIX.label, hidden: true });
    viewer.tools.element.prepend(this.button);
    viewer.strips.element.before(this.element);
    const { signal } = this.#ending;
    viewer.player.addEventListener("time", () => this.#moved(), { signal });
    viewer.correct = () => this.toggle(); // for the viewer's keys
    for (const type of ["pointerdown", "pointermove", "pointerup", "pointercancel"]) {
      viewer.main.addEventListener(type, (event) => this.#pointer(event), { capture: true, signal });
    }
  }

  get isOpen() {
    return !this.element.hidden;
  }

  close() {
    this.#ending.abort();
  }

  toggle() {
    this.element.hidden = this.isOpen;
    this.button.setAttribute("aria-pressed", String(this.isOpen));
    this.#viewer.element.classList.toggle("look-fixing", this.isOpen);
    this.#draft = null;
    this.#show();
    if (this.isOpen) this.element.querySelector("select").focus();
  }

  /** Preview these edits of the session, whose files are not there yet, on the store that the viewer shows now. */
  follow(edits, firstFrame = 0) {
    [this.#pending, this.#firstFrame] = [edits.filter(({ action }) => PREVIEWED.includes(action)), firstFrame];
    this.#show();
  }

  #show() {
    const { store, description: { people, joint_names: joints } } = this.#viewer;
    const chosen = this.#chosen;
    if (chosen.person >= people.length) chosen.person = 0;
    if (!joints.includes(chosen.joint)) [chosen.joint] = joints;
    const pending = this.#pending.map((edit) => this.#inStore(edit)).filter((edit) => edit !== null);
    store.preview = new Preview(store, this.#draft ? [...pending, this.#draft] : pending);
    this.#viewer.showPeople();
    this.#viewer.wall?.redraw();
    this.#mark();
    this.#draw();
  }

  #moved() {
    if (this.#draft?.frame !== this.#viewer.frame && this.#drag === null) [this.#draft, this.#sights] = [null, []];
    if (!this.isOpen) return;
    this.#mark();
    this.#draw();
  }

  /** Edit of a person of the store, in its frames and from its origin; null if that person is not here. */
  #inStore(edit) {
    const { description: { first_frame: first, origin_m: origin, people } } = this.#viewer;
    const local = (place) => place.map((value, axis) => value - origin[axis]);
    const frame = (of) => of - this.#firstFrame - first;
    let person = people.findIndex(({ id }) => id === edit.person);
    if (typeof edit.person === "object") { // named by a place
      const away = people.map((_, number) => this.#awayFrom(number, frame(edit.person.frame), local(edit.person.place_m)));
      person = away.findIndex((value) => value === Math.min(...away) && value < Infinity);
    }
    if (person < 0) return null;
    const frames = Object.fromEntries(["frame", "start_frame", "stop_frame"].filter((name) => name in edit).map((name) => [name, frame(edit[name])]));
    return { ...edit, ...frames, person, ...(edit.place_m ? { place_m: local(edit.place_m) } : {}) };
  }

  /** Distance of a person's hips from a place in a frame; infinite where the person is not. */
  #awayFrom(person, frame, place) {
    const { store, description: { skeleton } } = this.#viewer;
    const positions = new Float32Array(3 * skeleton.names.length);
    const hips = 3 * skeleton.names.indexOf("Hips");
    return store.positions(person, frame, "skeleton", positions) ? Math.hypot(...place.map((value, axis) => value - positions[hips + axis])) : Infinity;
  }

  #add(edit) {
    if (this.#joints(this.#chosen.person) === null) return this.#viewer.say(FIX.absent);
    return this.#editor.add({ ...edit, person: this.#viewer.description.people[this.#chosen.person].id });
  }

  /** Frames that are marked on the time line, or the frame at the play head, of the whole run. */
  #range() {
    const { player, frame, description: { first_frame: first, start_time_s: startS, frame_rate_hz: rateHz } } = this.#viewer;
    if (!player.hasSpan) return { start_frame: first + frame, stop_frame: first + frame + 1 };
    const [start, last] = [player.span.from, player.span.to].map((head) => first + Math.round((player.startS + head / player.rateHz - startS) * rateHz));
    return { start_frame: start, stop_frame: last + 1 };
  }

  /** Middle of the right side's joints in a frame of the run: the left side is there after an exchange; null if unknown. */
  #rightSide(part, frame) {
    const { store, description: { first_frame: first, origin_m: origin, joint_names: names } } = this.#viewer;
    const [out, next] = [0, 1].map(() => new Float32Array(3 * store.records.numJoints));
    if (!positionsAt(store, this.#chosen.person, frame - first, "joints", out, next)) return null;
    const places = names.flatMap((name, number) => (name.startsWith("right_") && SIDES[part].test(name) ? [[...out.slice(3 * number, 3 * number + 3)]] : []))
      .filter((place) => place.every(Number.isFinite));
    return places.length === 0 ? null : origin.map((value, axis) => value + places.reduce((sum, place) => sum + place[axis], 0) / places.length);
  }

  #addKey() {
    const { joint, frame, place_m: placeM } = this.#draft;
    const { first_frame: first, origin_m: origin } = this.#viewer.description;
    this.#draft = null;
    this.#add({ action: "key", joint, frame: frame + first, place_m: placeM.map((value, axis) => value + origin[axis]) });
  }

  /** Positions of a person's joints as they are shown; null where the person is absent. */
  #joints(person) {
    const { store, frame } = this.#viewer;
    const [out, next] = [0, 1].map(() => new Float32Array(3 * store.records.numJoints));
    return frame !== null && positionsAt(store, person, frame, "joints", out, next) ? out : null;
  }

  /** Place of the chosen joint; null where it is not. */
  #place() {
    const joints = this.#joints(this.#chosen.person);
    const number = 3 * this.#viewer.description.joint_names.indexOf(this.#chosen.joint);
    return joints && Number.isFinite(joints[number]) ? [...joints.slice(number, number + 3)] : null;
  }

  #pointer(event) {
    if (this.#drag !== null && event.pointerId === this.#drag.id) {
      event.stopPropagation();
      if (event.type === "pointermove") return this.#dragTo(event);
      const { isMoved, end } = this.#drag;
      this.#drag = null;
      if (isMoved && event.type === "pointerup") end();
      return this.#show();
    }
    const { wall, canvas } = this.#viewer;
    if (!this.isOpen || event.type !== "pointerdown" || event.button !== 0) return undefined;
    const tile = wall?.tiles.find((one) => one.canvas === event.target);
    if (event.target !== canvas && !tile) return undefined;
    if (!(tile ? this.#dragInPicture(event, tile) : this.#dragInScene(event))) return undefined;
    event.stopPropagation();
    event.preventDefault();
    event.target.setPointerCapture(event.pointerId);
    return this.#show();
  }

  #dragTo(event) {
    const place = this.#drag.place(event);
    if (!place?.every(Number.isFinite)) return;
    this.#drag.isMoved = true;
    this.#draft = { action: "key", person: this.#chosen.person, joint: this.#chosen.joint, frame: this.#viewer.frame, place_m: place };
    this.#show();
  }

  /** Choose the joint nearest to the pointer; `toScreen` gives places in CSS pixels of the event's target. */
  #choose(event, toScreen) {
    let nearest = { away: NEAR_PX };
    this.#viewer.description.people.forEach((_, person) => {
      const joints = this.#viewer.shown[person] ? this.#joints(person) : null;
      this.#viewer.description.joint_names.forEach((joint, number) => {
        const seen = joints && toScreen(joints.slice(3 * number, 3 * number + 3));
        const away = seen ? Math.hypot(seen[0] - event.offsetX, seen[1] - event.offsetY) : Infinity;
        if (away < nearest.away) nearest = { away, person, joint };
      });
    });
    const { person, joint } = nearest;
    if (joint === undefined) return false;
    if (joint !== this.#chosen.joint || person !== this.#chosen.person) this.#sights = [];
    Object.assign(this.#chosen, { person, joint });
    return true;
  }

  #dragInScene(event) {
    const { stage } = this.#viewer.view;
    const out = new THREE.Vector3();
    if (!this.#choose(event, (place) => (stage.toScreen(out.clone().set(...place), out) ? [out.x, out.y] : null))) return false;
    const start = this.#place();
    const normal = stage.camera.getWorldDirection(out).toArray();
    const camera = this.#viewer.description.cameras.find(({ name }) => name === this.#chosen.way);
    const sight = ({ offsetX, offsetY }) => {
      const { origin, direction } = stage.sight(offsetX, offsetY);
      return { origin: origin.toArray(), direction: direction.toArray() };
    };
    const place = camera
      ? (moved) => nearestOn(through(cameraSight(camera, 0, 0).origin, start), sight(moved))
      : (moved) => onPlane(sight(moved), start, normal);
    this.#drag = { id: event.pointerId, place, end: () => this.#addKey() };
    return true;
  }

  /** In a picture the joint moves to the line of sight; with a second picture, to where both lines meet. */
  #dragInPicture(event, { camera, canvas }) {
    const lens = prepareLens(camera);
    const pixels = camera.size_px[0] / canvas.clientWidth;
    this.#choose(event, (place) => lens.project(...place, [0, 0]).map((value) => (value + 0.5) / pixels));
    const start = this.#place();
    if (start === null) return false;
    const other = this.#sights.find(({ name }) => name !== camera.name);
    let last = null;
    const place = ({ offsetX, offsetY }) => {
      last = { name: camera.name, px: [offsetX * pixels - 0.5, offsetY * pixels - 0.5] };
      Object.assign(last, cameraSight(camera, ...last.px));
      return (other && meet(last, other)) ?? foot(last, start);
    };
    const end = () => {
      if (this.#chosen.way === "detection") {
        this.#draft = null;
        this.#add({ action: "place_detection", camera: camera.name, joint: this.#chosen.joint, frame: this.#viewer.frame + this.#viewer.description.first_frame, place_px: last.px });
      } else {
        this.#sights = [last, ...(other ? [other] : [])];
        this.#addKey();
      }
    };
    this.#drag = { id: event.pointerId, place, end };
    return true;
  }

  /** Dots at the joints of the chosen person in the 3D view; the chosen one is yellow. */
  #mark() {
    const { view } = this.#viewer;
    if (view === null) return;
    if (!this.#markers) {
      this.#markers = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ size: 7, sizeAttenuation: false, depthTest: false, vertexColors: true }));
      this.#markers.frustumCulled = false;
      this.#markers.renderOrder = 2;
      view.stage.add(this.#markers);
    }
    const joints = this.isOpen ? this.#joints(this.#chosen.person) : null;
    const chosen = this.#viewer.description.joint_names.indexOf(this.#chosen.joint);
    const places = [...(joints ?? [])].map((value) => (Number.isFinite(value) ? value : 1e6));
    this.#markers.visible = joints !== null;
    this.#markers.geometry.setAttribute("position", new THREE.Float32BufferAttribute(places, 3));
    this.#markers.geometry.setAttribute("color", new THREE.Float32BufferAttribute(places.map((_, number) => (Math.floor(number / 3) === chosen && number % 3 === 2 ? 0.05 : 1)), 3));
    view.stage.invalidate();
  }

  #draw() {
    if (!this.isOpen) return;
    const { description: { people, joint_names: joints, cameras } } = this.#viewer;
    const chosen = this.#chosen;
    const place = this.#place();
    const origin = this.#viewer.description.origin_m;
    const choose = (name, label, options) => html`<label>${label} <select class="look-select" aria-label=${label} @change=${({ target }) => {
      chosen[name] = name === "person" ? Number(target.value) : target.value;
      [this.#draft, this.#sights] = [null, []];
      this.#show();
    }}>${options.map(([value, text]) => html`<option value=${value} .selected=${String(chosen[name]) === String(value)}>${text}</option>`)}</select></label>`;
    const button = (label, edit) => html`<button type="button" class="look-button" @click=${() => this.#add(edit())}>${label}</button>`;
    const named = cameras.map(({ name }) => [name, name]);
    const put = (event) => {
      event.preventDefault();
      const values = AXES.map((axis, number) => event.target.elements[axis].valueAsNumber - origin[number]);
      this.#draft = { action: "key", person: chosen.person, joint: chosen.joint, frame: this.#viewer.frame, place_m: values };
      this.#addKey();
      this.#show();
    };
    render(html`
      <form class="look-bar" @submit=${put}>
        ${choose("person", FIX.person, people.map(({ name }, number) => [number, name]))}
        ${choose("joint", FIX.joint, joints.map((name) => [name, name.replaceAll("_", " ")]))}
        ${choose("way", FIX.way, [["plane", FIX.plane], ...named.map(([name]) => [name, FIX.ray(name)]), ["detection", FIX.detection]])}
        ${AXES.map((axis, number) => html`<label>${axis} <input class="look-number" type="number" step="0.001" name=${axis} required ?disabled=${place === null} .value=${place === null ? "" : (place[number] + origin[number]).toFixed(3)}></label>`)}
        <button class="look-button" ?disabled=${place === null}>${FIX.put}</button>
      </form>
      <div class="look-bar" role="group" aria-label=${FIX.range}>
        ${choose("camera", FIX.camera, named)}
        ${choose("part", FIX.part, PARTS.map((part) => [part, FIX.parts[part]]))}
        ${button(FIX.ignore, () => ({ action: "ignore_detections", camera: chosen.camera, part: chosen.part === "joint" ? chosen.joint : chosen.part, ...this.#range() }))}
        ${choose("sides", FIX.sides, Object.entries(FIX.sideParts))}
        ${button(FIX.exchange, () => {
          const range = this.#range();
          return { action: "exchange_sides", part: chosen.sides, left_m: this.#rightSide(chosen.sides, range.start_frame), ...range };
        })}
        ${choose("limb", FIX.limb, LIMBS.map((limb) => [limb, limb.replace("_", " ")]))}
        ${button(FIX.stands, () => ({ action: "contact", limb: chosen.limb, stands: true, ...this.#range() }))}
        ${button(FIX.free, () => ({ action: "contact", limb: chosen.limb, stands: false, ...this.#range() }))}
      </div>
      <p class="look-quiet">${FIX.hint}</p>`, this.element);
  }
}
