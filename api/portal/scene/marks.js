// Known points of a scene, and their marks in the pictures of cameras.

// Cells of a line: separated by tabs or semicolons, else by commas, else by spaces. A decimal comma needs one of the first two.
function cells(line) {
  const separator = /[;\t]/.test(line) ? /[;\t]/ : line.includes(",") ? "," : /\s+/;
  return line.split(separator).map((cell) => cell.trim());
}

const readNumber = (cell) => (/\d/.test(cell ?? "") ? Number(cell.replace(",", ".")) : NaN);

// Points of a table with the columns name, x, y, z; with camera, x, y of a pixel also marks. `wrong` has the numbers of lines
// that can't be read, or that give a point other coordinates than an earlier line.
export function readTable(text) {
  const [points, marks, wrong] = [new Map(), [], []];
  text.split(/\r?\n/).forEach((line, index) => {
    if (!line.trim()) return;
    const [name, ...rest] = cells(line.trim());
    const xyz = rest.slice(0, 3).map(readNumber);
    const known = points.get(name);
    if (index === 0 && xyz.every(Number.isNaN)) return; // names of the columns
    if (!name || xyz.length < 3 || !xyz.every(Number.isFinite) || (known && known.xyz_m.join() !== xyz.join())) {
      wrong.push(index + 1);
      return;
    }
    points.set(name, { name, xyz_m: xyz });
    const pixel = rest.slice(4, 6).map(readNumber);
    if (rest[3] && pixel.length === 2 && pixel.every(Number.isFinite)) marks.push({ camera: rest[3], name, pixel });
  });
  return { points: [...points.values()], marks, wrong };
}

export class PointMarks {
  points = [];
  next = null; // name of the point that a click marks
  held = null; // name of the point whose mark the arrow keys move
  #seen = new Map(); // pixels by camera and name of the point
  #past = []; // states before each change, for the undo
  #told = new Set(); // marks of the table: one that was moved since stays where it is

  of(camera) {
    if (!this.#seen.has(camera)) this.#seen.set(camera, new Map());
    return this.#seen.get(camera);
  }

  read(text) {
    const { points, marks, wrong } = readTable(text);
    this.points = points;
    const told = new Map(marks.map((mark) => [JSON.stringify(mark), mark]));
    for (const [key, { camera, name, pixel }] of told) if (!this.#told.has(key)) this.of(camera).set(name, pixel);
    this.#told = new Set(told.keys());
    return wrong;
  }

  // Points that are marked in a camera.
  marked(camera) {
    return this.points.filter(({ name }) => this.of(camera).has(name));
  }

  // The first point without a mark becomes the next one.
  begin(camera) {
    this.held = null;
    this.next = this.points.find(({ name }) => !this.of(camera).has(name))?.name ?? null;
  }

  choose(camera, name) {
    this.next = name;
    this.held = this.of(camera).has(name) ? name : null;
  }

  place(camera, pixel) {
    if (this.next === null) return;
    this.#change(camera, this.next, pixel);
    this.held = this.next;
    const after = this.points.findIndex(({ name }) => name === this.held);
    const inTurn = [...this.points.slice(after), ...this.points.slice(0, after)];
    this.next = inTurn.find(({ name }) => !this.of(camera).has(name))?.name ?? null;
  }

  move(camera, pixel) {
    if (this.held !== null) this.#change(camera, this.held, pixel, true);
  }

  remove(camera) {
    if (this.held === null) return;
    this.#change(camera, this.held, null);
    this.choose(camera, this.held);
  }

  // Undo the last change; returns its camera, null without one. Moves of one mark are one change.
  undo() {
    const last = this.#past.pop();
    if (last === undefined) return null;
    this.#set(last.camera, last.name, last.before);
    this.choose(last.camera, last.name);
    return last.camera;
  }

  get canUndo() { return this.#past.length > 0; }

  #change(camera, name, pixel, isMove = false) {
    const last = this.#past.at(-1);
    if (!(isMove && last?.isMove && last.camera === camera && last.name === name)) {
      this.#past.push({ camera, name, before: this.of(camera).get(name) ?? null, isMove });
    }
    this.#set(camera, name, pixel);
  }

  #set(camera, name, pixel) {
    if (pixel === null) this.of(camera).delete(name);
    else this.of(camera).set(name, pixel);
  }

  // Points as the service takes them, with their marks in some cameras.
  known(cameras) {
    const seen = (name) => Object.fromEntries(cameras.filter((camera) => this.of(camera).has(name)).map((camera) => [camera, this.of(camera).get(name)]));
    return this.points.map(({ name, xyz_m }) => ({ name, xyz_m, seen_px: seen(name) }));
  }

  // Table of the marks, as the command line takes it.
  table(cameras) {
    const lines = cameras.flatMap((camera) => this.marked(camera).map(({ name, xyz_m }) => [name, ...xyz_m, camera, ...this.of(camera).get(name)].join(",")));
    return ["name,x_m,y_m,z_m,camera,x_px,y_px", ...lines, ""].join("\n");
  }
}
