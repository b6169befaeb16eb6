// Page of the service: its jobs with their progress, and a form to send a capture.

import { chosenCalibration, refreshCalibrations } from "./calibrations.js";
import { at, call, clone, element, jsonPart, Problem, send, showProblem, sized } from "./common.js";

const POLL_MS = 1000;
const IDLE_POLL_MS = 5000;
const OPTIONS_MS = 30000;
const PAGE = 50;
const MOST = 200;

const STATES = {
  queued: "Waiting", running: "Running", canceling: "Canceling", succeeded: "Done",
  failed: "Failed", canceled: "Canceled", expired: "Expired",
};
const ENDED = new Set(["succeeded", "failed", "canceled", "expired"]);

const cards = new Map(); // id of a job -> its element, and the version that it shows
let limit = PAGE;
let timer = 0;
let choices = []; // choices of a job that the service lists
let optionsAt = -Infinity; // time of the last request of the options

function lasting(seconds) {
  if (seconds < 90) return `${Math.max(1, Math.round(seconds))} s`;
  return seconds < 5400 ? `${Math.round(seconds / 60)} min` : `${Math.round(seconds / 3600)} h`;
}

function when(job) {
  const date = new Date(job.created_at).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
  const parts = [date];
  if (job.attempt > 1) parts.push(`attempt ${job.attempt}`);
  if (job.state === "queued" && job.queue_position) parts.push(`number ${job.queue_position} in the queue`);
  if (job.state === "running" && job.eta_s !== null) parts.push(`about ${lasting(job.eta_s)} left`);
  if (job.started_at && job.finished_at) {
    parts.push(`took ${Math.max(1, Math.round((new Date(job.finished_at) - new Date(job.started_at)) / 1000))} s`);
  }
  if (job.state === "succeeded" && job.expires_at) {
    parts.push(`kept until ${new Date(job.expires_at).toLocaleDateString([], { dateStyle: "medium" })}`);
  }
  return parts.join(" · ");
}

function counted(stage) {
  if (stage.state === "done") return stage.reused ? "done before" : "done";
  if (stage.state === "waiting" || stage.done === 0) return "";
  return `${stage.done} / ${stage.total}`;
}

function fillStages(place, stages) {
  while (place.children.length > stages.length) place.lastElementChild.remove();
  while (place.children.length < stages.length) place.append(clone("stage"));
  stages.forEach((stage, index) => {
    const row = place.children[index];
    row.querySelector(".label").textContent = stage.label;
    row.querySelector(".count").textContent = counted(stage);
    const bar = row.querySelector("progress");
    bar.value = stage.fraction;
    bar.setAttribute("aria-label", stage.label);
  });
}

async function fillResults(card, job) {
  const place = card.querySelector(".results");
  place.replaceChildren();
  place.hidden = true;
  if (job.state !== "succeeded") return;
  const { results } = await call(job.links.results);
  const add = (address, name, ...more) => {
    const link = Object.assign(element("a", name), { href: address, download: "" });
    link.append(...more);
    const item = document.createElement("li");
    item.append(link);
    place.append(item);
  };
  for (const result of results) {
    add(result.link, result.name, Object.assign(element("span", sized(result.num_bytes)), { className: "quiet" }));
  }
  add(job.links.results_zip, "All as ZIP");
  place.hidden = results.length === 0;
}

async function act(card, path, method) {
  const buttons = card.querySelectorAll("button");
  buttons.forEach((button) => { button.disabled = true; });
  try {
    await call(path, method);
    await refresh();
  } catch (problem) {
    showProblem(card.querySelector(".problems"), problem);
  } finally {
    buttons.forEach((button) => { button.disabled = false; });
  }
}

function showWarnings(place, warnings) {
  place.replaceChildren(...warnings.map((warning) => element("li", warning)));
  place.hidden = warnings.length === 0;
}

