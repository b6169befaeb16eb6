// The 3D view: renderer, light, ground and orbit. It draws only when something has changed.

import { OrbitControls } from "../../vendor/three/addons/controls/OrbitControls.js";
import * as THREE from "../../vendor/three/three.module.js";
import { graphics } from "../dom.js";
import { prepareLens } from "../video/overlay.js";

const BACKGROUND = 0x161b1a;
const FIELD_OF_VIEW_DEG = 42;
const SLOW_MS = 30;
const FAST_MS = 15;
const MIN_PIXEL_RATIO = 0.5;
const MEASURED_FRAMES = 8;
// A longer time between two pictures is a pause: the tab was hidden.
const PAUSE_MS = 2000;
// Time without a change after which the view is at rest, and is drawn with all pixels.
const REST_MS = 250;

// Bends what is seen through a camera as its lens does (video/overlay.js): a vertex where the picture shows it. Beyond the reach
// of the model, points go on straight.
const BEND = `
  uniform vec4 lens[3];
  uniform vec2 lensKind; // 0 none, 1 standard, 2 fisheye; reach
  vec4 bend(vec4 point) {
    if (lensKind.x < 0.5 || point.z > -1e-3) return point;
    vec2 ideal = vec2(point.x, -point.y) / -point.z;
    vec2 q = ideal * min(1.0, lensKind.y / max(length(ideal), 1e-9));
    float r2 = dot(q, q);
    vec2 bent = q;
    if (lensKind.x > 1.5) {
      float radius = sqrt(r2), a = atan(radius), a2 = a * a;
      float grown = a * (1.0 + a2 * (lens[0].x + a2 * (lens[0].y + a2 * (lens[0].z + a2 * lens[0].w))));
      bent = radius > 1e-9 ? q * grown / radius : q;
    } else {
      float radial = (1.0 + r2 * (lens[0].x + r2 * (lens[0].y + r2 * lens[1].x))) / (1.0 + r2 * (lens[1].y + r2 * (lens[1].z + r2 * lens[1].w)));
      vec2 p = lens[0].zw;
      bent = q * radial + 2.0 * p * q.x * q.y + p.yx * (r2 + 2.0 * q * q) + r2 * (lens[2].xz + lens[2].yw * r2);
    }
    bent += ideal - q;
    return vec4(bent.x * -point.z, bent.y * point.z, point.zw);
  }`;
const PLACED = "#include <project_vertex>\n  gl_Position = projectionMatrix * bend(mvPosition);";

export class Canvas3D {
  #lens = { lens: { value: [0, 1, 2].map(() => new THREE.Vector4()) }, lensKind: { value: new THREE.Vector2() } };
  #project3D = null; // of the camera that is seen through
  #needsDraw = true;
  #durations = [];
  #lastDraw = 0;
  #changedAt = 0; // when a picture was drawn last that had changed
  #largestRatio = Math.min(2, globalThis.devicePixelRatio || 1);
  #pixelRatio = this.#largestRatio; // while the picture changes
  #orbit = null; // what was looked at from where before it was seen through a camera

