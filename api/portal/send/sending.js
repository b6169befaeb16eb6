// State of the view Send: the draft, its uploads, the check of its files. It outlives the view, so that an upload continues
// while another view is open.

import { call, persistently, RequestProblem } from "../shared/api.js";
import { feed } from "../shared/feed.js";
import { percent } from "../shared/format.js";
import { countCameraFrames, estimateTime } from "../shared/jobs.js";
import { announce } from "../shared/page.js";
import { readOptions } from "../shared/resources.js";
import { COUNTS, PROBLEMS } from "../shared/strings/common.js";
import { SEND } from "../shared/strings/send.js";
import { ChosenCalibration } from "./calibration.js";
import { calibratedBody, calibrationBody, planCapture, findFaults, jobBody, orderParts, groupRows, sessionBody, videosByCamera } from "./capture_plan.js";
import { addFiles, emptyDraft, needsCamera, loadDraft, saveDraft } from "./files.js";
import { inOrder, matchCameras } from "./matching.js";
import { UploadQueue } from "./uploads.js";

const SAVE_MS = 300;
const STILL_CHECKING_MS = 1500;
const BUSY = ["restoring", "waiting", "sending", "calibrating", "checking", "starting"];
const LOCKED = ["restoring", "calibrating", "checking", "checked", "starting"];

class Sending extends EventTarget {
  draft = loadDraft();
  rig = new ChosenCalibration(() => { this.assignCameras(); this.changed(); });
  options = null; // choices that the service offers
  phase = "draft"; // draft, waiting, sending, paused, restoring, calibrating, checking, checked, starting
  problem = null;
  notes = []; // about files that were dropped
  session = null; // once the files are checked
  #uploads = new UploadQueue(() => this.changed());
  #reading = new Map(); // what is being read and has to be there before the capture is sent, as words by promise
  #press = 0; // number of the last press of Send or Pause, so that a former one does not go on
  #round = 0; // number of the draft, so that what was read for a former one is left out
  #saveTimer = 0;
  #frame = 0;
  #isResumed = false;

  // Go on with what a former page has left, once the caller is known.
  async resume() {
    if (this.#isResumed) return;
    this.#isResumed = true;
    const { calibrationId, calibrating, request, sessionId } = this.draft;
    if (calibrationId) this.#recallCalibration(calibrationId);
    if (!calibrating && !request && !sessionId) return;
    this.#go("restoring");
    if (calibrating) await this.#calibrate().catch((problem) => this.#fail(problem));
    else if (request) await this.#check().catch((problem) => this.#fail(problem));
    else await this.#recall();
  }

  // Calibration of the last capture, unless it was deleted since.
  async #recallCalibration(id) {
    await this.chooseCalibration(id);
    if (this.rig.problem?.status === 404) this.rig.choose(null);
  }