// Text and style of a job's state; a succeeded job may be empty or have warnings.
function stateOf(job) {
  if (job.state !== "succeeded") return [STATES[job.state] ?? job.state, job.state];
  if (job.result_warnings.some((warning) => warning.code === "nobody_found")) return ["Done: nobody was found", "empty"];
  return job.result_warnings.length > 0 ? ["Done, with warnings", "warned"] : [STATES.succeeded, job.state];
}

function makeCard(job) {
  const card = clone("job");
  const on = (name, run) => card.querySelector(`[data-do="${name}"]`).addEventListener("click", run);
  const entry = { card, shown: "", links: job.links };
  on("cancel", () => act(card, entry.links.cancel, "POST"));
  on("retry", () => act(card, entry.links.retry, "POST"));
  on("delete", () => {
    if (window.confirm("Delete this job and its results?")) act(card, entry.links.self, "DELETE");
  });
  const kind = job.kind === "calibration" ? "Calibration: " : "";
  card.querySelector(".name").textContent = kind + job.session_name;
  return entry;
}

function fillCard(entry, job) {
  const { card } = entry;
  const state = card.querySelector(".state");
  const percent = job.state === "running" ? ` ${Math.floor(job.progress * 100)} %` : "";
  const [words, kind] = stateOf(job);
  state.textContent = words + percent;
  state.dataset.state = kind;
  card.querySelector(".when").textContent = when(job);
  fillStages(card.querySelector(".stages"), job.stages);
  // Actions that the service offers: no retry if it would fail the same way.
  entry.links = job.links;
  card.querySelector('[data-do="cancel"]').hidden = job.links.cancel === null;
  card.querySelector('[data-do="retry"]').hidden = job.links.retry === null;
  card.querySelector('[data-do="delete"]').hidden = !ENDED.has(job.state);
  const shown = `${job.state} ${job.attempt}`;
  if (shown === entry.shown) return;
  entry.shown = shown;
  showProblem(card.querySelector(".problems"), job.error && new Problem(job.error));
  showWarnings(card.querySelector(".warnings"), job.warnings);
  fillResults(card, job).catch(() => { entry.shown = ""; });
}

async function refresh() {
  const { jobs, next_cursor: next } = await call(`/v1/jobs?limit=${limit}`);
  const ids = new Set(jobs.map((job) => job.id));
  for (const [id, { card }] of cards) {
    if (ids.has(id)) continue;
    card.remove();
    cards.delete(id);
  }
  jobs.forEach((job, index) => {
    if (!cards.has(job.id)) cards.set(job.id, makeCard(job));
    const entry = cards.get(job.id);
    fillCard(entry, job);
    const there = at("jobs").children[index];
    if (there !== entry.card) at("jobs").insertBefore(entry.card, there ?? null);
  });
  at("empty").hidden = jobs.length > 0;
  at("more").hidden = next === null || limit >= MOST;
  return jobs.some((job) => !ENDED.has(job.state));
}

function labelled(text, ...fields) {
  const label = element("label", text);
  label.append(...fields);
  return label;
}

function numberInput(choice, whole) {
  const named = choice.values.find(({ name }) => name === choice.default);
  return Object.assign(document.createElement("input"), {
    type: "number",
    name: choice.name,
    step: whole ? 1 : "any",
    min: choice.minimum ?? choice.exclusive_minimum ?? "",
    max: choice.maximum ?? "",
    defaultValue: typeof choice.default === "number" ? choice.default : "",
    placeholder: named?.label ?? choice.unset ?? "",
    title: choice.description,
  });
}

