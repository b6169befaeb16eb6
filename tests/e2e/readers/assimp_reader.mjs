// World positions of all joints in every frame of FBX files, as assimp finds them: JSON on stdout.
import { readFileSync } from "node:fs";
import { basename } from "node:path";
import assimp from "assimpjs";
import { Matrix4, Quaternion, Vector3 } from "three";

const library = await assimp();

function open(path) {
  const files = new library.FileList();
  files.AddFile(basename(path), readFileSync(path));
  const result = library.ConvertFileList(files, "assjson");
  if (!result.IsSuccess()) throw new Error(`${path}: ${result.GetErrorCode()}`);
  return JSON.parse(new TextDecoder().decode(result.GetFile(0).GetContent()));
}

const read = {};
for (const path of process.argv.slice(2)) {
  const scene = open(path);
  const [animation] = scene.animations;
  const channels = new Map(animation.channels.map((channel) => [channel.name, channel]));
  const times = animation.channels[0].rotationkeys.map(([tick]) => tick / animation.tickspersecond);
  const names = [];
  const positions = times.map(() => []);
  // Nodes below the one at the top are joints; beside it is the body.
  const visit = (node, parents, isJoint) => {
    const channel = channels.get(node.name);
    const own = parents.map((parent, frame) => {
      const still = new Matrix4().set(...node.transformation);
      if (!channel) return parent.clone().multiply(still);
      const [w, x, y, z] = channel.rotationkeys[frame][1];
      const moved = new Matrix4().compose(
        new Vector3(...channel.positionkeys[frame][1]), new Quaternion(x, y, z, w), new Vector3(1, 1, 1),
      );
      return parent.clone().multiply(moved);
    });
    if (isJoint) {
      names.push(node.name);
      own.forEach((matrix, frame) => positions[frame].push(new Vector3().setFromMatrixPosition(matrix).toArray()));
    }
    for (const child of node.children ?? []) visit(child, own, isJoint);
  };
  const stills = times.map(() => new Matrix4());
  for (const top of scene.rootnode.children) for (const child of top.children ?? []) visit(child, stills, true);
  read[path] = { names, times, positions };
}
process.stdout.write(JSON.stringify(read));
