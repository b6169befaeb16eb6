/** Event stream of a job, by `fetch`: an `EventSource` of browsers can't send a key. */

import { createParser } from "eventsource-parser";
import type { components } from "./contract.js";

type Job = components["schemas"]["JobOut"];

// A stream begins with the job, and something comes at least every 15 s. Some proxies keep it back.
const FIRST_BYTES_MS = 10_000;
const QUIET_MS = 45_000;
const MAX_FAILURES = 3;

/** Event streams of a job, one after the other; each continues after the last event of the one before. */
export class JobEvents {
  #lastEventId: string | null = null;
  #numFailures = 0;

  /** `open` requests a stream; its headers may have the id of the last event. */
  constructor(private readonly open: (headers: Record<string, string>, signal: AbortSignal) => Promise<Response>) {}

  /** True if another stream is worth a try. */
  get arePassed(): boolean {
    return this.#numFailures < MAX_FAILURES;
  }

  /** Read a stream until it ends, breaks or is quiet for too long. */
  async *read(signal?: AbortSignal): AsyncGenerator<Job> {
    this.#numFailures += 1;
    const quiet = new AbortController();
    const stop = () => quiet.abort();
    let timer = setTimeout(stop, FIRST_BYTES_MS);
    const jobs: Job[] = [];
    const parser = createParser({
      onEvent: ({ id, event, data }) => {
        if (event !== "job") return;
        this.#lastEventId = id ?? this.#lastEventId;
        jobs.push(JSON.parse(data) as Job);
      },
    });
    try {
      const headers = this.#lastEventId === null ? {} : { "Last-Event-ID": this.#lastEventId };
      const response = await this.open(headers, signal ? AbortSignal.any([signal, quiet.signal]) : quiet.signal);
      const reader = response.status === 200 ? response.body?.pipeThrough(new TextDecoderStream()).getReader() : null;
      for (let piece = await reader?.read(); piece && !piece.done; piece = await reader?.read()) {
        this.#numFailures = 0;
        clearTimeout(timer);
        timer = setTimeout(stop, QUIET_MS);
        parser.feed(piece.value);
        yield* jobs.splice(0);
      }
    } catch {
      signal?.throwIfAborted(); // else the job is read by a plain request, which tells any other error
    } finally {
      clearTimeout(timer);
      quiet.abort();
    }
  }
}
