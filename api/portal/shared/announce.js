// Messages for screen readers about changes that are only seen otherwise.

let last = "";

export function announce(text) {
  const place = document.getElementById("announcer");
  // A message that repeats the last one is read only if the text changes.
  last = text === last ? `${text}\u00a0` : text;
  place.textContent = last;
}
