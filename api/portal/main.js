// Starts the page. Without its libraries, which npm installs, it says what is missing; the service works all the same.

import { FRAME, LANGUAGE } from "./shared/strings/frame.js";

document.documentElement.lang = LANGUAGE;
import("./app.js").catch(async (error) => {
  const library = await fetch("/portal/vendor/lit-html/lit-html.js", { method: "HEAD" }).catch(() => null);
  const place = document.getElementById("view");
  const say = (tag, text) => place.append(Object.assign(document.createElement(tag), { textContent: text }));
  place.replaceChildren();
  if (library?.status === 404) {
    say("h1", FRAME.librariesTitle);
    for (const hint of FRAME.librariesHints) say("p", hint);
  } else {
    say("h1", FRAME.startTitle);
    say("p", FRAME.startHint(error.message));
  }
});
