// Starts the phone's page, which `/record` is.

import { PHONE } from "../../shared/strings/phone.js";

import("./phone_view.js").then(({ open }) => open(document.getElementById("phone")), () => {
  const place = document.getElementById("phone");
  const say = (tag, text) => place.append(Object.assign(document.createElement(tag), { textContent: text }));
  place.replaceChildren();
  say("h1", PHONE.startTitle);
  say("p", PHONE.startHint);
});
