// What all parts of the page share: requests, problems, elements. Texts are set by textContent, because names come from
// clients.

export const at = (id) => document.getElementById(id);

export class Problem extends Error {
  constructor(body, status = 0) {
    super(body?.detail ?? "The service does not answer.");
    this.items = body?.errors ?? [];
    this.hint = body?.hint;
    this.status = status;
  }
}

export async function call(path, method = "GET", sent = undefined) {
  let response;
  const headers = { Accept: "application/json", ...(sent && { "Content-Type": "application/json" }) };
  try {
    response = await fetch(path, { method, headers, body: sent && JSON.stringify(sent) });
  } catch {
    throw new Problem(null);
  }
  const body = response.status === 204 ? null : await response.json().catch(() => null);
  if (!response.ok) throw new Problem(body, response.status);
  return body;
}

export function clone(id) {
  return at(id).content.firstElementChild.cloneNode(true);
}

export function element(tag, text) {
  const made = document.createElement(tag);
  made.textContent = text;
  return made;
}

export function showProblem(place, problem) {
  place.replaceChildren();
  place.hidden = problem === null;
  if (problem === null) return;
  place.append(element("p", [problem.message, problem.hint].filter(Boolean).join(" ")));
  if (problem.items.length === 0) return;
  const list = document.createElement("ul");
  for (const item of problem.items) {
    const where = [item.file, item.camera, item.field].filter(Boolean).join(", ") || item.pointer;
    list.append(element("li", [where && `${where}:`, item.message, item.hint].filter(Boolean).join(" ")));
  }
  place.append(list);
}

export function sized(numBytes) {
  const units = ["B", "kB", "MB", "GB", "TB"];
  const power = Math.min(units.length - 1, Math.floor(Math.log10(Math.max(1, numBytes)) / 3));
  return `${(numBytes / 1000 ** power).toFixed(power > 1 ? 1 : 0)} ${units[power]}`;
}

// fetch does not report the progress of an upload; XMLHttpRequest does.
export function send(path, form, onProgress, stopped) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.upload.addEventListener("progress", (event) => onProgress(event.loaded, event.total));
    request.addEventListener("load", () => {
      let body = null;
      try { body = JSON.parse(request.responseText); } catch { /* not from the service */ }
      if (request.status < 300) resolve(body); else reject(new Problem(body, request.status));
    });
    request.addEventListener("error", () => reject(new Problem(null)));
    request.addEventListener("abort", () => resolve(null));
    stopped.addEventListener("abort", () => request.abort());
    request.open("POST", path);
    request.send(form);
  });
}

export const jsonPart = (value) => new Blob([JSON.stringify(value)], { type: "application/json" });
