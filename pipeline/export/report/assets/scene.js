// The motion in 3D on a plain canvas: people as humans or round limbs, ground, cameras. No library, no network.

const NEAR_M = 0.05;
const GROUND = "#141a19";
const GRID = "#2c3835";
const CAMERA = "#8fa69e";

/** Positions of people, from integers of 16 bits in base64. */
class Motion {
  constructor(take) {
    const bytes = Uint8Array.from(atob(take.positions), (letter) => letter.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    this.values = Int16Array.from({ length: bytes.length / 2 }, (_, place) => view.getInt16(2 * place, true));
    this.take = take;
    let offset = 0;
    this.offsets = take.people.map(({ count }) => (offset += count) - count);
  }

  /** Rows of a person around a frame, and the share of the way between them; null if the person is not there. */
  place(person, frame) {
    const { start, count, start_frame: first, num_frames: length } = this.take.people[person];
    if (frame < first - 0.5 || frame > first + length - 0.5 || count === 0) return null;
    const place = Math.min(Math.max(frame / this.take.stride - start, 0), count - 1);
    const before = Math.floor(place);
    return { before, behind: Math.min(before + 1, count - 1), share: place - before };
  }

  /** Positions of a person's joints in a frame, three numbers each, NaN if absent; null if the person is not there. */
  positions(person, frame) {
    const place = this.place(person, frame);
    if (place === null) return null;
    const { before, behind, share } = place;
    const size = 3 * this.take.num_joints;
    const [one, other] = [before, behind].map((row) => (this.offsets[person] + row) * size);
    const found = new Float64Array(size);
    for (let value = 0; value < size; value++) {
      const [a, b] = [this.values[one + value], this.values[other + value]];
      const steps = a === this.take.absent || b === this.take.absent ? NaN : a + share * (b - a);
      found[value] = this.take.origin_m[value % 3] + steps * this.take.step_m;
    }
    return found;
  }
}

const at = (positions, joint) => [...positions.subarray(3 * joint, 3 * joint + 3)];

/** View from a place that orbits a target, or through a camera of the capture. */
class View {
  yaw = 0.9;
  pitch = 0.35;
  distance = 5;
  target = [0, 0, 1];
  camera = null;

  /** Set the view up for a picture of a size in pixels. */
  begin(width, height) {
    this.width = width;
    this.height = height;
    if (this.camera) {
      const { matrix, size_px: [across, down], rotation, translation_m: shift } = this.camera;
      const scale = Math.min(width / across, height / down);
      this.focal = [matrix[0][0] * scale, matrix[1][1] * scale];
      this.center = [(width - across * scale) / 2 + matrix[0][2] * scale, (height - down * scale) / 2 + matrix[1][2] * scale];
      this.rows = rotation.map((row, axis) => [...row, shift[axis]]);
      return;
    }
    const [sinYaw, cosYaw, sinPitch, cosPitch] = [Math.sin(this.yaw), Math.cos(this.yaw), Math.sin(this.pitch), Math.cos(this.pitch)];
    const forward = [-cosYaw * cosPitch, -sinYaw * cosPitch, -sinPitch];
    const right = [-sinYaw, cosYaw, 0];
    const down = [cosYaw * sinPitch, sinYaw * sinPitch, -cosPitch];
    const eye = this.target.map((value, axis) => value - this.distance * forward[axis]);
    this.rows = [right, down, forward].map((row) => [...row, -(row[0] * eye[0] + row[1] * eye[1] + row[2] * eye[2])]);
    const focal = 0.9 * Math.max(height, 0.62 * width);
    this.focal = [focal, focal];
    this.center = [width / 2, height / 2];
  }

  /** Coordinates of a world point in the axes of the view: right, down, forward. */
  inView(x, y, z) {
    return this.rows.map(([a, b, c, shift]) => a * x + b * y + c * z + shift);
  }

  /** Pixels of a point in the axes of the view. */
  toScreen([x, y, z]) {
    return [this.center[0] + this.focal[0] * x / z, this.center[1] + this.focal[1] * y / z];
  }

