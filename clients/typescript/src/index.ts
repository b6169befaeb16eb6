/** Client of Multicap, a web service for markerless motion capture. */

export { Client, type Job, type JobReference, type JobSpec, type Manifest, type Result, type SubmitOptions } from "./client.js";
export type { components, paths } from "./contract.js";
export { type Problem, ServiceError } from "./errors.js";
export type { NamedContent, Progress, Source } from "./uploads.js";
