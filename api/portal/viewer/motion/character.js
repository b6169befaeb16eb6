// A character in motion as its GLB file has it: what the file describes, and the keys of its motion (docs/start/own-character.md).

import { VIEWER } from "../../shared/strings/viewer.js";

const HEAD_BYTES = 2 ** 16;
const CHUNK_START = 20;
const CHUNK_HEAD_BYTES = 8;
const [GLB, JSON_CHUNK] = [0x46546c67, 0x4e4f534a];
const COLUMNS = { translation: 3, rotation: 4 };
const FLOAT_BYTES = Float32Array.BYTES_PER_ELEMENT;
const DRACO = "KHR_draco_mesh_compression";

/**
 * Read what a file describes, without its meshes and its keys; returns a promise of its `CharacterKeys`.
 *
 * `file` is one of a source's `characters()`. The promise is rejected if the file can't be read or is no such file.
 */
export async function readCharacter(file, signal) {
  let head = await file.read(0, Math.min(file.numBytes, HEAD_BYTES), { signal });
  const end = endOfDescription(file, head);
  if (end > head.byteLength) head = await file.read(0, end, { signal });
  try {
    const document = JSON.parse(new TextDecoder().decode(new Uint8Array(head, CHUNK_START, end - CHUNK_START)));
    return new CharacterKeys(file, document, end + CHUNK_HEAD_BYTES);
  } catch {
    throw damaged(file);
  }
}

function endOfDescription(file, head) {
  const view = new DataView(head);
  if (head.byteLength < CHUNK_START || view.getUint32(0, true) !== GLB || view.getUint32(16, true) !== JSON_CHUNK) throw damaged(file);
  const end = CHUNK_START + view.getUint32(12, true);
  if (end + CHUNK_HEAD_BYTES > file.numBytes) throw damaged(file);
  return end;
}

function damaged({ name }) {
  return new Error(VIEWER.characterDamaged(name));
}

/** Motion of one person's character: `channels` are `{ node, path, values }`, a row of values for each frame of the file. */
class CharacterKeys {
  channels = [];
  #present;
  #numRows;

  /** `document` is the JSON of the file, whose buffer begins at the byte `start`. */
  constructor(file, document, start) {
    Object.assign(this, { file, document, start });
    const { samplers, channels, extras } = document.animations[0];
    const bufferView = (accessor) => ({ ...document.bufferViews[accessor.bufferView], count: accessor.count });
    this.parts = channels.map(({ sampler, target: { node, path } }) => {
      const { byteOffset, count } = bufferView(document.accessors[samplers[sampler].output]);
      return { node, path, byteOffset, length: count * COLUMNS[path] };
    });
    this.#numRows = this.parts[0].length / COLUMNS[this.parts[0].path];
    // The keys of a file stand one after the other.
    const first = Math.min(...this.parts.map(({ byteOffset }) => byteOffset));
    const stop = Math.max(...this.parts.map(({ byteOffset, length }) => byteOffset + FLOAT_BYTES * length));
    this.range = [start + first, start + stop];
    if (!(start + stop <= file.numBytes && extras.units_per_m > 0 && extras.frame_rate_hz > 0)) throw new RangeError();
    this.rateHz = extras.frame_rate_hz;
    this.startFrame = extras.start_frame;
    this.unitsPerM = extras.units_per_m;
    this.originM = extras.origin_m ?? [0, 0, 0];
    this.#present = extras.present ?? null;
  }

  /** Take the keys from the bytes of the file in `range`. */
  fill(bytes) {
    const first = this.range[0] - this.start;
    this.channels = this.parts.map(({ node, path, byteOffset, length }) => ({ node, path, values: new Float32Array(bytes, byteOffset - first, length) }));
  }

  /** Row of the keys, with a fraction between two, at a time since the first frame of the take; null where the person is absent. */
  rowAt(seconds) {
    const frame = seconds * this.rateHz;
    const nearest = Math.round(frame);
    const row = nearest - this.startFrame;
    if (row < 0 || row >= this.#numRows) return null;
    if (this.#present?.some(([start, stop]) => nearest >= start && nearest < stop) === false) return null;
    return Math.min(this.#numRows - 1, Math.max(0, frame - this.startFrame));
  }
}

/** True if the meshes of a file are compressed in a way that the viewer does not read. */
export function isCompressed({ extensionsUsed = [] }) {
  return extensionsUsed.includes(DRACO);
}

/**
 * Leave in the JSON of a file what a picture of the moving character needs: one scene, meshes, and materials with colours.
 *
 * Each node gets its number as `extras`. The file is a stranger's: pictures that are not inside it are left out, and so are
 * lights and cameras. Shapes of faces that nothing moves would take more memory than the meshes.
 */
export function simplify(document) {
  const { nodes = [], meshes = [], materials = [], scenes = [] } = document;
  for (const name of ["animations", "cameras"]) delete document[name];
  Object.assign(document, { scenes: scenes.slice(document.scene ?? 0).slice(0, 1), scene: 0 });
  document.nodes = nodes.map((node, number) => ({ ...node, camera: undefined, extensions: undefined, extras: { node: number } }));
  document.materials = materials.map((material) => simplifyMaterial(material, document));
  const isShaped = (number) => [meshes[number], ...nodes.filter(({ mesh }) => mesh === number)].some(({ weights }) => weights?.some((weight) => weight !== 0));
  meshes.forEach((mesh, number) => {
    if (isShaped(number)) return;
    delete mesh.weights;
    for (const primitive of mesh.primitives) delete primitive.targets;
  });
}

function simplifyMaterial({ name, pbrMetallicRoughness: surface = {}, emissiveFactor, emissiveTexture, alphaMode, alphaCutoff, doubleSided, extensions }, document) {
  const kept = (texture) => (texture && isInside(texture, document) ? texture : undefined);
  const unlit = extensions?.KHR_materials_unlit;
  return {
    name,
    pbrMetallicRoughness: { baseColorFactor: surface.baseColorFactor, baseColorTexture: kept(surface.baseColorTexture) },
    emissiveFactor,
    emissiveTexture: kept(emissiveTexture),
    alphaMode,
    alphaCutoff,
    doubleSided,
    ...(unlit ? { extensions: { KHR_materials_unlit: unlit } } : {}),
  };
}

// True if the picture of a texture is in the file, in a format that browsers read.
function isInside({ index }, { textures = [], images = [] }) {
  const { source, extensions } = textures[index] ?? {};
  const image = images[extensions?.EXT_texture_webp?.source ?? extensions?.EXT_texture_avif?.source ?? source];
  return image !== undefined && (image.bufferView !== undefined || image.uri?.startsWith("data:") === true);
}
