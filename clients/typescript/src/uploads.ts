/** Resumable uploads of files by tus, from browsers and from Node.js. */

import { type DetailedError, Upload, type UploadOptions } from "tus-js-client";
import { ServiceError } from "./errors.js";
import { retryAfterMs } from "./http.js";

/** Bytes with a name; a stream needs its number of bytes too. */
export interface NamedContent {
  /** Name of the file; the service finds its camera by it. */
  name: string;
  content: Blob | ReadableStream<Uint8Array> | AsyncIterable<Uint8Array>;
  /** Number of bytes of a stream. */
  size?: number;
}

/** File to send: a `File`, bytes with a name, in Node.js a path, or the https link of a video. */
export type Source = File | NamedContent | string;

/** Bytes that are sent, of all. */
export interface Progress {
  sent: number;
  total: number;
}

export interface UploadRequest {
  endpoint: string;
  headers: Record<string, string>;
  onProgress?: (progress: Progress) => void;
  signal?: AbortSignal;
}

const PARALLEL = 2;
const RETRY_DELAYS_MS = [0, 1000, 3000, 5000, 10_000, 20_000];
// A stream can't be read again: this much of it is kept until the service has it.
const STREAM_PIECE_BYTES = 8 * 1024 * 1024;

const builtin = globalThis.process?.getBuiltinModule as NodeJS.Process["getBuiltinModule"] | undefined;

/** True if the program runs in Node.js, not in a browser. */
export const isNode = builtin !== undefined;

/** Upload files, two at a time; return the ids of the uploads. If one fails, all are discarded. */
export async function uploadAll(sources: readonly Source[], request: UploadRequest): Promise<string[]> {
  const files = await Promise.all(sources.map(open));
  const total = files.reduce((sum, { size }) => sum + size, 0);
  const sent = files.map(() => 0);
  const ids: string[] = [];
  const failed = new AbortController();
  const signal = request.signal ? AbortSignal.any([request.signal, failed.signal]) : failed.signal;
  const queue = [...files.entries()];
  const sendNext = async (): Promise<void> => {
    const next = queue.shift();
    if (!next) return;
    const [index, file] = next;
    const onBytes = (bytes: number) => {
      sent[index] = bytes;
      request.onProgress?.({ sent: sent.reduce((sum, each) => sum + each, 0), total });
    };
    await upload(file, { ...request, signal, onBytes, onId: (id) => { ids[index] = id; } });
    onBytes(file.size);
    await sendNext();
  };
  try {
    await Promise.all(Array.from({ length: PARALLEL }, sendNext));
  } catch (error) {
    failed.abort(error);
    discard(ids, request);
    throw error;
  }
  return ids;
}

/** Delete uploads that no capture uses; the service deletes others after two days. */
export function discard(ids: readonly string[], { endpoint, headers }: UploadRequest): void {
  for (const id of ids.filter(Boolean)) Upload.terminate(`${endpoint}/${id}`, { headers, retryDelays: [] }).catch(() => {});
}

type Opened = Required<NamedContent>;

async function open(source: Source): Promise<Opened> {
  if (typeof source === "string") {
    if (!builtin) throw new TypeError("Paths open files in Node.js only; give a File.");
    const fs = builtin("node:fs");
    await fs.promises.access(source, fs.constants.R_OK);
    return open({ name: builtin("node:path").basename(source), content: await fs.openAsBlob(source) });
  }
  if (source instanceof Blob) return { name: source.name, content: source, size: source.size };
  const size = source.content instanceof Blob ? source.content.size : source.size;
  if (size === undefined) throw new TypeError(`State the size of the stream ${source.name}.`);
  return { ...source, size };
}

interface Reports {
  onBytes: (bytes: number) => void;
  onId: (id: string) => void;
}

function upload({ name, content, size }: Opened, { endpoint, headers, signal, onBytes, onId }: UploadRequest & Reports): Promise<void> {
  return new Promise((resolve, reject) => {
    signal?.throwIfAborted();
    const options: UploadOptions = {
      endpoint,
      headers,
      metadata: { filename: name },
      uploadSize: size,
      retryDelays: [...RETRY_DELAYS_MS],
      storeFingerprintForResuming: false,
      onProgress: onBytes,
      onUploadUrlAvailable: () => onId(task.url!.slice(task.url!.lastIndexOf("/") + 1)),
      onShouldRetry: ({ originalResponse: answer }, attempt, { retryDelays }) => {
        const status = answer?.getStatus() ?? 0;
        const wait = retryAfterMs(answer?.getHeader("Retry-After"));
        if (wait !== null && retryDelays) retryDelays[attempt] = wait;
        return status === 0 || status >= 500 || [409, 423, 429].includes(status);
      },
      onSuccess: () => resolve(),
      onError: (error) => reject(uploadError(name, error)),
    };
    const task = new Upload(...forTus(content, options));
    signal?.addEventListener("abort", () => {
      task.abort();
      reject(signal.reason);
    });
    task.start();
  });
}

// tus-js-client reads Blobs and readers in browsers, and streams of Node.js in Node.js.
function forTus(content: Opened["content"], options: UploadOptions): [Upload["file"], UploadOptions] {
  if (!(content instanceof Blob)) {
    const file = builtin
      ? builtin("node:stream").Readable.from(content as AsyncIterable<Uint8Array>, { objectMode: false })
      : (content as ReadableStream<Uint8Array>).getReader();
    return [file as Upload["file"], { ...options, chunkSize: STREAM_PIECE_BYTES }];
  }
  return [content, builtin ? { ...options, fileReader: { openFile: async (blob: Blob) => new BlobSource(blob) } } : options];
}

class BlobSource {
  readonly size: number;

  constructor(private readonly blob: Blob) {
    this.size = blob.size;
  }

  async slice(start: number, end: number) {
    const part = this.blob.slice(start, end);
    const bytes = builtin!("node:stream").Readable.fromWeb(part.stream() as import("node:stream/web").ReadableStream);
    return { value: Object.assign(bytes, { size: part.size }), done: end >= this.size };
  }

  close() {}
}

function uploadError(name: string, error: Error | DetailedError): ServiceError {
  const answer = "originalResponse" in error ? error.originalResponse : null;
  if (answer) return ServiceError.fromBody(answer.getBody(), answer.getStatus());
  return new ServiceError({ detail: `The upload of ${name} broke off: ${error.message}`, retryable: true });
}
