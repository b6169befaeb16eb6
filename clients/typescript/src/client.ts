/** Client of a service: send a capture, follow its job, get the result files. */

import createClient, { type Client as ContractClient } from "openapi-fetch";
import type { components, paths } from "./contract.js";
import { resumed } from "./downloads.js";
import { ServiceError } from "./errors.js";
import { JobEvents } from "./events.js";
import { pause, sendPatiently, sendWhole } from "./http.js";
import { discard, isNode, type Progress, type Source, uploadAll } from "./uploads.js";

type Schemas = components["schemas"];

/** Job as the service describes it. */
export type Job = Schemas["JobOut"];
/** Choices of a job. */
export type JobSpec = Schemas["JobSpec"];
/** Facts about a capture: cameras, frame rates, offsets. */
export type Manifest = Schemas["Manifest"];
/** Result file of a job. */
export type Result = Schemas["ResultOut"];

/** Job, or its id alone. */
export type JobReference = Pick<Job, "id">;

type Files = Pick<Schemas["UploadedCapture"], "videos" | "calibration" | "points">;

export interface SubmitOptions {
  /** Facts about the capture beside its name. */
  manifest?: Omit<Manifest, "name">;
  /** Called while the files are sent. */
  onProgress?: (progress: Progress) => void;
  /** Stops the request; uploads are deleted. */
  signal?: AbortSignal;
}

const POLL_MS = 1000;
const ENDS: Partial<Record<Job["state"], string>> = {
  succeeded: "succeeded",
  failed: "failed",
  canceled: "was canceled",
  expired: "expired",
};

/**
 * Client of a service.
 *
 * @example
 * const client = Client.connect("https://multicap.example", { key });
 * const job = await client.submit("Walk", videos, calibration, { exports: ["bvh"] });
 * await client.follow(job, ({ progress }) => console.log(progress));
 * for (const { name } of await client.results(job)) await (await client.download(job, name)).blob();
 */
export class Client {
  /** All operations of the contract, with their types. Refusals are thrown as `ServiceError`. */
  readonly api: ContractClient<paths>;
  readonly #uploads: { endpoint: string; headers: Record<string, string> };

  private constructor(url: string, headers: Record<string, string>) {
    this.api = createClient<paths>({ baseUrl: url, headers, fetch: sendWhole });
    this.api.use({
      async onResponse({ response }) {
        if (response.status >= 400) throw ServiceError.fromBody(await response.text(), response.status);
      },
    });
    this.#uploads = { endpoint: new URL("v1/uploads", url).href, headers };
  }

  /**
   * Create a client of the service at an address; nothing is sent yet.
   *
   * @param url - Address, such as `https://multicap.example`.
   * @param options - `key` is an API key, `mc_...`; a service on the same machine may need none.
   * @throws TypeError if the address is not one of HTTP.
   */
  static connect(url: string, { key }: { key?: string } = {}): Client {
    const { href, protocol } = new URL(url.endsWith("/") ? url : `${url}/`);
    if (!/^https?:$/.test(protocol)) throw new TypeError(`${url} is not an address such as https://multicap.example.`);
    return new Client(href, key === undefined ? {} : { Authorization: `Bearer ${key}` });
  }

