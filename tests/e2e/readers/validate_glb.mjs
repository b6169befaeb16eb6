// What the Khronos validator says of GLB files: JSON on stdout.
import { readFileSync } from "node:fs";
import validator from "gltf-validator";

const reports = {};
for (const path of process.argv.slice(2)) {
  reports[path] = await validator.validateBytes(new Uint8Array(readFileSync(path)));
}
process.stdout.write(JSON.stringify(reports));
