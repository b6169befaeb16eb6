// Frame of the page: signing in, navigation, the view of the address.

import { sending } from "./send/sending.js";
import { call, persistently, reached, RequestProblem, signedOut, useLink } from "./shared/api.js";
import { feed } from "./shared/feed.js";
import { html, nothing, problemBox, render } from "./shared/lit.js";
import { announce, currentRoute, replace } from "./shared/page.js";

const NEW_MS = 10_000;
const [KEY_PREFIX, KEY_LENGTH] = ["mc_", 43];
// A guest opened the page by a link to one job, which is all that the link opens.
const GUEST = { name: null, scopes: [], isGuest: true };

// A view's module has `open(place, route, caller)`, which fills the place and returns `{ title, close() }`.
const VIEWS = {
  new: () => import("./send/view.js"),
  captures: () => import("./watch/view.js"),
  record: () => import("./record/view.js"),
  live: () => import("./live/view.js"),
  calibrations: () => import("./calibrations/view.js"),
  jobs: () => import("./jobs/view.js"),
};
const NAV = [["new", "New capture", "write"], ["captures", "Captures", "read"], ["record", "Record", "write"], ["live", "Live", "write"], ["calibrations", "Calibrations", "read"]];

const at = (id) => document.getElementById(id);
let caller = null;
let view = null;
let opening = 0; // number of the navigation, so that a slow module does not open over a later one

async function navigate({ isFirst = false } = {}) {
  const route = currentRoute();
  if (caller === null) return;
  if (!(route.name in VIEWS)) return replace(startView());
  const number = ++opening;
  const isOver = () => number !== opening;
  let module;
  try {
    module = await persistently(() => load(route.name), { isOver, away: (problem) => showAway(route.name, problem) });
  } catch (problem) {
    if (!isOver()) showAway(route.name, problem);
    return;
  }
  if (isOver()) return;
  view?.close();
  const place = document.createElement("div");
  place.className = `view view-${route.name}`;
  at("view").replaceChildren(place);
  view = module.open(place, route, caller);
  showNav(route.name);
  document.title = `${view.title} · Multicap`;
  scrollTo(0, 0);
  if (isFirst) return;
  at("view").focus({ preventScroll: true });
  announce(view.title);
}

// Module of a view. A browser that could not load a module may keep that for good; the page is then loaded again, unless it is
// new itself, or has files that would have to be chosen again.
async function load(name) {
  try {
    return await VIEWS[name]();
  } catch {
    if (!await reached()) throw new RequestProblem(null);
    if (sending.rows.length || performance.now() < NEW_MS) throw new RequestProblem({ detail: "The view can't be loaded. Reload the page.", hint: "The files have to be chosen again." }, 500);
    location.reload();
    return new Promise(() => {});
  }
}

function showAway(name, problem) {
  view?.close();
  view = null;
  const [, label] = NAV.find(([to]) => to === name) ?? [name, "Job"];
  showPlace((place) => render(html`<h1 class="title">${label}</h1>${problemBox(problem)}`, place));
  showNav(name);
  document.title = `${label} · Multicap`;
}

function showPlace(fill) {
  const place = document.createElement("div");
  place.className = "view";
  at("view").replaceChildren(place);
  fill(place);
}

function linkSecret(route) {
  return route.name === "jobs" ? route.query.get("link") : null;
}

function startView() {
  return feed.jobs.size === 0 && caller.scopes.includes("write") ? "new" : "captures";
}

function showNav(name) {
  at("nav").hidden = caller === null || caller === GUEST;
  if (at("nav").hidden) return;
  const links = NAV.filter(([, , scope]) => caller.scopes.includes(scope));
  render(html`${links.map(([to, label]) => html`<a href="#/${to}" aria-current=${to === name ? "page" : nothing}>${label}</a>`)}`, at("nav"));
}

function showStatus() {
  const upload = sending.progress();
  render(html`
    ${feed.problem && caller ? html`<span class="away" role="alert">${feed.problem.message}</span>` : nothing}
    ${upload === null ? nothing : html`<a class="sending" href="#/new">${upload}</a>`}
    ${caller?.name ? html`<span class="caller">${caller.name}, ${caller.tenant}</span>
      <button type="button" class="button small" @click=${leave}>Sign out</button>` : nothing}
  `, at("status"));
}

