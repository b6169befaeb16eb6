// Choices of a job and the networks that are installed, as the service lists them.

import { call } from "./api.js";

const KEPT_MS = 30_000;

let options = null;
let readAt = -Infinity;

export async function readOptions() {
  if (performance.now() - readAt > KEPT_MS) {
    options = await call("/v1/options");
    readAt = performance.now();
  }
  return options;
}

/** Value of a choice as words. */
export function valueOf(choice, value) {
  const label = (item) => choice.values.find(({ name }) => name === item)?.label ?? String(item);
  return Array.isArray(value) ? value.map((item) => label(item ?? "…")).join(", ") : label(value);
}

// Choices of a spec that differ from the defaults, as words; an empty list if none does.
export function describeSpec(spec, { choices }) {
  const differs = (choice) => JSON.stringify(spec[choice.name] ?? null) !== JSON.stringify(choice.default ?? null);
  const describe = (choice) => (choice.kind === "flag"
    ? { label: spec[choice.name] ? "With" : "Without", value: choice.label }
    : { label: choice.label, value: valueOf(choice, spec[choice.name]) });
  const changed = choices.filter((choice) => choice.name in spec && differs(choice)).map(describe);
  return spec.character ? [...changed, { label: "With", value: "a character" }] : changed;
}
