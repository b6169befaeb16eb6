// Builds the package: types of the contract, modules with their types, and one module for pages without a bundler.

import { execFileSync } from "node:child_process";
import { copyFileSync, mkdirSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { buildSync } from "esbuild";
import openapiTS, { astToString } from "openapi-typescript";
import ts from "typescript";

process.chdir(import.meta.dirname);
rmSync("dist", { recursive: true, force: true });

const blob = ts.factory.createTypeReferenceNode("Blob");
const contract = await openapiTS(new URL("../../openapi/openapi.json", import.meta.url), {
  defaultNonNullable: false, // fields with a default may be left out
  transform: (schema) => (schema.format === "binary" ? blob : undefined),
});
writeFileSync("src/contract.ts", astToString(contract));
execFileSync(process.execPath, ["node_modules/typescript/bin/tsc"], { stdio: "inherit" });

const { metafile } = buildSync({
  absWorkingDir: import.meta.dirname, entryPoints: ["dist/index.js"], outfile: "dist/page.js", bundle: true, minify: true, format: "esm", platform: "browser", target: "es2022", metafile: true,
});
copyFileSync("../../LICENSE", "LICENSE");
mkdirSync("dist/licences");
const bundled = new Set(Object.keys(metafile.inputs).map((path) => /^node_modules\/((?:@[^/]+\/)?[^/]+)/.exec(path)?.[1]).filter(Boolean));
for (const name of bundled) {
  const licence = readdirSync(`node_modules/${name}`).find((file) => /^licen[cs]e/i.test(file));
  if (!licence) throw new Error(`${name} has no licence file.`);
  copyFileSync(`node_modules/${name}/${licence}`, `dist/licences/${name.replace("/", "-")}.txt`);
}
