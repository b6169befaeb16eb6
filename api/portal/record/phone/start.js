// Starts the phone's page, which `/record` is.

import("./phone_view.js").then(({ open }) => open(document.getElementById("phone")), () => {
  const place = document.getElementById("phone");
  const say = (tag, text) => place.append(Object.assign(document.createElement(tag), { textContent: text }));
  place.replaceChildren();
  say("h1", "The page could not be started");
  say("p", "Reload it. The libraries of the page may not be installed: the operator installs them by make setup.");
});