// Fields of the form by kind of choice.
const FIELDS = {
  one(choice) {
    const select = Object.assign(document.createElement("select"), { name: choice.name, title: choice.description });
    // An option is selected from the start only if the fourth argument says so; the third one is for a reset.
    const isDefault = (name) => name === choice.default;
    select.append(...choice.values.map(({ name, label }) => new Option(label, name, isDefault(name), isDefault(name))));
    return labelled(choice.label, select);
  },
  several(choice) {
    const group = document.createElement("fieldset");
    group.title = choice.description;
    group.append(element("legend", choice.label));
    for (const { name, label } of choice.values) {
      const box = Object.assign(document.createElement("input"), { type: "checkbox", name: choice.name, value: name });
      box.defaultChecked = choice.default.includes(name);
      const line = document.createElement("label");
      line.append(box, ` ${label}`);
      group.append(line);
    }
    return group;
  },
  number: (choice) => labelled(choice.label, numberInput(choice, false)),
  whole_number: (choice) => labelled(choice.label, numberInput(choice, true)),
  frame_range(choice) {
    const group = document.createElement("fieldset");
    group.title = choice.description;
    group.append(element("legend", `${choice.label}: ${choice.unset}, or`));
    const bounds = [["first", 0], ["after the last", 1]];
    group.append(...bounds.map(([text, least]) => {
      const input = numberInput(choice, true);
      input.min = Math.max(choice.minimum ?? 0, least);
      input.placeholder = "";
      return labelled(text, input);
    }));
    return group;
  },
};

// Value of a choice in the spec; undefined for an empty field, so that the service uses the default.
const VALUES = {
  one: (field) => field.value,
  several: (boxes) => boxes.filter((box) => box.checked).map((box) => box.value),
  number: (field) => (field.value === "" ? undefined : field.valueAsNumber),
  whole_number: (field) => (field.value === "" ? undefined : field.valueAsNumber),
  frame_range: (inputs) => (inputs.every((input) => input.value === "") ? undefined
    : inputs.map((input) => (input.value === "" ? null : input.valueAsNumber))),
};

function fieldsOf(form, { name, kind }) {
  const fields = [...form.querySelectorAll(`#choices [name="${name}"]`)];
  return kind === "several" || kind === "frame_range" ? fields : fields[0];
}

function fillChoices(asked) {
  const place = at("choices");
  if (choices.length > 0) return;
  choices = asked.filter(({ kind }) => kind in FIELDS); // a newer service may have other kinds
  place.append(...choices.map((choice) => FIELDS[choice.kind](choice)));
  place.hidden = false;
}

// Disable values whose networks not all workers have: the service would refuse such a job.
function markInstalled(choice, values) {
  const options = [...(at("send").elements[choice]?.options ?? [])];
  for (const { name, installed, install } of values) {
    const option = options.find((one) => one.value === name);
    if (!option) continue;
    option.dataset.label ??= option.textContent;
    option.disabled = installed === false;
    option.textContent = option.dataset.label + (installed === false ? " (not installed)" : "");
    option.title = installed === false ? install : "";
  }
}

// Disable profiles without their usual networks, and joints that the chosen profile lacks a network for.
function markNetworks(profiles) {
  const { profile: field } = at("send").elements;
  if (!field) return;
  const networks = ({ joints }, name) => joints.find((one) => one.joints === name);
  const usual = profiles.map((one) => ({ ...networks(one, one.default_joints), name: one.name }));
  const markJoints = () => {
    const chosen = profiles.find(({ name }) => name === field.value);
    markInstalled("joints", (chosen?.joints ?? []).map((one) => ({ ...one, name: one.joints })));
  };
  markInstalled("profile", usual);
  markJoints();
  field.onchange = markJoints;
}

async function refreshOptions() {
  if (performance.now() - optionsAt < OPTIONS_MS) return;
  const options = await call("/v1/options");
  optionsAt = performance.now();
  fillChoices(options.choices);
  markInstalled("detector", options.detectors);
  markNetworks(options.profiles);
}