  /**
   * Send a capture and have it reconstructed.
   *
   * Files are sent by resumable uploads. The answer comes after the check of the files.
   *
   * @param name - Name of the capture for people.
   * @param videos - A video of each camera, with the camera's name as a word in its own; or as the manifest states.
   * The service fetches https links; the job waits for them.
   * @param calibration - Calibration of all cameras.
   * @param spec - Choices of the job.
   * @throws {@link ServiceError} with all problems of all files if the service refuses them.
   */
  async submit(name: string, videos: readonly Source[], calibration: Source, spec: JobSpec = {}, options: SubmitOptions = {}): Promise<Job> {
    const isLink = (source: Source) => typeof source === "string" && /^https?:\/\//.test(source);
    const sources = [...videos, calibration];
    return this.#submit(name, sources.filter((source) => !isLink(source)), spec, options, (ids) => {
      const uploads = ids.values();
      const all = sources.map((source) => (isLink(source) ? (source as string) : uploads.next().value!));
      return { videos: all.slice(0, -1), calibration: all.at(-1)! };
    });
  }

  /**
   * Send 3D points that another system has located, and have skeletons solved.
   *
   * @param points - TRC, C3D, BVH, CSV, NetCDF, NPY or 3D JSON, of people at one time.
   * @param options - The manifest may have `frame_rate_hz`, `units`, `up` and `names`.
   * @throws {@link ServiceError} with all problems of all files if the service refuses them.
   */
  async submitPoints(name: string, points: readonly Source[], spec: JobSpec = {}, options: SubmitOptions = {}): Promise<Job> {
    return this.#submit(name, points, spec, options, (ids) => ({ points: [...ids] }));
  }

  async #submit(name: string, sources: readonly Source[], spec: JobSpec, options: SubmitOptions, files: (ids: string[]) => Files): Promise<Job> {
    const { manifest, signal } = options;
    const request = { ...this.#uploads, ...options };
    const ids = await uploadAll(sources, request);
    const body = { ...files(ids), manifest: { ...manifest, name }, spec };
    try {
      const { data } = await this.api.POST("/v1/jobs/from-uploads", { body, ...(signal && { signal }) });
      return data!;
    } catch (error) {
      discard(ids, request);
      throw error;
    }
  }

  /**
   * Wait until a job succeeds.
   *
   * Updates come by the event stream of the job. While it does not pass, the job is read every second.
   *
   * @param onUpdate - Called with the job at every change: `progress`, `eta_s`, `stages`.
   * @returns Job that succeeded.
   * @throws {@link ServiceError} if the job fails, is canceled or deleted, or the service does not answer for a minute.
   */
  async follow(job: JobReference, onUpdate: (job: Job) => void = () => {}, { signal }: { signal?: AbortSignal } = {}): Promise<Job> {
    const params = { path: { job_id: job.id } };
    const events = new JobEvents(async (headers, signal) => {
      const { response } = await this.api.GET("/v1/jobs/{job_id}/events", { params, headers, signal, parseAs: "stream", fetch });
      return response;
    });
    let now: Job | null = null;
    for (;;) {
      if (events.arePassed) {
        for await (now of events.read(signal)) {
          onUpdate(now);
          if (ENDS[now.state]) return succeeded(now);
        }
      }
      now = (await this.api.GET("/v1/jobs/{job_id}", { params, ...(signal && { signal }) })).data!;
      onUpdate(now);
      if (ENDS[now.state]) return succeeded(now);
      await pause(POLL_MS, signal);
    }
  }

  /** Cancel a job; return it. */
  async cancel(job: JobReference): Promise<Job> {
    return (await this.api.POST("/v1/jobs/{job_id}/cancel", { params: { path: { job_id: job.id } } })).data!;
  }

  /** List the result files of a job. */
  async results(job: JobReference): Promise<Result[]> {
    return (await this.api.GET("/v1/jobs/{job_id}/results", { params: { path: { job_id: job.id } } })).data!.results;
  }

  /**
   * Download a result file.
   *
   * @param name - Name in the list of results.
   * @returns Response whose body continues by itself if the connection breaks.
   */
  async download(job: JobReference, name: string, { signal }: { signal?: AbortSignal } = {}): Promise<Response> {
    // A bucket of the service may refuse pages.
    const params = { path: { job_id: job.id, name }, query: { redirect: isNode } };
    const request = async (headers: Record<string, string> = {}) => {
      const init = { params, headers, parseAs: "stream", fetch: sendPatiently, ...(signal && { signal }) } as const;
      return (await this.api.GET("/v1/jobs/{job_id}/results/{name}", init)).response;
    };
    return resumed(request, signal);
  }
}

function succeeded(job: Job): Job {
  if (job.state === "succeeded") return job;
  const { detail, ...error } = job.error ?? { detail: "" };
  throw new ServiceError({ ...error, detail: `The job ${ENDS[job.state]}. ${detail}`.trim() });
}
