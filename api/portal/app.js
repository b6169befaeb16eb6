// Frame of the page: signing in, navigation, the view of the address.

import { sending } from "./send/sending.js";
import { call, persistently, reached, RequestProblem, signedOut, useLink } from "./shared/api.js";
import { feed } from "./shared/feed.js";
import { percent } from "./shared/format.js";
import { hasEnded } from "./shared/jobs.js";
import { html, live, nothing, problemBox, prose, render } from "./shared/lit.js";
import { canNotify, noticeEnds, notifies, setNotices } from "./shared/notices.js";
import { announce, currentRoute, replace, setTitle } from "./shared/page.js";
import { PROBLEMS } from "./shared/strings/common.js";
import { FRAME } from "./shared/strings/frame.js";

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
  plan: () => import("./plan/view.js"),
  scene: () => import("./scene/view.js"),
  jobs: () => import("./jobs/view.js"),
};
const NAV = [["new", "write"], ["captures", "read"], ["record", "write"], ["live", "write"], ["calibrations", "read"]];

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
  setTitle(view.title);
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
    if (sending.rows.length || performance.now() < NEW_MS) throw new RequestProblem({ detail: PROBLEMS.viewMissing, hint: PROBLEMS.filesAgain }, 500);
    location.reload();
    return new Promise(() => {});
  }
}

function showAway(name, problem) {
  view?.close();
  view = null;
  const label = FRAME.nav[name];
  showPlace((place) => render(html`<h1 class="title">${label}</h1>${problemBox(problem)}`, place));
  showNav(name);
  setTitle(label);
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
  const links = NAV.filter(([, scope]) => caller.scopes.includes(scope));
  render(html`${links.map(([to]) => html`<a href="#/${to}" aria-current=${to === name ? "page" : nothing}>${FRAME.nav[to]}</a>`)}`, at("nav"));
}

function showStatus() {
  const upload = sending.progress();
  const atWork = feed.newest().filter((job) => !hasEnded(job));
  const { id } = currentRoute();
  const shown = feed.jobs.has(id) ? atWork.find((job) => job.id === id) : atWork[0];
  setTitle(undefined, shown && shown.state !== "queued" ? percent(shown.progress) : null);
  const notify = (event) => setNotices(event.target.checked).finally(showStatus);
  render(html`
    ${atWork.length && canNotify() ? html`<label class="with"><input type="checkbox" .checked=${live(notifies())} @change=${notify}>${FRAME.notify}</label>` : nothing}
    ${feed.problem && caller ? html`<span class="away" role="alert">${feed.problem.message}</span>` : nothing}
    ${upload === null ? nothing : html`<a class="sending" href="#/new">${upload}</a>`}
    ${caller?.name ? html`<span class="caller">${FRAME.caller(caller.name, caller.tenant)}</span>
      <button type="button" class="button small" @click=${leave}>${FRAME.signOut}</button>` : nothing}
  `, at("status"));
}

function showEntrance(problem = null) {
  feed.stop();
  view?.close();
  view = caller = null;
  showNav("");
  showStatus();
  setTitle(FRAME.signIn);
  const place = document.createElement("div");
  at("view").replaceChildren(place);
  const draw = (shown) => render(html`<section class="panel entrance" aria-labelledby="entrance-title">
    <h1 id="entrance-title">${FRAME.signIn}</h1>
    <form @submit=${submit}>
      <label class="field"><span>${FRAME.key}</span>
        <input name="key" type="password" required maxlength="200" placeholder="mc_…" autocomplete="current-password" spellcheck="false">
      </label>
      <p class="quiet">${prose(FRAME.keyHint)}</p>
      <div class="actions"><button class="button primary">${FRAME.signIn}</button></div>
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

// Form of a key, and how a text that is no key differs.
function lookOfKey(text) {
  const length = text.length - KEY_PREFIX.length;
  let fault = FRAME.keyUnknown;
  if (!text.startsWith(KEY_PREFIX)) fault = FRAME.keyStart(KEY_PREFIX);
  else if (/[^\w-]/.test(text)) fault = FRAME.keyCharacters;
  else if (length !== KEY_LENGTH) fault = FRAME.keyLength(KEY_PREFIX, length);
  return `${FRAME.keyForm(KEY_PREFIX, KEY_LENGTH)} ${fault}`;
}

// The link that opened the page opens nothing any more.
function showEndedLink() {
  feed.stop();
  view?.close();
  view = caller = null;
  showStatus();
  setTitle(FRAME.linkEnded);
  const place = document.createElement("div");
  at("view").replaceChildren(place);
  render(html`<section class="panel entrance" aria-labelledby="ended-title" role="alert">
    <h1 id="ended-title">${FRAME.linkEndedTitle}</h1>
    <p>${FRAME.linkEndedHint}</p>
  </section>`, place);
}

// The next person at this browser may have another key: no view keeps anything.
async function leave() {
  sending.clear();
  await call("/v1/browser-session", { method: "DELETE" }).catch(() => null);
  location.reload();
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
feed.addEventListener("change", () => { noticeEnds(feed.jobs.values()); showStatus(); });
sending.addEventListener("change", showStatus);
addEventListener("hashchange", () => {
  // Views of a link and of a key are not mixed.
  if (linkSecret(currentRoute()) !== openedBy) location.reload();
  else navigate();
});
document.querySelector(".skip").textContent = FRAME.skip;
document.querySelector(".foot a").textContent = FRAME.api;
at("help").textContent = FRAME.help;
at("nav").ariaLabel = FRAME.views;
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault(); // the address' hash names the view
  at("view").focus();
});
enter();
