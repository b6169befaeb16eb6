// Starts the page. Without its libraries, which npm installs, it says what is missing; the service works all the same.

import("./app.js").catch(async (error) => {
  const library = await fetch("/portal/vendor/lit-html/lit-html.js", { method: "HEAD" }).catch(() => null);
  const place = document.getElementById("view");
  const say = (tag, text) => place.append(Object.assign(document.createElement(tag), { textContent: text }));
  place.replaceChildren();
  if (library?.status === 404) {
    say("h1", "The libraries of this page are not installed");
    say("p", "The operator installs them by `make setup` in the checkout, or by a wheel or an image built where npm can be reached.");
    say("p", "The command line and the web API work without them.");
  } else {
    say("h1", "The page could not be started");
    say("p", `Reload it. If that does not help, tell the operator: ${error.message}`);
  }
});
