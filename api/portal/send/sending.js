// State of the view Send: the draft, its uploads, the check of its files. It outlives the view, so that an upload goes on
// while another view is open.

import { announce } from "../shared/announce.js";
import { call } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { count, percent } from "../shared/format.js";
import { storedCalibration } from "./calibration_file.js";
import { emptyDraft, isSame, loadDraft, rowOf, saveDraft } from "./draft.js";
import { kindOf, matchCameras } from "./files.js";
import { sessionBody } from "./session_body.js";
import { Uploads } from "./uploads.js";

const MIN_CAMERAS = 2;
const SAVE_MS = 300;
const STILL_CHECKING_MS = 1500;

class Sending extends EventTarget {
  draft = loadDraft();
  calibration = null; // the chosen one, with its cameras
  calibrationFile = null; // its file and the unit of length, if it was chosen as a file
  phase = "draft"; // draft, sending, paused, checking, checked, starting
  problem = null;
  isReadingCalibration = false; // whether a calibration file is being checked
  notes = []; // about files that were dropped
  session = null; // once the files are checked
  lastJob = null; // job of the capture sent last
  #uploads = new Uploads(() => this.changed());
  #saveTimer = 0;
  #frame = 0;
  #isResumed = false;

  // Go on with what a former page has left, once the caller is known.
  async resume() {
    if (this.#isResumed) return;
    this.#isResumed = true;
    if (this.draft.calibrationId) await this.chooseCalibration(this.draft.calibrationId).catch(() => null);
    if (this.draft.request) await this.#check().catch((problem) => this.#fail(problem));
    else if (this.draft.sessionId) await this.#recall();
  }

  // A capture that was checked before the page was loaded anew.
  async #recall() {
    try {
      this.session = await call(`/v1/sessions/${this.draft.sessionId}`);
      this.#go("checked");
    } catch {
      this.clear();
    }
  }

  get rows() { return this.draft.rows; }
  get used() { return this.rows.filter((row) => row.isUsed); }
  get isBusy() { return ["sending", "checking", "starting"].includes(this.phase); }
  // Files that were being sent when the page was closed, and have to be chosen again.
  get missing() { return this.used.filter((row) => row.file === null && !row.isSent); }
  get isGuessed() { return this.#match().isGuess; }

  // Text about a running upload for other views; null without one.
  progress() {
    if (this.phase === "checking") return "Checking the files …";
    if (!["sending", "paused"].includes(this.phase)) return null;
    return `${this.phase === "paused" ? "Paused" : "Sending"}, ${percent(this.fraction)}`;
  }

  get fraction() {
    const [sent, total] = this.used.reduce(([a, b], row) => [a + row.sent, b + row.size], [0, 0]);
    return total ? sent / total : 0;
  }

  changed() {
    // Not postponed by later changes: a running upload reports its progress all the time.
    this.#saveTimer ||= setTimeout(() => this.save(), SAVE_MS);
    if (this.#frame) return;
    this.#frame = requestAnimationFrame(() => {
      this.#frame = 0;
      this.dispatchEvent(new Event("change"));
    });
  }

  save() {
    clearTimeout(this.#saveTimer);
    this.#saveTimer = 0;
    saveDraft(this.draft);
  }

  async add(files) {
    this.notes = [];
    this.problem = null;
    const calibrations = [];
    const others = [];
    for (const file of files) {
      const kind = await kindOf(file);
      if (kind === "calibration") calibrations.push(file);
      else if (kind === null) others.push(file.name);
      else this.#addRow(file, kind);
    }
    if (calibrations.length > 1) {
      this.notes.push(`Several files may be the calibration: ${calibrations.map(({ name }) => name).join(", ")}. The first is used.`);
    }
    if (others.length) this.notes.push(`Left out: ${others.join(", ")}. A capture has videos, or zips of images or of keypoints, and a calibration.`);
    if (!this.draft.name && this.rows.length) this.draft.name = folderOf(files) ?? "";
    this.assignCameras();
    announce(`${count(this.rows.length, "file")} chosen`);
    this.changed();
    if (calibrations.length) await this.sendCalibration(calibrations[0]);
    if (this.draft.wasSending && this.missing.length === 0 && this.phase === "draft") await this.send();
  }

  #addRow(file, kind) {
    const known = this.rows.findIndex((row) => isSame(row, file));
    const facts = { name: file.name, size: file.size, modified: file.lastModified, kind };
    if (known >= 0) {
      const row = this.rows[known];
      if (row.file === null) this.rows[known] = rowOf({ ...facts, ...pick(row) }, file);
      return;
    }
    if (this.rows.some((row) => row.name === file.name)) {
      this.notes.push(`Two files have the name ${file.name}. Rename one of them.`);
      return;
    }
    this.rows.push(rowOf(facts, file));
  }

