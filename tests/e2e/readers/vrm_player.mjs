// World positions of the human bones of VRM characters in every frame of VRMA animations, as @pixiv/three-vrm-animation
// plays them: JSON on stdout. Arguments are pairs of a character and an animation.
import { readFileSync } from "node:fs";
import { VRMLoaderPlugin } from "@pixiv/three-vrm";
import { createVRMAnimationClip, VRMAnimationLoaderPlugin } from "@pixiv/three-vrm-animation";
import { AnimationMixer, LoopOnce, Vector3 } from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";

async function open(path) {
  const content = readFileSync(path);
  const loader = new GLTFLoader();
  loader.register((parser) => new VRMLoaderPlugin(parser));
  loader.register((parser) => new VRMAnimationLoaderPlugin(parser));
  const bytes = content.buffer.slice(content.byteOffset, content.byteOffset + content.byteLength);
  return (await loader.parseAsync(bytes, "")).userData;
}

const played = [];
for (let place = 2; place < process.argv.length; place += 2) {
  const { vrm } = await open(process.argv[place]);
  const { vrmAnimations } = await open(process.argv[place + 1]);
  const clip = createVRMAnimationClip(vrmAnimations[0], vrm);
  const mixer = new AnimationMixer(vrm.scene);
  const action = mixer.clipAction(clip).setLoop(LoopOnce);
  action.clampWhenFinished = true;
  action.play();
  const times = Array.from(clip.tracks[0].times);
  const names = Object.keys(vrm.humanoid.humanBones);
  const positions = times.map((time) => {
    mixer.setTime(time);
    vrm.update(0);
    vrm.scene.updateMatrixWorld(true);
    return names.map((name) => vrm.humanoid.getRawBoneNode(name).getWorldPosition(new Vector3()).toArray());
  });
  played.push({ names, times, positions });
}
process.stdout.write(JSON.stringify(played));
