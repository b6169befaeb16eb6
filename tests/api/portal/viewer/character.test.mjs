// Files of characters in motion that the pipeline has written: what they describe, their keys, and damaged ones.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { isCompressed, readCharacter, simplify } from "../../../../api/portal/viewer/motion/character.js";

const read = (name) => readFileSync(`${process.env.FIXTURES}/${name}`);
const bytes = read("character.glb");
const expected = JSON.parse(read("expected.json"));

/** File of a source with some content; `asked` are the ranges that were read. */
function openFile(content) {
  const asked = [];
  const part = async (from, to) => {
    asked.push([from, to]);
    assert.ok(to <= content.length);
    return Uint8Array.from(content.subarray(from, to)).buffer;
  };
  return { id: 1, name: "person-1.character.glb", numBytes: content.length, asked, read: part };
}

test("keys are those that the pipeline wrote", async () => {
  const file = openFile(bytes);
  const motion = await readCharacter(file);
  motion.fill(await file.read(...motion.range));
  assert.deepEqual([motion.startFrame, motion.rateHz, motion.originM], [expected.start_frame, expected.rate_hz, [100, -50, 0]]);
  assert.ok(Math.abs(motion.unitsPerM - expected.scale) < 1e-9);
  assert.equal(motion.range[1], bytes.length);
  assert.equal(motion.channels.length, expected.turning.length + 1);
  const hips = motion.channels.find(({ path }) => path === "translation");
  assert.equal(hips.node, expected.hips);
  const single = Float32Array.from(expected.places.flat());
  assert.deepEqual([...hips.values], [...single]);
  const turns = motion.channels.find(({ node, path }) => path === "rotation" && node === expected.turning.at(-1));
  expected.quaternions.flat().forEach((value, number) => assert.ok(Math.abs(turns.values[number] - value) < 1e-6));
});

test("a person has rows in the frames of the file in which they are there", async () => {
  const motion = await readCharacter(openFile(bytes));
  const rowAt = (frame) => motion.rowAt(frame / expected.rate_hz);
  const [first, stop] = expected.present;
  const start = expected.start_frame;
  assert.deepEqual([start, first - 1, stop].map(rowAt), [null, null, null]);
  for (const frame of [first, first + 7, stop - 1]) assert.ok(Math.abs(rowAt(frame) - (frame - start)) < 1e-9);
  // Between two frames of the file, as at another rate.
  assert.ok(Math.abs(rowAt(first + 2.25) - (first + 2.25 - start)) < 1e-9);
});

test("a long description is read on", async () => {
  const length = bytes.readUInt32LE(12);
  const document = JSON.parse(bytes.subarray(20, 20 + length));
  document.asset.extras = "x".repeat(100_000);
  const text = Buffer.from(JSON.stringify(document));
  const head = Buffer.concat([text, Buffer.alloc(-text.length & 3, " ")]);
  const long = Buffer.concat([bytes.subarray(0, 20), head, bytes.subarray(20 + length)]);
  long.writeUInt32LE(head.length, 12);
  const file = openFile(long);
  const motion = await readCharacter(file);
  assert.deepEqual(file.asked, [[0, 65_536], [0, 20 + head.length]]);
  assert.equal(motion.range[1], long.length);
});

test("damaged files are refused by name", async () => {
  const harmed = (change) => { const copy = Buffer.from(bytes); change(copy); return copy; };
  const files = [
    Buffer.alloc(0), bytes.subarray(0, 19), bytes.subarray(0, 3000), bytes.subarray(0, bytes.length - 4),
    harmed((copy) => copy.writeUInt32LE(0xffffffff, 12)), harmed((copy) => copy.fill(0, 0, 4)), harmed((copy) => copy.fill(0x20, 20, 60)),
  ];
  for (const [number, content] of files.entries()) {
    await assert.rejects(readCharacter(openFile(content)), /person-1\.character\.glb is not an animated character, or is damaged/, `file ${number}`);
  }
});

test("only what a picture needs is drawn, and nothing from elsewhere is asked for", () => {
  const document = {
    scene: 1,
    scenes: [{ nodes: [1] }, { nodes: [0] }, { nodes: [2] }],
    nodes: [{ name: "a", mesh: 0, camera: 0, extensions: { KHR_lights_punctual: { light: 0 } }, extras: { node: 7 } }, { mesh: 1 }, { mesh: 2, weights: [0, 1] }],
    cameras: [{}],
    animations: [{}],
    meshes: [{ primitives: [{ targets: [{}] }], weights: [0] }, { primitives: [{ targets: [{}] }], weights: [0.5] }, { primitives: [{ targets: [{}] }] }],
    images: [{ bufferView: 3 }, { uri: "https://elsewhere.example/a.png" }, { uri: "/v1/jobs" }, { uri: "data:image/png;base64,AA==" }],
    textures: [{ source: 0 }, { source: 1 }, { source: 2 }, { source: 3 }, { extensions: { KHR_texture_basisu: { source: 0 } } }, { source: 1, extensions: { EXT_texture_webp: { source: 0 } } }],
    materials: [
      ...[0, 1, 2, 3, 4, 5, 9].map((index) => ({ pbrMetallicRoughness: { baseColorTexture: { index }, metallicFactor: 1 }, normalTexture: { index } })),
      { emissiveTexture: { index: 1 }, alphaMode: "MASK", doubleSided: true, extensions: { KHR_materials_unlit: {}, VRMC_materials_mtoon: {} } },
    ],
  };
  simplify(document);
  assert.deepEqual(document.scenes, [{ nodes: [0] }]);
  assert.deepEqual([document.scene, document.cameras, document.animations], [0, undefined, undefined]);
  assert.deepEqual(document.nodes.map(({ extras, camera, extensions }) => [extras, camera, extensions]), [0, 1, 2].map((node) => [{ node }, undefined, undefined]));
  // Shapes of faces stay where one of them is there all the time.
  assert.deepEqual(document.meshes.map(({ primitives: [{ targets }] }) => targets !== undefined), [false, true, true]);
  const pictures = document.materials.map(({ pbrMetallicRoughness: { baseColorTexture } }) => baseColorTexture?.index);
  assert.deepEqual(pictures, [0, undefined, undefined, 3, undefined, 5, undefined, undefined]);
  assert.ok(document.materials.every(({ normalTexture, emissiveTexture }) => normalTexture === undefined && emissiveTexture === undefined));
  const { alphaMode, doubleSided, extensions } = document.materials.at(-1);
  assert.deepEqual([alphaMode, doubleSided, extensions], ["MASK", true, { KHR_materials_unlit: {} }]);
});

test("compressed meshes are recognised", () => {
  assert.ok(isCompressed({ extensionsUsed: ["KHR_draco_mesh_compression"] }));
  assert.ok(!isCompressed({}) && !isCompressed({ extensionsUsed: ["KHR_materials_unlit"] }));
});