  /** Move the target along the picture by pixels. */
  pan(across, down) {
    const scale = this.distance / this.focal[0];
    for (let axis = 0; axis < 3; axis++) {
      this.target[axis] -= scale * (across * this.rows[0][axis] + down * this.rows[1][axis]);
    }
  }
}

/** Draws frames of a take on a canvas. */
class Scene {
  constructor(canvas, take) {
    Object.assign(this, { canvas, take, motion: new Motion(take), view: new View() });
    this.context = canvas.getContext("2d");
    this.humans = take.body ? new ReportHumans(take) : null;
    this.showsHumans = true;
    this.centers = take.cameras.map(({ rotation: r, translation_m: t }) => [0, 1, 2].map((axis) => -(r[0][axis] * t[0] + r[1][axis] * t[1] + r[2][axis] * t[2])));
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  floorZ(x, y) {
    const [height, slopeX, slopeY] = this.take.floor;
    return height + slopeX * x + slopeY * y;
  }

  /** Look at everybody who is there in a frame, or at the middle of the take's people. */
  fit(frame) {
    const everybody = this.take.people.map((_, person) => this.motion.positions(person, frame)).filter(Boolean);
    const points = everybody.flatMap((positions) => Array.from({ length: positions.length / 3 }, (_, joint) => at(positions, joint)))
      .filter((point) => point.every(Number.isFinite));
    if (points.length === 0) points.push(this.take.origin_m);
    const bounds = [0, 1, 2].map((axis) => points.reduce(([low, high], point) => [Math.min(low, point[axis]), Math.max(high, point[axis])], [Infinity, -Infinity]));
    this.view.camera = null;
    this.view.target = bounds.map(([low, high]) => (low + high) / 2);
    this.view.distance = Math.max(2.5, 1.25 * Math.hypot(...bounds.map(([low, high]) => high - low)));
    // From the side of the cameras, so that the view resembles the videos.
    const [x, y] = this.centers.length ? [this.centers[0][0] - this.view.target[0], this.centers[0][1] - this.view.target[1]] : [1, 1];
    this.view.yaw = Math.atan2(y, x);
    this.view.pitch = 0.25;
  }

  draw(frame = this.frame ?? 0) {
    this.frame = frame;
    const { canvas, context, view } = this;
    const scale = Math.min(2, window.devicePixelRatio || 1);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
      canvas.width = Math.round(width * scale);
      canvas.height = Math.round(height * scale);
    }
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.fillStyle = GROUND;
    context.fillRect(0, 0, width, height);
    context.lineCap = "round";
    view.begin(width, height);
    this.#drawGround();
    this.#drawCameras();
    this.#drawPeople(frame);
  }

  #line(from, to) {
    let [a, b] = [this.view.inView(...from), this.view.inView(...to)];
    if (a[2] < NEAR_M && b[2] < NEAR_M) return;
    if (a[2] < NEAR_M) [a, b] = [b, a];
    if (b[2] < NEAR_M) {
      const share = (a[2] - NEAR_M) / (a[2] - b[2]);
      b = a.map((value, axis) => value + share * (b[axis] - value));
    }
    this.context.moveTo(...this.view.toScreen(a));
    this.context.lineTo(...this.view.toScreen(b));
  }

