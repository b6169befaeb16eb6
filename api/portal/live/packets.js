// Packed messages of live captures (docs/live_service.md, "Packed messages"): keypoints to the service, instants from it.

const KEYPOINTS = "MCK1";
const INSTANT = "MCI1";
const [KEYPOINTS_HEAD_BYTES, INSTANT_HEAD_BYTES, PERSON_HEAD_BYTES, FLOAT_BYTES] = [20, 36, 8, 4];

/**
 * Packet of a camera's frame.
 *
 * `camera` is its place in `cameras` of the message `ready`, `timeS` is in seconds, and `people` has for each person x and
 * y in pixels and score of each point of the layout, in a row. Points with a number that is not finite count as not found.
 */
export function packKeypoints({ camera, timeS, people, numPoints }) {
  const packet = new ArrayBuffer(KEYPOINTS_HEAD_BYTES + people.length * numPoints * 3 * FLOAT_BYTES);
  const view = new DataView(packet);
  writeMagic(view, KEYPOINTS);
  [camera, people.length, numPoints, 0].forEach((value, place) => view.setUint16(4 + 2 * place, value, true));
  view.setFloat64(12, timeS, true);
  let place = KEYPOINTS_HEAD_BYTES;
  for (const person of people) {
    for (let point = 0; point < 3 * numPoints; point += 3) {
      const values = [person[point], person[point + 1], Math.min(1, person[point + 2])];
      const isFound = values.every(Number.isFinite) && values[2] > 0;
      for (const value of values) {
        view.setFloat32(place, isFound ? value : 0, true);
        place += FLOAT_BYTES;
      }
    }
  }
  return packet;
}

/**
 * Instant of a packet, an ArrayBuffer: `{ timeS, lagS, sequence, dropped, people }`.
 *
 * A person has `id`, `joints` (x, y and z in metres of each of `joints` of `ready`, NaN where unknown) and `skeleton`, which is
 * null until the bones are learnt: `root`, `rotations` (x, y, z, w), `boneLengths` and `joints` of `bones` of `ready`.
 */
export function unpackInstant(packet) {
  const view = new DataView(packet);
  if (packet.byteLength < INSTANT_HEAD_BYTES || readMagic(view) !== INSTANT) throw new Error("These bytes are no packet of an instant.");
  const [numPeople, numJoints, numBones] = [4, 6, 8].map((offset) => view.getUint16(offset, true));
  const personBytes = PERSON_HEAD_BYTES + (3 * numJoints + 3 + 8 * numBones) * FLOAT_BYTES;
  if (packet.byteLength !== INSTANT_HEAD_BYTES + numPeople * personBytes) throw new Error("The packet of an instant has another length.");
  const people = Array.from({ length: numPeople }, (_, number) => readPerson(view, INSTANT_HEAD_BYTES + number * personBytes, numJoints, numBones));
  return {
    timeS: view.getFloat64(12, true), lagS: view.getFloat32(20, true), sequence: view.getUint32(24, true),
    dropped: { input: view.getUint32(28, true), output: view.getUint32(32, true) }, people,
  };
}

function readPerson(view, start, numJoints, numBones) {
  let place = start + PERSON_HEAD_BYTES;
  const take = (count) => {
    const values = new Float32Array(count);
    for (let number = 0; number < count; number++, place += FLOAT_BYTES) values[number] = view.getFloat32(place, true);
    return values;
  };
  const joints = take(3 * numJoints);
  const skeleton = { root: take(3), rotations: take(4 * numBones), boneLengths: take(numBones), joints: take(3 * numBones) };
  return { id: view.getUint32(start, true), joints, skeleton: view.getUint32(start + 4, true) ? skeleton : null };
}

function writeMagic(view, text) {
  for (let place = 0; place < text.length; place++) view.setUint8(place, text.charCodeAt(place));
}

const readMagic = (view) => String.fromCharCode(...[0, 1, 2, 3].map((place) => view.getUint8(place)));