  constructor(canvas, floor) {
    this.canvas = canvas;
    // Without a graphics card, smoothing of edges would cost more than all the rest.
    this.renderer = new THREE.WebGLRenderer({ canvas, alpha: true, antialias: !graphics().isSoftware, powerPreference: "high-performance" });
    this.renderer.setPixelRatio(this.#pixelRatio);
    this.scene = new THREE.Scene();
    this.background = new THREE.Color(BACKGROUND);
    this.scene.background = this.background;
    this.ground = new THREE.Group();
    this.scene.add(this.ground);
    this.camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, 0.05, 500);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(4, -6, 3);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.controls.dampingFactor = 0.18;
    this.controls.addEventListener("change", () => this.invalidate());
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x39443f, 2.2));
    const sun = new THREE.DirectionalLight(0xffffff, 1.6);
    sun.position.set(3, -4, 8);
    this.scene.add(sun);
    this.floor = floor ?? { height_m: 0, slope_x: 0, slope_y: 0 };
    this.#resizing = new ResizeObserver(() => this.#resize());
    this.#resizing.observe(canvas.parentElement);
    this.#resize();
  }

  #resizing;

  /** Ask for a new picture at the next frame of the browser. */
  invalidate() {
    this.#needsDraw = true;
  }

  /** Add an object, which the lens of a camera bends that it is seen through. */
  add(object) {
    this.scene.add(object);
    object.traverse(({ material }) => {
      for (const one of [material ?? []].flat()) {
        one.onBeforeCompile = (shader) => {
          Object.assign(shader.uniforms, this.#lens);
          shader.vertexShader = `${BEND}\n${shader.vertexShader.replace("#include <project_vertex>", PLACED)}`;
        };
      }
    });
  }

  floorZ(x, y) {
    return this.floor.height_m + this.floor.slope_x * x + this.floor.slope_y * y;
  }

  /** Add the ground: lines a metre apart, every fifth brighter, around a box. */
  addGround(box) {
    const margin = 2;
    const [x0, y0] = [Math.floor(box.min.x - margin), Math.floor(box.min.y - margin)];
    const [x1, y1] = [Math.ceil(box.max.x + margin), Math.ceil(box.max.y + margin)];
    const step = Math.max(1, Math.ceil(Math.max(x1 - x0, y1 - y0) / 60));
    const points = [];
    const colors = [];
    const line = (ax, ay, bx, by, isMain) => {
      points.push(ax, ay, this.floorZ(ax, ay), bx, by, this.floorZ(bx, by));
      const shade = isMain ? [0.09, 0.11, 0.105] : [0.028, 0.034, 0.033];
      colors.push(...shade, ...shade);
    };
    for (let x = x0; x <= x1; x += step) line(x, y0, x, y1, x % (5 * step) === 0);
    for (let y = y0; y <= y1; y += step) line(x0, y, x1, y, y % (5 * step) === 0);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
    geometry.setAttribute("color", new THREE.Float32BufferAttribute(colors, 3));
    const ground = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ vertexColors: true }));
    ground.renderOrder = -1;
    this.ground.add(ground);
    this.#addAxes(x0, y0);
  }

  /** Short axes in the corner of the ground: x red, y green, z blue. */
  #addAxes(x, y) {
    const axes = new THREE.AxesHelper(0.8);
    axes.position.set(x, y, this.floorZ(x, y) + 0.004);
    this.ground.add(axes);
  }

  /** Look at a box from a direction, as near as all of it is in view. */
  fit(box, direction = null) {
    this.leaveCamera();
    const towards = (direction ?? this.camera.position.clone().sub(this.controls.target)).clone().normalize();
    const right = new THREE.Vector3(0, 0, 1).cross(towards).normalize();
    const up = towards.clone().cross(right);
    const tangent = Math.tan(THREE.MathUtils.degToRad(FIELD_OF_VIEW_DEG / 2));
    const center = box.getCenter(new THREE.Vector3());
    let distance = 1.5;
    for (let corner = 0; corner < 8; corner++) {
      const [x, y, z] = ["x", "y", "z"].map((axis, bit) => (corner >> bit & 1 ? box.max : box.min)[axis]);
      const offset = new THREE.Vector3(x, y, z).sub(center);
      const across = Math.max(Math.abs(offset.dot(right)) / this.camera.aspect, Math.abs(offset.dot(up)));
      distance = Math.max(distance, offset.dot(towards) + across / tangent);
    }
    this.controls.target.copy(center);
    this.camera.position.copy(center).addScaledVector(towards, distance);
    this.controls.update();
    this.invalidate();
  }

  /** See what a camera of the capture sees: from its place, with its camera matrix and its lens. `isClear`: over its picture. */
  lookThrough(camera, isClear = false) {
    const { matrix, size_px: [width, height], lens, distortion, cam_from_world: { rotation: r, translation_m: t } } = camera;
    this.#orbit ??= { position: this.camera.position.clone(), target: this.controls.target.clone() };
    this.throughMatrix = { fx: matrix[0][0], fy: matrix[1][1], cx: matrix[0][2], cy: matrix[1][2], skew: matrix[0][1], width, height };
    this.#project3D = prepareLens(camera);
    this.#lens.lens.value.forEach((part, number) => part.fromArray([0, 1, 2, 3].map((place) => distortion[4 * number + place] ?? 0)));
    this.#lens.lensKind.value.set(lens === "fisheye" ? 2 : 1, this.#project3D.reach);
    this.scene.background = isClear ? null : this.background;
    this.ground.visible = false; // its long lines would stay straight
    this.controls.enabled = false;
    // Rows of the rotation are the camera's axes: x to the right, y down, z forward. WebGL's y is up and z backward.
    const world = new THREE.Matrix4().set(
      r[0][0], -r[1][0], -r[2][0], 0,
      r[0][1], -r[1][1], -r[2][1], 0,
      r[0][2], -r[1][2], -r[2][2], 0,
      0, 0, 0, 1,
    );
    const center = [0, 1, 2].map((axis) => -(r[0][axis] * t[0] + r[1][axis] * t[1] + r[2][axis] * t[2]));
    this.camera.position.set(...center);
    this.camera.quaternion.setFromRotationMatrix(world);
    this.#project();
    this.invalidate();
  }

  leaveCamera() {
    if (!this.throughMatrix) return;
    this.throughMatrix = null;
    this.#lens.lensKind.value.setX(0);
    this.scene.background = this.background;
    this.ground.visible = true;
    this.controls.enabled = true;
    this.camera.position.copy(this.#orbit.position);
    this.controls.target.copy(this.#orbit.target);
    this.#orbit = null;
    this.camera.up.set(0, 0, 1);
    this.#project();
    this.controls.update();
    this.invalidate();
  }

  /** Draw if something has changed, or once with all pixels when it is at rest; returns whether it did. */
  draw(now) {
    if (this.controls.enabled) this.controls.update();
    if (this.#needsDraw) {
      this.#needsDraw = false;
      this.#useRatio(this.#pixelRatio);
      this.renderer.render(this.scene, this.camera);
      this.#adapt(now);
      this.#changedAt = now;
      return true;
    }
    this.#lastDraw = 0;
    if (now - this.#changedAt < REST_MS || !this.#useRatio(this.#largestRatio)) return false;
    this.renderer.render(this.scene, this.camera);
    return true;
  }

  /** Place of the eye and what it looks at, for `stand`. */
  get standpoint() {
    return this.#orbit ?? { position: this.camera.position.clone(), target: this.controls.target.clone() };
  }

  /** Look from a standpoint, unless this is seen through a camera. */
  stand({ position, target }) {
    if (!this.controls.enabled) return;
    this.camera.position.copy(position);
    this.controls.target.copy(target);
    this.controls.update();
    this.invalidate();
  }

  /** Turn around the target by angles, or come closer by a factor: the keyboard's orbit. */
  orbit(turnRad, tiltRad, factor = 1) {
    this.leaveCamera();
    const offset = this.camera.position.clone().sub(this.controls.target);
    // Spherical coordinates of three.js have y up.
    const spherical = new THREE.Spherical().setFromVector3(new THREE.Vector3(offset.x, offset.z, -offset.y));
    spherical.theta += turnRad;
    spherical.phi = Math.min(Math.PI - 0.05, Math.max(0.05, spherical.phi + tiltRad));
    spherical.radius *= factor;
    const turned = new THREE.Vector3().setFromSpherical(spherical);
    this.camera.position.copy(this.controls.target).add(new THREE.Vector3(turned.x, -turned.z, turned.y));
    this.controls.update();
    this.invalidate();
  }

  /** Place of a world point in the canvas in CSS pixels, and whether it is in front of the camera. */
  toScreen(point, out) {
    if (this.throughMatrix) {
      const [u, v] = this.#project3D.project(point.x, point.y, point.z, [0, 0]);
      const { left, top, pixels } = this.#picture();
      out.set(left + (u + 0.5) / pixels, top + (v + 0.5) / pixels, 0);
      return out.x > 0 && out.y > 0 && out.x < this.canvas.clientWidth && out.y < this.canvas.clientHeight;
    }
    out.copy(point).project(this.camera);
    const isVisible = out.z < 1 && Math.abs(out.x) < 1.1 && Math.abs(out.y) < 1.1;
    out.x = (0.5 + out.x / 2) * this.canvas.clientWidth;
    out.y = (0.5 - out.y / 2) * this.canvas.clientHeight;
    return isVisible;
  }

  /** Line of sight through a place of the canvas in CSS pixels: its origin and its direction. */
  sight(x, y) {
    const origin = this.camera.position.clone();
    if (this.throughMatrix) {
      const { left, top, pixels } = this.#picture();
      return { origin, direction: new THREE.Vector3(...this.#project3D.ray((x - left) * pixels - 0.5, (y - top) * pixels - 0.5)).normalize() };
    }
    const { clientWidth, clientHeight } = this.canvas;
    const direction = new THREE.Vector3((2 * x) / clientWidth - 1, 1 - (2 * y) / clientHeight, 0.5).unproject(this.camera).sub(origin).normalize();
    return { origin, direction };
  }

  close() {
    this.#resizing.disconnect();
    this.controls.dispose();
    this.scene.traverse((object) => {
      object.geometry?.dispose();
      object.material?.dispose?.();
    });
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height, true);
    this.#project();
    // The canvas is blank until it is drawn again.
    this.renderer.render(this.scene, this.camera);
    this.invalidate();
  }

  #project() {
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    const aspect = clientWidth / Math.max(1, clientHeight);
    this.camera.aspect = aspect;
    this.camera.updateProjectionMatrix();
    if (!this.throughMatrix) return;
    const { fx, fy, cx, cy, skew, width, height } = this.throughMatrix;
    const { pixels } = this.#picture();
    const [half, upright] = [(clientWidth * pixels) / 2, (clientHeight * pixels) / 2];
    const { near, far } = this.camera;
    const [x, y] = [cx + 0.5 - width / 2, cy + 0.5 - height / 2];
    this.camera.projectionMatrix.makePerspective(
      ((-half - x) / fx) * near, ((half - x) / fx) * near, ((upright + y) / fy) * near, ((-upright + y) / fy) * near, near, far,
    );
    this.camera.projectionMatrix.elements[4] = -skew / half;
    this.camera.projectionMatrixInverse.copy(this.camera.projectionMatrix).invert();
  }

  /** Place of the picture of the camera that is seen through: as large as fits; what is beside it is shown too. */
  #picture() {
    const { width, height } = this.throughMatrix;
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    const pixels = Math.max(width / clientWidth, height / clientHeight);
    return { pixels, left: (clientWidth - width / pixels) / 2, top: (clientHeight - height / pixels) / 2 };
  }

  /** Draw with fewer pixels where drawing is slow, and with all of them where it is fast. */
  #adapt(now) {
    const took = now - this.#lastDraw;
    this.#lastDraw = now;
    if (took > PAUSE_MS) return;
    this.#durations.push(took);
    if (this.#durations.length < MEASURED_FRAMES) return;
    const median = this.#durations.sort((a, b) => a - b)[MEASURED_FRAMES >> 1];
    this.#durations = [];
    if (median > SLOW_MS) this.#pixelRatio = Math.max(MIN_PIXEL_RATIO, this.#pixelRatio * 0.75);
    else if (median < FAST_MS) this.#pixelRatio = Math.min(this.#largestRatio, this.#pixelRatio * 1.1);
  }

  /** Draw with so many pixels for each of the page from now on; returns whether that is a change. */
  #useRatio(ratio) {
    if (ratio === this.renderer.getPixelRatio()) return false;
    this.renderer.setPixelRatio(ratio);
    return true;
  }
}