  #drawGround() {
    const { context, take } = this;
    const [x, y] = take.origin_m.map(Math.round);
    context.strokeStyle = GRID;
    context.lineWidth = 1;
    context.beginPath();
    for (let step = -6; step <= 6; step++) {
      for (const [from, to] of [[[x + step, y - 6], [x + step, y + 6]], [[x - 6, y + step], [x + 6, y + step]]]) {
        this.#line([...from, this.floorZ(...from)], [...to, this.floorZ(...to)]);
      }
    }
    context.stroke();
  }

  #drawCameras() {
    const { context, take } = this;
    take.cameras.forEach((camera, number) => {
      if (camera === this.view.camera) return;
      const { matrix, size_px: [width, height], rotation: r } = camera;
      const corners = [[0, 0], [width, 0], [width, height], [0, height]].map(([u, v]) => {
        const ray = [0.4 * (u - matrix[0][2]) / matrix[0][0], 0.4 * (v - matrix[1][2]) / matrix[1][1], 0.4];
        return [0, 1, 2].map((axis) => this.centers[number][axis] + r[0][axis] * ray[0] + r[1][axis] * ray[1] + r[2][axis] * ray[2]);
      });
      context.strokeStyle = CAMERA;
      context.lineWidth = 1.5;
      context.beginPath();
      corners.forEach((corner, place) => {
        this.#line(this.centers[number], corner);
        this.#line(corner, corners[(place + 1) % 4]);
      });
      context.stroke();
      this.#label(this.centers[number], camera.name, CAMERA, 12);
    });
  }

  #drawPeople(frame) {
    const { context, take, view } = this;
    const limbs = [];
    const names = [];
    take.people.forEach((person, number) => {
      const positions = this.motion.positions(number, frame);
      if (!positions) return;
      for (const [from, to, radius] of take.bones) {
        const ends = [from, to].map((joint) => at(positions, joint));
        if (!ends.flat().every(Number.isFinite)) continue;
        const [a, b] = ends.map((end) => view.inView(...end));
        if (a[2] < NEAR_M || b[2] < NEAR_M) continue;
        limbs.push({ a, b, ends, radius, color: person.color, depth: (a[2] + b[2]) / 2 });
      }
      const top = at(positions, take.top);
      if (top.every(Number.isFinite)) names.push([[top[0], top[1], top[2] + 0.15], person]);
    });
    const stroke = (from, to, width, style) => {
      context.strokeStyle = style;
      context.lineWidth = width;
      context.beginPath();
      context.moveTo(...from);
      context.lineTo(...to);
      context.stroke();
    };
    context.globalAlpha = 0.35;
    for (const { ends, radius, depth } of limbs) {
      const shadow = ends.map(([x, y]) => view.inView(x, y, this.floorZ(x, y)));
      if (shadow.every((end) => end[2] > NEAR_M)) stroke(view.toScreen(shadow[0]), view.toScreen(shadow[1]), Math.max(1, 1.6 * radius * view.focal[0] / depth), "#000");
    }
    context.globalAlpha = 1;
    if (this.humans && this.showsHumans) this.#drawHumans(frame);
    else this.#drawLimbs(limbs, stroke);
    for (const [place, { name, color }] of names) this.#label(place, name, color, 13);
  }

  #drawHumans(frame) {
    const { context, motion, view } = this;
    const triangles = this.take.people.flatMap((_, person) => {
      const positions = motion.positions(person, frame);
      return positions && Number.isFinite(positions[0]) ? this.humans.facing(person, positions, motion.place(person, frame), view) : [];
    });
    context.lineWidth = 1;
    for (const { corners: [a, b, c], color } of triangles.sort((one, other) => other.depth - one.depth)) {
      context.fillStyle = context.strokeStyle = color;
      context.beginPath();
      context.moveTo(a[0], a[1]);
      context.lineTo(b[0], b[1]);
      context.lineTo(c[0], c[1]);
      context.closePath();
      context.fill();
      context.stroke(); // no seams between neighbours
    }
  }

  #drawLimbs(limbs, stroke) {
    const { view } = this;
    limbs.sort((one, other) => other.depth - one.depth);
    for (const { a, b, radius, color, depth } of limbs) {
      const width = Math.max(2, 2 * radius * view.focal[0] / depth);
      const [from, to] = [view.toScreen(a), view.toScreen(b)];
      stroke(from, to, width + 2, "#0b0f0e");
      stroke(from, to, width, color);
    }
  }

  #label(place, text, color, size) {
    const inView = this.view.inView(...place);
    if (inView[2] < NEAR_M) return;
    const [x, y] = this.view.toScreen(inView);
    const { context } = this;
    context.font = `600 ${size}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.strokeStyle = GROUND;
    context.lineWidth = 4;
    context.lineJoin = "round";
    context.strokeText(text.slice(0, 40), x, y);
    context.fillStyle = color;
    context.fillText(text.slice(0, 40), x, y);
  }
}
