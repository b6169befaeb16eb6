/** Error of the service, with its problems. */

import type { components } from "./contract.js";

/** Problem of a request or of a job: code, sentence, and the file, camera or field that it concerns. */
export type Problem = Pick<components["schemas"]["ErrorItem"], "code" | "message" | "hint"> &
  Partial<components["schemas"]["ErrorItem"]>;

interface Details {
  code?: string;
  detail?: string;
  hint?: string | null;
  errors?: Problem[];
  retryable?: boolean;
  request_id?: string;
}

/** The service refused a request, failed or did not answer; or a job did not succeed. The message states the reason. */
export class ServiceError extends Error {
  override readonly name = "ServiceError";
  /** Stable code, such as `invalid_request`; `service_error` where the service states none. */
  readonly code: string;
  /** Advice to the caller. */
  readonly hint: string | null;
  /** Everything that is wrong with the request, or with the capture of a job. */
  readonly errors: readonly Problem[];
  /** True if the same request may succeed later. */
  readonly retryable: boolean;
  /** Id of the request, for the operator of the service. */
  readonly requestId: string | null;

  /** `status` is the HTTP status; 0 without an answer. */
  constructor(details: Details, readonly status = 0) {
    const items = (details.errors ?? []).map(({ file, message }) => (file ? `${file}: ${message}` : message));
    super([details.detail, ...items, details.hint].filter(Boolean).join(" "));
    this.code = details.code ?? "service_error";
    this.hint = details.hint ?? null;
    this.errors = details.errors ?? [];
    this.retryable = details.retryable ?? false;
    this.requestId = details.request_id ?? null;
  }

  /** Build the error from the body of a refusal; a proxy may send a body of its own. */
  static fromBody(body: string, status: number): ServiceError {
    try {
      const details: unknown = JSON.parse(body);
      if (typeof details === "object" && details !== null && "detail" in details) return new ServiceError(details as Details, status);
    } catch {
      // It is no JSON.
    }
    return new ServiceError({ detail: `The service answered ${status}.` }, status);
  }
}