function showEntrance(problem = null) {
  feed.stop();
  view?.close();
  view = caller = null;
  showNav("");
  showStatus();
  document.title = "Sign in · Multicap";
  const place = document.createElement("div");
  at("view").replaceChildren(place);
  const draw = (shown) => render(html`<section class="panel entrance" aria-labelledby="entrance-title">
    <h1 id="entrance-title">Sign in</h1>
    <form @submit=${submit}>
      <label class="field"><span>Key</span>
        <input name="key" type="password" required maxlength="200" placeholder="mc_…" autocomplete="current-password" spellcheck="false">
      </label>
      <p class="quiet">The operator of the service creates keys: <code>multicap keys create</code>.</p>
      <div class="actions"><button class="button primary">Sign in</button></div>
      ${problemBox(shown)}
    </form>
  </section>`, place);
  const submit = async (event) => {
    event.preventDefault();
    try {
      await call("/v1/browser-session", { method: "POST", body: { key: event.target.elements.key.value.trim() } });
      await enter();
    } catch (refused) {
      const hint = refused.status === 401 ? lookOfKey(event.target.elements.key.value.trim()) : refused.hint;
      draw({ message: refused.message, hint, items: refused.items });
    }
  };
  draw(problem);
  place.querySelector("input").focus();
}

// What a key looks like, and how a text that is no key differs.
function lookOfKey(text) {
  const look = `A key is ${KEY_PREFIX} and ${KEY_LENGTH} letters, digits, - or _, in one piece.`;
  if (!text.startsWith(KEY_PREFIX)) return `${look} What was typed does not begin with ${KEY_PREFIX}.`;
  const length = text.length - KEY_PREFIX.length;
  if (/[^\w-]/.test(text)) return `${look} What was typed has other characters.`;
  if (length !== KEY_LENGTH) return `${look} What was typed has ${length} after ${KEY_PREFIX}: copy the whole key.`;
  return `${look} What was typed looks like one: it is of another service, or was revoked. Ask the operator for a new key.`;
}

// The link that opened the page opens nothing any more.
function showEndedLink() {
  feed.stop();
  view?.close();
  view = caller = null;
  showStatus();
  document.title = "Link ended · Multicap";
  const place = document.createElement("div");
  at("view").replaceChildren(place);
  render(html`<section class="panel entrance" aria-labelledby="ended-title" role="alert">
    <h1 id="ended-title">This link has ended or was revoked</h1>
    <p>Ask the person who sent you the link for a new one.</p>
  </section>`, place);
}

async function leave() {
  sending.clear(); // the next person at this browser may have another key
  await call("/v1/browser-session", { method: "DELETE" }).catch(() => null);
  showEntrance();
}

async function enterByLink(route, secret) {
  useLink(secret);
  caller = GUEST;
  await feed.startOnly(route.id);
  if (caller === null) return; // the link has ended
  await navigate({ isFirst: true });
}

async function enter() {
  const route = currentRoute();
  const secret = linkSecret(route);
  if (secret !== null) return enterByLink(route, secret);
  try {
    const away = (problem) => showPlace((place) => render(problemBox(problem), place));
    caller = await persistently(() => call("/v1/caller"), { away });
  } catch (problem) {
    if (problem.status === 401) return showEntrance();
    showPlace((place) => render(problemBox(problem), place));
    return;
  }
  await feed.start();
  if (caller === null) return; // signed out meanwhile
  showStatus();
  if (caller.scopes.includes("write")) sending.resume();
  await navigate({ isFirst: true });
  // The other views are there when they are opened, also without a connection.
  for (const open of Object.values(VIEWS)) open().catch(() => null);
}

const openedBy = linkSecret(currentRoute());
signedOut.addEventListener("signedout", () => {
  if (caller === GUEST) showEndedLink();
  else if (caller !== null) showEntrance();
});
feed.addEventListener("change", showStatus);
sending.addEventListener("change", showStatus);
addEventListener("hashchange", () => {
  // What a link opened is not mixed with what a key opens.
  if (linkSecret(currentRoute()) !== openedBy) location.reload();
  else navigate();
});
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault(); // the address' hash names the view
  at("view").focus();
});
enter();
