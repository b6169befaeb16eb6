// Parts of the whole page: an announcer, its title, and addresses of its views.

import { FRAME } from "./strings/frame.js";

let last = "";

export function announce(text) {
  const place = document.getElementById("announcer");
  // A message that repeats the last one is read only if the text changes.
  last = text === last ? `${text}\u00a0` : text;
  place.textContent = last;
}

// Save a file on the device.
export function save(file) {
  const link = Object.assign(document.createElement("a"), { download: file.name, href: URL.createObjectURL(file) });
  link.click();
  URL.revokeObjectURL(link.href);
}

// Title of the page: the share of a job that is done, if one is at work, and the view.

let [title, share] = ["", null];

export function setTitle(name = title, done = share) {
  [title, share] = [name, done];
  document.title = FRAME.title(share === null ? title : FRAME.shareOf(share, title));
}

// Views by the address' hash: `#/captures`, `#/jobs/ID`. Addresses of the service itself stay its API's.

export function currentRoute() {
  const [path, query = ""] = location.hash.replace(/^#\/?/, "").split("?");
  const [name = "", ...rest] = path.split("/").map(decodeURIComponent);
  return { name, id: rest[0] ?? null, query: new URLSearchParams(query) };
}

export const address = (name, id = null) => `#/${name}${id === null ? "" : `/${encodeURIComponent(id)}`}`;

export function go(name, id = null) {
  location.hash = address(name, id);
}

// Change the address without a step in the browser's history.
export function replace(name, id = null) {
  history.replaceState(null, "", address(name, id));
  dispatchEvent(new HashChangeEvent("hashchange"));
}