  removeRow(row) {
    this.#uploads.forget(row);
    if (row.preview) URL.revokeObjectURL(row.preview);
    this.draft.rows = this.rows.filter((one) => one !== row);
    this.changed();
  }

  clear() {
    this.#uploads.stop();
    for (const row of this.rows) this.removeRow(row);
    this.draft = emptyDraft(this.#kept);
    this.phase = "draft";
    this.session = this.problem = null;
    this.notes = [];
    this.changed();
  }

  #match() {
    const names = this.rows.filter(({ kind }) => kind !== "timestamps").map(({ name }) => name);
    return matchCameras(names, this.cameraNames);
  }

  get cameraNames() { return this.calibration?.cameras.map(({ name }) => name) ?? []; }

  // Give a camera to files that have none, by their names.
  assignCameras() {
    const names = this.cameraNames;
    if (names.length === 0) return;
    const { matched } = this.#match();
    for (const row of this.rows) {
      if (row.kind === "timestamps") continue;
      if (!names.includes(row.camera)) row.camera = null;
      const isFree = (camera) => !this.rows.some((one) => one !== row && one.camera === camera);
      const camera = matched.get(row.name);
      if (row.camera === null && camera && isFree(camera)) row.camera = camera;
    }
  }

  async chooseCalibration(id) {
    this.draft.calibrationId = id || null;
    this.calibrationFile = null;
    this.calibration = null;
    this.changed();
    if (!id) return;
    try {
      this.calibration = await call(`/v1/calibrations/${id}`);
    } catch (problem) {
      if (problem.status === 404) this.draft.calibrationId = null;
      throw problem;
    } finally {
      this.assignCameras();
      this.changed();
    }
  }

  // Store a calibration file, which checks it; the capture names it by its id.
  async sendCalibration(file, units = "m") {
    this.problem = null;
    this.isReadingCalibration = true;
    this.changed();
    try {
      this.calibration = await storedCalibration(file, units);
      this.calibrationFile = { file, units };
      this.draft.calibrationId = this.calibration.id;
      announce(`Calibration with ${count(this.calibration.cameras.length, "camera")}`);
      this.assignCameras();
    } catch (problem) {
      this.problem = problem;
    }
    this.isReadingCalibration = false;
    this.changed();
  }

  // What keeps the capture from being sent, as sentences.
  faults() {
    const faults = [];
    const views = this.used.filter(({ kind }) => kind !== "timestamps");
    if (views.length < MIN_CAMERAS) faults.push(`Add the videos of at least ${MIN_CAMERAS} cameras.`);
    if (!this.calibration) faults.push("Choose or add the calibration of the cameras.");
    if (this.missing.length) faults.push(`Choose again: ${this.missing.map(({ name }) => name).join(", ")}.`);
    if (!this.calibration) return faults;
    const without = views.filter((row) => row.camera === null);
    if (without.length) faults.push(`Give a camera to ${without.map(({ name }) => name).join(", ")}, or leave it out.`);
    const twice = views.filter((row) => row.camera && views.some((one) => one !== row && one.camera === row.camera));
    if (twice.length) faults.push(`One camera has two files: ${twice.map(({ name }) => name).join(", ")}.`);
    return faults;
  }

  // Change a file's camera, timing or use.
  assign(row, facts) {
    // A zip of keypoints has the name of its camera from the start of its upload.
    if (row.kind === "keypoints" && "camera" in facts && row.url) this.#uploads.forget(row);
    Object.assign(row, facts);
    this.changed();
  }

