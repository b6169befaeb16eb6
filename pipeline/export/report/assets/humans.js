// Human bodies on a plain canvas: a coarse mesh that follows the joints, in triangles that are sorted by their depth.

const LIGHT = [0.45, -0.55, 0.704]; // of length 1
const SHADES = 24;

/** Skins of the people of a take that has bodies. */
class ReportHumans {
  constructor({ body, people, num_joints: numJoints, top }) {
    Object.assign(this, { body, numJoints, top });
    this.triangles = ReportHumans.integers(body.triangles, Uint16Array);
    this.carriers = ReportHumans.integers(body.carriers, Uint8Array);
    this.weights = ReportHumans.integers(body.weights, Uint8Array);
    this.numbers = Object.fromEntries(body.joints.map((name, number) => [name, number]));
    this.people = people.map(({ body: { vertices, joints, turns }, color }) => ({
      vertices: this.#metres(vertices), joints: this.#metres(joints), turns: ReportHumans.integers(turns, Int8Array), shades: shadesOf(color),
    }));
  }

  /** Little-endian integers in base64. */
  static integers(text, Kind) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return new Kind(bytes.buffer);
  }

  #metres(text) {
    return Float64Array.from(ReportHumans.integers(text, Int16Array), (steps) => steps * this.body.step_m);
  }

  /** Triangles of a person that face the view, as `{ corners, depth, color }`; `place` is that of `Motion.place`. */
  facing(person, positions, place, view) {
    const { shades } = this.people[person];
    const skin = this.#skin(person, positions, place);
    const points = []; // of each vertex, pixels and depth; null too near the eye
    for (let vertex = 0; vertex < skin.length; vertex += 3) {
      const inView = view.inView(skin[vertex], skin[vertex + 1], skin[vertex + 2]);
      points.push(inView[2] < NEAR_M ? null : [...view.toScreen(inView), inView[2]]);
    }
    const found = [];
    for (let corner = 0; corner < this.triangles.length; corner += 3) {
      const [first, second, third] = [this.triangles[corner], this.triangles[corner + 1], this.triangles[corner + 2]];
      const [a, b, c] = [points[first], points[second], points[third]];
      if (a === null || b === null || c === null) continue;
      // Counterclockwise from outside; pixels count downwards.
      if ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) >= 0) continue;
      found.push({ corners: [a, b, c], depth: a[2] + b[2] + c[2], color: shades[shadeOf(skin, 3 * first, 3 * second, 3 * third)] });
    }
    return found;
  }

  /** World positions of a person's vertices. */
  #skin(person, positions, place) {
    const { vertices, joints } = this.people[person];
    const transforms = this.#transforms(this.people[person], joints, positions, place);
    const skin = new Float64Array(vertices.length);
    for (let carrier = 0; carrier < this.carriers.length; carrier++) {
      if (this.weights[carrier] === 0) continue;
      const share = this.weights[carrier] / 255;
      const vertex = 3 * (carrier >> 2);
      const [x, y, z] = [vertices[vertex], vertices[vertex + 1], vertices[vertex + 2]];
      const { rows, shift } = transforms[this.carriers[carrier]];
      for (let axis = 0; axis < 3; axis++) {
        const row = rows[axis];
        skin[vertex + axis] += share * (row[0] * x + row[1] * y + row[2] * z + shift[axis]);
      }
    }
    return skin;
  }

  /** Transform of each joint of the body: the rows of its rotation, and the shift after it. */
  #transforms({ turns }, rest, positions, { before, behind, share }) {
    const transforms = [];
    const turnOf = (joint) => mixed(turns, 4 * (before * this.numJoints + joint), 4 * (behind * this.numJoints + joint), share);
    for (let joint = 0; joint < this.numJoints; joint++) {
      if (Number.isFinite(positions[3 * joint])) transforms[joint] = moved(matrixOf(turnOf(joint)), at(rest, joint), at(positions, joint));
    }
    for (const [name, joint] of Object.entries(this.numbers)) {
      // Fingers without positions move with the hand.
      const side = name.match(/^(Left|Right)Hand/)?.[1];
      if (side) transforms[joint] ??= transforms[this.numbers[`${side}Hand`]];
    }
    for (const { name, parent, hand, angle } of this.#twists(turnOf)) {
      const joint = this.numbers[name];
      const elbow = at(positions, parent);
      const place = at(positions, hand).map((value, axis) => elbow[axis] + angle.share * (value - elbow[axis]));
      transforms[joint] = moved(matrixOf(product(turnOf(parent), [Math.sin(angle.half), 0, 0, Math.cos(angle.half)])), at(rest, joint), place);
    }
    return transforms;
  }

  /** Twist joints of the forearms, with half of the angle by which each is turned. */
  *#twists(turnOf) {
    for (const twist of this.body.twists) {
      const [parent, hand] = [twist.parent, twist.hand].map((name) => this.numbers[name]);
      const [x, y, z, w] = turnOf(parent);
      const turn = product([-x, -y, -z, w], turnOf(hand));
      const middle = this.body.middle_twist_rad;
      const beyond = 2 * Math.atan2(turn[0], turn[3]) - middle;
      const rad = middle + beyond - 2 * Math.PI * Math.round(beyond / (2 * Math.PI));
      yield { name: twist.name, parent, hand, angle: { share: twist.share, half: (twist.share * rad) / 2 } };
    }
  }
}

/** Number of the shade of a triangle of a skin, from the places of its corners. */
function shadeOf(skin, a, b, c) {
  const [ux, uy, uz] = [skin[b] - skin[a], skin[b + 1] - skin[a + 1], skin[b + 2] - skin[a + 2]];
  const [vx, vy, vz] = [skin[c] - skin[a], skin[c + 1] - skin[a + 1], skin[c + 2] - skin[a + 2]];
  const [x, y, z] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
  const cosine = (x * LIGHT[0] + y * LIGHT[1] + z * LIGHT[2]) / (Math.sqrt(x * x + y * y + z * z) || 1);
  return Math.round((SHADES - 1) * (0.5 + 0.5 * cosine));
}

/** Colours from shadow to light of a colour such as #2a51d0. */
function shadesOf(color) {
  const rgb = [1, 3, 5].map((start) => parseInt(color.slice(start, start + 2), 16));
  return Array.from({ length: SHADES }, (_, shade) => {
    const light = 0.3 + (0.8 * shade) / (SHADES - 1);
    return `rgb(${rgb.map((value) => Math.min(255, Math.round(value * light))).join(" ")})`;
  });
}

/** Quaternion (x, y, z, w) of length 1 between two, which begin at places of an array. */
function mixed(turns, one, other, share) {
  let dot = 0;
  for (let value = 0; value < 4; value++) dot += turns[one + value] * turns[other + value];
  const sign = dot < 0 ? -1 : 1;
  const values = [0, 1, 2, 3].map((value) => (1 - share) * turns[one + value] + share * sign * turns[other + value]);
  const length = Math.hypot(...values) || 1;
  return values.map((value) => value / length);
}

function product([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz,
  ];
}

/** Rows of the matrix of a quaternion. */
function matrixOf([x, y, z, w]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
  ];
}

/** Transform that turns about a place at rest and brings it to another. */
function moved(rows, from, to) {
  return { rows, shift: rows.map((row, axis) => to[axis] - row[0] * from[0] - row[1] * from[1] - row[2] * from[2]) };
}
