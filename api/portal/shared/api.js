// Requests to the service.

export class Problem extends Error {
  // body: a problem of RFC 9457, or null if the service did not answer.
  constructor(body, status = 0) {
    super(body?.detail ?? "The service does not answer. Check that it runs and that you are connected.");
    this.code = body?.code ?? null;
    this.items = body?.errors ?? [];
    this.hint = body?.hint ?? null;
    this.status = status;
  }
}

// Answer's JSON; null of an empty answer. `signedOut` hears of requests that need a key.
export async function call(path, { method = "GET", body, form, headers: more } = {}) {
  const headers = { Accept: "application/json", ...more, ...(body !== undefined && { "Content-Type": "application/json" }) };
  let response;
  try {
    response = await fetch(path, { method, headers, body: form ?? (body && JSON.stringify(body)) });
  } catch {
    throw new Problem(null);
  }
  const answer = response.status === 204 ? null : await response.json().catch(() => null);
  if (response.ok) return answer;
  if (response.status === 401) signedOut.dispatchEvent(new Event("signedout"));
  throw new Problem(answer, response.status);
}

export const signedOut = new EventTarget();

export const jsonPart = (value) => new Blob([JSON.stringify(value)], { type: "application/json" });