  #isComplete() {
    const faults = this.faults();
    if (faults.length === 0) return true;
    this.problem = { message: "The capture is not complete.", items: faults.map((message) => ({ message })) };
    this.draft.wasSending = false;
    this.#go("draft");
    return false;
  }

  async send({ isCheckOnly = false } = {}) {
    if (this.isBusy) return;
    this.problem = this.lastJob = null;
    if (!this.#isComplete()) return;
    try {
      this.#go("sending");
      this.draft.wasSending = true;
      if (!await this.#uploads.send(() => this.used)) return;
      if (!this.#isComplete()) return; // it may have been changed meanwhile
      this.draft.request = { body: sessionBody(this.draft), key: newKey(), isCheckOnly };
      announce("All files are sent. They are being checked.");
      await this.#check();
    } catch (problem) {
      this.#fail(problem);
    }
  }

  // Have the files checked, then reconstruct them unless the check found errors. The service answers a request that it has
  // done before with the same answer, so that a page that was closed meanwhile can ask again.
  async #check() {
    const { body, key, isCheckOnly } = this.draft.request;
    this.#go("checking");
    this.save();
    this.session = await this.#answered("/v1/sessions", body, key);
    Object.assign(this.draft, { wasSending: false, request: null, sessionId: this.session.id });
    for (const row of this.rows) row.url = null; // the capture has the uploads now
    this.save();
    if (!isCheckOnly && !hasErrors(this.session)) return this.start();
    this.#go("checked");
    announce(hasErrors(this.session) ? "The check found errors." : "The files are checked.");
  }

  async #answered(path, body, key) {
    for (;;) {
      try {
        return await call(path, { method: "POST", body, headers: { "Idempotency-Key": key } });
      } catch (problem) {
        if (problem.code !== "idempotency_key_busy") throw problem;
        await new Promise((resolve) => { setTimeout(resolve, STILL_CHECKING_MS); });
      }
    }
  }

  // Reconstruct the session whose files are checked.
  async start() {
    this.problem = null;
    this.#go("starting");
    try {
      this.#sent(await call(this.session.links.jobs, { method: "POST", body: { sync: "declared", ...this.draft.spec } }));
    } catch (problem) {
      this.problem = problem;
      this.#go("checked");
    }
  }

  // The next take has the same cameras and, most often, the same choices.
  get #kept() {
    const { calibrationId, clock, spec } = this.draft;
    return { calibrationId, clock, spec };
  }

  #sent(job) {
    feed.put(job);
    this.lastJob = job.id;
    for (const { preview } of this.rows) if (preview) URL.revokeObjectURL(preview);
    this.draft = emptyDraft(this.#kept);
    this.session = null;
    this.#go("draft");
    announce(`${job.session_name} is sent. Its job waits.`);
  }

  // Problems of the last answer and findings of the check that concern a file.
  findingsOf(row) {
    const isOf = (one) => (one.file ? one.file === row.name : Boolean(one.camera) && one.camera === row.camera);
    const refused = (this.problem?.items ?? []).filter(isOf).map((item) => ({ ...item, severity: "error" }));
    return [...refused, ...(this.session?.preflight.findings ?? []).filter(({ camera }) => camera && camera === row.camera)];
  }

  // Camera of the check to which a file belongs.
  cameraOf(row) {
    return this.session?.preflight.cameras.find(({ file }) => file === row.name);
  }

  async discardSession() {
    await call(this.session.links.self, { method: "DELETE" });
    this.clear();
  }

  pause() {
    this.#uploads.stop();
    this.#go("paused");
    announce("The upload is paused.");
  }

  #go(phase) {
    this.phase = phase;
    this.changed();
  }

  #fail(problem) {
    this.problem = problem;
    this.draft.wasSending = false;
    this.draft.request = null;
    // An upload that the service no longer has is sent anew.
    const isGone = (problem.items ?? []).some(({ code }) => code === "upload_unknown");
    if (isGone) for (const row of this.rows) Object.assign(row, { url: null, sent: 0, isSent: false });
    this.#go("draft");
  }
}

const hasErrors = (session) => (session.preflight.findings ?? []).some(({ severity }) => severity === "error");

const pick = ({ camera, isUsed, offset_s, rate, url, sent, isSent }) => ({ camera, isUsed, offset_s, rate, url, sent, isSent });

const newKey = () => [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");

// Name of the folder that the files were dropped or chosen with.
function folderOf(files) {
  const [path] = [...files].map((file) => file.webkitRelativePath).filter(Boolean);
  return path?.split("/")[0] ?? null;
}

export const sending = new Sending();

addEventListener("pagehide", () => sending.save());
