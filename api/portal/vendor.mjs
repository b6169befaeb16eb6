// Copies the libraries of the page from npm's packages to vendor/, which the service serves; npm runs it after `npm ci`.
// They are ready ES modules that import each other by relative paths: the page needs neither a bundler nor an import map.
// A report is one file without a network: its viewer is bundled with the libraries, into pipeline/export/report/assets.

import { buildSync } from "esbuild";
import { cpSync, mkdirSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const vendor = join(here, "vendor");

// Files by package: path in the package, path under vendor/.
const FILES = {
  "lit-html": [
    "async-directive.js", "directive-helpers.js", "directive.js", "directives/keyed.js", "directives/live.js",
    "directives/ref.js", "directives/repeat.js", "lit-html.js",
  ].map((name) => [name, `lit-html/${name}`]),
  three: [
    ["build/three.core.js", "three/three.core.js"],
    ["build/three.module.js", "three/three.module.js"],
    ...["controls/OrbitControls.js", "loaders/GLTFLoader.js", "utils/BufferGeometryUtils.js", "utils/SkeletonUtils.js"].map((name) => [`examples/jsm/${name}`, `three/addons/${name}`]),
  ],
  "tus-js-client": [["dist/tus.min.js", "tus.min.js"]],
  uplot: [["dist/uPlot.esm.js", "uPlot.esm.js"], ["dist/uPlot.min.css", "uPlot.min.css"]],
};

rmSync(vendor, { recursive: true, force: true });
for (const [name, files] of Object.entries(FILES)) {
  const folder = join(here, "node_modules", name);
  for (const [from, to] of files) copy(join(folder, from), to);
  const licence = readdirSync(folder).find((one) => /^licen[cs]e/i.test(one));
  cpSync(join(folder, licence), join(vendor, "licences", `${name}.txt`));
}

function copy(from, to) {
  const target = join(vendor, to);
  mkdirSync(dirname(target), { recursive: true });
  // Browsers resolve relative paths only: three.js' addons import "three". Source maps are not copied.
  const up = "../".repeat(Math.max(0, to.split("/").length - 2));
  const text = readFileSync(from, "utf8")
    .replace(/(from\s*|import\s*)(["'])three\2/g, `$1$2${up}three.module.js$2`)
    .replace(/^\/\/# sourceMappingURL=.*$/gm, "");
  writeFileSync(target, text);
}

buildSync({
  entryPoints: ["report.js", "viewer.css"].map((name) => ({ in: join(here, "viewer", name), out: "viewer" })),
  outdir: join(here, "..", "..", "pipeline", "export", "report", "assets"),
  bundle: true, minify: true, format: "esm", charset: "ascii",
  // Characters are not in reports.
  external: ["*/GLTFLoader.js", "*/SkeletonUtils.js"],
});
