// World positions of all bones in every frame of BVH, GLB and FBX files, as three.js finds them: JSON on stdout.
// After the argument --areas also the area of each body as it is drawn, in every frame. Of scenes also the nodes at the top
// above bones, boxes of meshes without a skin, and cameras.
import { readFileSync } from "node:fs";
import { AnimationMixer, Box3, LoopOnce, Triangle, Vector3 } from "three";
import { BVHLoader } from "three/examples/jsm/loaders/BVHLoader.js";
import { FBXLoader } from "three/examples/jsm/loaders/FBXLoader.js";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";

// FBXLoader looks up the size of the page, which cameras with a size of their own don't use.
globalThis.window ??= { innerWidth: 1, innerHeight: 1 };

async function open(path) {
  const content = readFileSync(path);
  if (path.endsWith(".bvh")) {
    const { skeleton, clip } = new BVHLoader().parse(content.toString("utf-8"));
    return { root: skeleton.bones[0], top: skeleton.bones[0], clip };
  }
  const bytes = content.buffer.slice(content.byteOffset, content.byteOffset + content.byteLength);
  if (path.endsWith(".fbx")) {
    const scene = new FBXLoader().parse(bytes, "");
    return { root: scene, top: scene, clip: scene.animations[0], scene };
  }
  const gltf = await new GLTFLoader().parseAsync(bytes, "");
  return { root: gltf.scene, top: gltf.scene, clip: gltf.animations[0], scene: gltf.scene };
}

// Area of the triangles of a body as they are drawn.
function areaOf(mesh) {
  const corners = Array.from({ length: mesh.geometry.attributes.position.count }, (_, vertex) => mesh.getVertexPosition(vertex, new Vector3()));
  // Meshes of FBX files have no index.
  const array = mesh.geometry.index?.array ?? corners.map((_, vertex) => vertex);
  let area = 0;
  for (let start = 0; start < array.length; start += 3) area += new Triangle(...[0, 1, 2].map((k) => corners[array[start + k]])).getArea();
  return area;
}

const withAreas = process.argv.includes("--areas");
const read = {};
for (const path of process.argv.slice(2).filter((argument) => argument !== "--areas")) {
  const { root, top, clip, scene } = await open(path);
  const times = Array.from(clip.tracks[0].times);
  const bones = [];
  root.traverse((node) => node.isBone && bones.push(node));
  const skinned = [];
  scene?.traverse((node) => node.isSkinnedMesh && skinned.push(node));
  const mixer = new AnimationMixer(top);
  const action = mixer.clipAction(clip).setLoop(LoopOnce);
  action.clampWhenFinished = true;
  action.play();
  const areas = [];
  const positions = times.map((time) => {
    mixer.setTime(time);
    top.updateMatrixWorld(true);
    if (withAreas) areas.push(skinned.map(areaOf));
    return bones.map((bone) => bone.getWorldPosition(new Vector3()).toArray());
  });
  const topOf = (node) => (node.parent === scene || !node.parent ? node : topOf(node.parent));
  const meshes = {}, cameras = {};
  scene?.traverse((node) => {
    if (node.isCamera) cameras[node.userData.name ?? node.name] = { fov: node.fov, aspect: node.aspect, matrix: node.matrixWorld.toArray(), facts: node.userData };
    else if (node.isMesh && !node.isSkinnedMesh) meshes[node.name] = new Box3().setFromObject(node);
  });
  read[path] = { names: bones.map((bone) => bone.userData.originalName ?? bone.userData.name ?? bone.name), times, positions, areas, tops: bones.map((bone) => topOf(bone).userData.name ?? topOf(bone).name), meshes, cameras };
  if (scene) {
    // Of the last frame: the lowest and highest point of the body as it is drawn.
    const heights = skinned.flatMap((mesh) => {
      const point = new Vector3();
      return Array.from({ length: mesh.geometry.attributes.position.count }, (_, vertex) =>
        mesh.localToWorld(mesh.getVertexPosition(vertex, point)).y);
    });
    read[path].body = [Math.min(...heights), Math.max(...heights)];
  }
}
process.stdout.write(JSON.stringify(read));