  // A capture that was checked before the page was reloaded.
  async #recall() {
    try {
      this.session = await persistently(() => call(`/v1/sessions/${this.draft.sessionId}`), { away: (problem) => this.#show(problem) });
      this.problem = null;
      this.#go("checked");
    } catch {
      this.clear();
    }
  }

  get rows() { return this.draft.rows; }
  get capture() { return planCapture(this); }
  get used() { return this.capture.files; }
  get isBusy() { return BUSY.includes(this.phase); }
  get isLocked() { return LOCKED.includes(this.phase); }
  // Files that the check refused may be replaced at once.
  get takesFiles() { return !this.isLocked || (this.phase === "checked" && hasErrors(this.session)); }
  // Files that were being sent when the page was closed, and have to be chosen again.
  get missing() { return this.used.filter((row) => row.file === null && !row.isSent); }
  // Files whose names don't tell their camera, once there is a calibration, and the cameras that no file has.
  get unpaired() { return this.cameraNames.length ? this.used.filter((row) => needsCamera(row) && row.camera === null) : []; }
  get unpairedRecordings() { return groupRows(this.unpaired); }
  get freeCameras() { return this.cameraNames.filter((name) => !this.used.some(({ camera }) => camera === name)); }

  // Reasons why Send waits, as words.
  get unread() {
    return [...new Set([...this.#reading.values(), ...(this.rig.isReading ? [SEND.unread.calibration(this.rig.name ?? "")] : [])])];
  }

  // Time that the reconstruction will take, with some choices in place of the page's; null if it can't be told.
  estimate(choices = {}) {
    const { spec, views } = this.capture;
    if (!spec || views.some(({ kind }) => kind !== "video")) return null;
    const checked = this.session?.preflight.cameras;
    const counts = checked ? checked.map(({ num_frames: number }) => number) : views.map(({ numFrames }) => numFrames);
    const wanted = { ...spec, ...choices };
    return estimateTime(wanted, countCameraFrames(counts, wanted), feed.newest(), this.options);
  }

  // Text about a running upload for other views; null without one.
  progress() {
    if (this.phase === "checking") return SEND.status.checking;
    if (this.phase === "calibrating") return SEND.phases.calibrating(percent(this.calibrated));
    if (!["sending", "paused"].includes(this.phase)) return null;
    return SEND.status[this.phase](percent(this.fraction));
  }

  // Share of the calibration from the videos that is done.
  get calibrated() { return feed.jobs.get(this.draft.calibrating)?.progress ?? 0; }

  get fraction() {
    const [sent, total] = this.used.reduce(([a, b], row) => [a + row.sent, b + row.size], [0, 0]);
    return total ? sent / total : 0;
  }

  changed() {
    // Not postponed by later changes: a running upload reports its progress all the time.
    this.#saveTimer ||= setTimeout(() => this.save(), SAVE_MS);
    this.dispatchEvent(new Event("state")); // at once, also while the page is hidden
    if (this.#frame) return;
    this.#frame = requestAnimationFrame(() => {
      this.#frame = 0;
      this.dispatchEvent(new Event("change"));
    });
  }

  save() {
    clearTimeout(this.#saveTimer);
    this.#saveTimer = 0;
    this.draft.calibrationId = this.rig.id ?? (this.#isResumed ? null : this.draft.calibrationId);
    saveDraft(this.draft);
  }

  // Note that something is being read for the capture, under a name for people. Send waits until it is there.
  reading(words, promise) {
    this.#reading.set(promise, words);
    this.changed();
    const end = () => {
      this.#reading.delete(promise);
      this.changed();
    };
    promise.then(end, end);
    return promise;
  }

  loadOptions() {
    const load = async () => {
      this.options = await persistently(readOptions, { away: (problem) => this.#show(problem) });
      if (this.problem?.isAway) this.problem = null;
    };
    return this.reading(SEND.unread.options, load());
  }

  // Add files, or those that a promise gives. They are left out if the draft is cleared before they are read.
  async add(files) {
    await this.reading(SEND.unread.files, this.#add(files));
    if (this.draft.wasSending && this.missing.length === 0 && this.phase === "draft") await this.send();
  }

  async #add(read) {
    const round = this.#round;
    const isOver = () => round !== this.#round;
    const files = await read;
    if (isOver()) return;
    if (this.phase === "checked") await this.reopen();
    this.notes = [];
    this.problem = null;
    const calibration = await addFiles(this.draft, files, { notes: this.notes, forget: (row) => this.#forget(row), isOver });
    if (isOver()) return;
    this.assignCameras();
    announce(SEND.said.chosen(COUNTS.files(this.rows.length)));
    this.changed();
    if (calibration) this.readCalibration(calibration);
  }

  #forget(row) {
    this.#uploads.forget(row);
    if (row.preview) URL.revokeObjectURL(row.preview);
  }

  removeRow(row) {
    this.#forget(row);
    this.draft.rows = this.rows.filter((other) => other !== row);
    this.changed();
  }

  clear() {
    this.#uploads.stop();
    for (const row of this.rows) this.#forget(row);
    this.#begin();
  }

  // Begin the next draft. The next take has the same cameras and, most often, the same choices.
  #begin() {
    this.#round += 1;
    this.#press += 1;
    const { calibrateFrom, stature, board, clock, frameRate_hz, layout, units, up, laboratoryClock, spec } = this.draft;
    this.draft = emptyDraft({ calibrateFrom, stature, board, clock, frameRate_hz, layout, units, up, laboratoryClock, spec, calibrationId: this.rig.id });
    this.session = this.problem = null;
    this.notes = [];
    this.#go("draft");
  }

  get cameraNames() { return this.rig.record?.cameras.map(({ name }) => name) ?? []; }

  // Give a camera to files that have none, by their names.
  assignCameras() {
    const names = this.cameraNames;
    if (names.length === 0 || this.isLocked) return;
    const matched = this.#byRecording(matchCameras, this.rows.filter(needsCamera), names);
    for (const row of this.rows) {
      if (!needsCamera(row)) continue;
      if (!names.includes(row.camera)) row.camera = null;
      const camera = matched.get(row);
      const others = this.rows.filter((other) => other !== row && other.camera === camera);
      if (row.camera === null && camera && others.every((other) => matched.get(other) === camera)) this.assign(row, { camera });
    }
  }

  // Give the free cameras to the files that have none, both in the natural order of their names.
  pairByOrder() {
    const paired = this.#byRecording(inOrder, this.unpaired, this.freeCameras);
    for (const [row, camera] of paired) this.assign(row, { camera });
  }

  // Camera of each row by a rule for names, which sees the first part of each recording.
  #byRecording(rule, rows, cameras) {
    const recordings = groupRows(rows);
    const found = rule(recordings.map(([first]) => first.name), cameras);
    return new Map(recordings.flatMap((parts) => parts.map((row) => [row, found.get(parts[0].name) ?? null])));
  }

  // Number of a row among the parts of its camera's recording, from 0; null if it is the only one, or no part.
  findPart(row) {
    const rows = videosByCamera(this.used).get(row.camera) ?? [];
    const parts = rows.length > 1 ? orderParts(rows) : null;
    return parts?.includes(row) ? parts.indexOf(row) : null;
  }

  // Join the files of cameras that have several, as parts of one recording.
  join(rows) {
    for (const row of rows) this.assign(row, { isJoined: true });
  }

  chooseCalibration(id, name = null) {
    return this.#readRig(this.rig.choose(id, name));
  }

  readCalibration(file, units, up) {
    this.draft.calibrateFrom = null;
    return this.#readRig(this.rig.readFile(file, units, up));
  }

  async #readRig(read) {
    this.problem = null;
    await read;
    const { record, isReading } = this.rig;
    if (record && !isReading) announce(SEND.said.calibration(COUNTS.cameras(record.cameras.length)));
  }

  assignDraft(facts) {
    Object.assign(this.draft, facts);
    this.changed();
  }

  assign(row, facts) {
    // A zip of keypoints has the name of its camera from the start of its upload.
    if (row.kind === "keypoints" && "camera" in facts && (row.url || row.isActive)) this.#uploads.forget(row);
    Object.assign(row, facts);
    this.changed();
  }

  // Wait for all that is being read, also for what is chosen meanwhile.
  async #settle() {
    while (this.unread.length) await new Promise((resolve) => { this.addEventListener("state", resolve, { once: true }); });
  }

  #isComplete() {
    const faults = findFaults(this.capture, this.rig);
    if (!this.options) faults.push(PROBLEMS.choicesMissing);
    if (faults.length === 0) return true;
    this.problem = { message: SEND.incomplete, items: faults.map((message) => ({ message })) };
    this.draft.wasSending = false;
    this.#go("draft");
    return false;
  }

  // Send what the page shows, once all of it is read.
  async send({ isCheckOnly = false } = {}) {
    if (this.isBusy || this.phase === "checked") return;
    const press = ++this.#press;
    const isOver = () => press !== this.#press;
    this.problem = null;
    try {
      do {
        this.#go("waiting");
        await this.#settle();
        if (isOver() || !this.#isComplete()) return;
        this.draft.wasSending = true;
        this.#go("sending");
        await persistently(() => this.#uploads.send(() => this.used), { isOver, away: (problem) => this.#show(problem) });
        if (isOver()) return;
      } while (this.unread.length || this.used.some(({ isSent }) => !isSent)); // it was changed meanwhile
      if (!this.#isComplete()) return;
      this.problem = null;
      announce(SEND.said.sent);
      if (this.capture.calibrate) {
        this.#go("checking");
        const job = await this.#answered("/v1/calibrations", calibrationBody(this.capture), newKey());
        for (const row of this.rows) row.url = null; // the calibration has the uploads now
        feed.put(job);
        Object.assign(this.draft, { wasSending: false, calibrating: job.id, isCheckOnly });
        await this.#calibrate();
      } else {
        this.draft.request = { body: sessionBody(this.capture), key: newKey(), isCheckOnly };
        await this.#check();
      }
    } catch (problem) {
      if (!isOver()) this.#fail(problem);
    }
  }

  // Wait for the calibration from the sent videos, then make the capture of them with it.
  async #calibrate() {
    const id = this.draft.calibrating;
    this.#go("calibrating");
    this.save();
    let made;
    for (;;) {
      made = await persistently(() => call(`/v1/calibrations/${id}`), { away: (problem) => this.#show(problem) });
      if (made.state === "ready") break;
      if (["failed", "canceled"].includes(made.state)) throw new RequestProblem(made.error ?? { detail: SEND.notCalibrated }, 422);
      await new Promise((resolve) => { setTimeout(resolve, STILL_CHECKING_MS); });
    }
    if (!this.options) await this.loadOptions();
    const { isCheckOnly } = this.draft;
    const body = calibratedBody(this.capture, id, made.urls.session.split("/").at(-1));
    Object.assign(this.draft, { calibrating: null, calibrateFrom: null, request: { body, key: newKey(), isCheckOnly } });
    await this.chooseCalibration(id);
    await this.#check();
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
    announce(hasErrors(this.session) ? SEND.said.errors : SEND.said.checked);
  }

  // Answer to a POST, which is sent again with its key while the service is away or still at it.
  async #answered(path, body, key) {
    for (;;) {
      try {
        const request = () => call(path, { method: "POST", body, headers: { "Idempotency-Key": key } });
        const answer = await persistently(request, { away: (problem) => this.#show(problem) });
        this.problem = null;
        return answer;
      } catch (problem) {
        if (problem.code !== "idempotency_key_busy") throw problem;
        await new Promise((resolve) => { setTimeout(resolve, STILL_CHECKING_MS); });
      }
    }
  }

  async start() {
    this.problem = null;
    this.#go("starting");
    try {
      if (!this.options) await this.loadOptions();
      const job = await this.#answered(this.session.urls.jobs, jobBody(this.capture), newKey());
      feed.put(job);
      for (const { preview } of this.rows) if (preview) URL.revokeObjectURL(preview);
      this.#begin();
      announce(SEND.said.started(job.session_name));
      this.dispatchEvent(new CustomEvent("sent", { detail: job }));
    } catch (problem) {
      this.problem = problem;
      this.#go("checked");
    }
  }

  // Problems of the last answer and findings of the check that concern a file.
  rowFindings(row) {
    if (this.findPart(row)) return (this.problem?.items ?? []).filter(({ file }) => file === row.name).map((item) => ({ ...item, severity: "error" }));
    const isAboutRow = (item) => (item.file ? item.file === row.name : Boolean(item.camera) && item.camera === row.camera);
    const refused = (this.problem?.items ?? []).filter(isAboutRow).map((item) => ({ ...item, severity: "error" }));
    return [...refused, ...(this.session?.preflight.findings ?? []).filter(({ camera }) => camera && camera === row.camera)];
  }

  // Camera of the check to which a file belongs.
  findCamera(row) {
    return this.session?.preflight.cameras.find(({ file }) => file === row.name);
  }

  async discardSession() {
    await call(this.session.urls.self, { method: "DELETE" });
    this.clear();
  }

  // Go back from a checked capture to its files, which are sent again.
  async reopen() {
    await call(this.session.urls.self, { method: "DELETE" });
    for (const row of this.rows) Object.assign(row, { url: null, sent: 0, isSent: false });
    Object.assign(this.draft, { sessionId: null, wasSending: false });
    this.session = this.problem = null;
    this.#go("draft");
  }

  pause() {
    this.#press += 1;
    this.#uploads.stop();
    this.#go(this.phase === "sending" ? "paused" : "draft");
    announce(SEND.said.paused);
  }

  #go(phase) {
    this.phase = phase;
    this.changed();
  }

  #show(problem) {
    this.problem = problem;
    this.changed();
  }

  #fail(problem) {
    this.problem = problem;
    // An upload that the service no longer has is sent again.
    const isGone = this.draft.calibrating || (problem.items ?? []).some(({ code }) => code === "upload_unknown");
    Object.assign(this.draft, { wasSending: false, calibrating: null, request: null });
    if (isGone) for (const row of this.rows) Object.assign(row, { url: null, sent: 0, isSent: false });
    this.#go("draft");
  }
}

const hasErrors = (session) => session.preflight.findings.some(({ severity }) => severity === "error");

const newKey = () => [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");

export const sending = new Sending();

addEventListener("pagehide", () => sending.save());