async function poll() {
  clearTimeout(timer);
  let busy = false;
  try {
    busy = await refresh();
    await refreshOptions();
    await refreshCalibrations();
    at("connection").textContent = "";
  } catch (problem) {
    if (problem.status === 401) return showEntrance();
    at("connection").textContent = problem.message;
  }
  at("connection").classList.toggle("away", at("connection").textContent !== "");
  if (!document.hidden) timer = setTimeout(poll, busy ? POLL_MS : IDLE_POLL_MS);
}

function formOf(sent) {
  const fields = sent.elements;
  const form = new FormData();
  const name = fields.name.value.trim();
  if (name) form.append("manifest", jsonPart({ name }));
  if (chosenCalibration()) form.append("calibration_id", chosenCalibration());
  else form.append("calibration", fields.calibration.files[0]);
  for (const video of fields.videos.files) form.append("videos", video);
  const spec = Object.fromEntries(choices.map((choice) => [choice.name, VALUES[choice.kind](fieldsOf(sent, choice))]));
  form.append("spec", jsonPart(spec));
  return form;
}

at("send").addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.currentTarget;
  const submit = form.querySelector("[type=submit]");
  const stop = new AbortController();
  const onStop = () => stop.abort();
  at("abort").addEventListener("click", onStop);
  showProblem(at("problems"), null);
  submit.disabled = true;
  at("abort").hidden = at("upload").hidden = false;
  try {
    const job = await send("/v1/jobs", formOf(form), (loaded, total) => {
      at("upload-bar").value = total ? loaded / total : 0;
      at("upload-text").textContent =
        loaded < total ? `${sized(loaded)} of ${sized(total)} sent` : "Sent. Checking the files …";
    }, stop.signal);
    if (job) form.reset();
    at("chosen").textContent = "";
    await poll();
  } catch (problem) {
    showProblem(at("problems"), problem);
  } finally {
    at("abort").removeEventListener("click", onStop);
    at("abort").hidden = at("upload").hidden = true;
    at("upload-bar").value = 0;
    at("upload-text").textContent = "";
    submit.disabled = false;
  }
});

at("send").addEventListener("change", () => {
  const { videos } = at("send").elements;
  const total = [...videos.files].reduce((sum, file) => sum + file.size, 0);
  at("chosen").textContent = videos.files.length ? `${videos.files.length} videos, ${sized(total)}` : "";
});

// Another part of the page has begun or deleted something.
document.addEventListener("changed", () => { poll(); });

at("more").addEventListener("click", () => {
  limit = Math.min(MOST, limit + PAGE);
  poll();
});

// A service with keys requires signing in with a key; a cookie keeps the browser signed in.
function showEntrance() {
  clearTimeout(timer);
  cards.forEach(({ card }) => card.remove());
  cards.clear();
  at("inside").hidden = at("caller").hidden = true;
  at("entrance").hidden = false;
  at("enter").elements.key.focus();
}

async function enter() {
  let caller;
  try {
    caller = await call("/v1/caller");
  } catch (problem) {
    if (problem.status === 401) return showEntrance();
    at("connection").textContent = problem.message;
    at("connection").classList.add("away");
    timer = setTimeout(enter, IDLE_POLL_MS);
    return;
  }
  at("caller").hidden = caller.name === null;
  at("caller-name").textContent = `${caller.name}, ${caller.tenant}`;
  at("sending").hidden = !caller.scopes.includes("write");
  at("entrance").hidden = true;
  at("inside").hidden = false;
  optionsAt = -Infinity;
  await poll();
}

at("enter").addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.currentTarget;
  showProblem(at("refused"), null);
  try {
    await call("/v1/browser-session", "POST", { key: form.elements.key.value.trim() });
    form.reset();
    await enter();
  } catch (problem) {
    showProblem(at("refused"), problem);
  }
});

at("leave").addEventListener("click", async () => {
  await call("/v1/browser-session", "DELETE").catch(() => null);
  showEntrance();
});

document.addEventListener("visibilitychange", () => {
  if (!document.hidden && !at("inside").hidden) poll();
});

enter();
