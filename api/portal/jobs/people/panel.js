// Panel Edit people: the identity timeline, what can be done at the play head, and the list of edits.

import { call } from "../../shared/api.js";
import { feed } from "../../shared/feed.js";
import { percent } from "../../shared/format.js";
import { hasEnded } from "../../shared/jobs.js";
import { helpLink, html, nothing, problemBox, render, repeat, styled } from "../../shared/lit.js";
import { announce } from "../../shared/page.js";
import { PEOPLE } from "../../shared/strings/take.js";
import { actions } from "./actions.js";
import { EditQueue } from "./edit_queue.js";
import { personColor, personName } from "./person_names.js";

export class PeoplePanel {
  selected = null; // id of the person that actions are for
  other = null; // id of the second person of a merge or an exchange
  #isOpen = true;

  // `motion` is what the viewer shows; its play head says which frame is meant. `onpeople` is called when the people may be others.
  constructor(place, job, motion, onpeople) {
    Object.assign(this, { place, motion });
    this.editing = new EditQueue(job);
    this.editing.addEventListener("change", () => {
      this.draw();
      onpeople();
    });
    this.onTime = () => this.#showHead();
    motion.addEventListener("time", this.onTime);
  }

  get people() {
    return this.editing.people;
  }

  // Frame at the play head, in the numbers of the whole reconstruction.
  get frame() {
    return this.motion.frame ?? this.people.start_frame;
  }

  follow(job) {
    return this.editing.follow(job);
  }

  close() {
    this.#isOpen = false;
    this.editing.close();
    this.motion.removeEventListener("time", this.onTime);
  }

  select(id) {
    this.selected = id;
    this.draw();
  }

  seek(frame) {
    this.motion.seek(Math.min(this.people.stop_frame - 1, Math.max(this.people.start_frame, frame)));
  }

  personName(id) {
    return personName(id, this.people);
  }

  add(edit) {
    return this.editing.add(edit);
  }

  draw() {
    if (!this.#isOpen || this.people === null) return;
    const ids = this.people.people.map(({ id }) => id);
    if (!ids.includes(this.selected)) this.selected = ids[0] ?? null;
    const others = ids.filter((id) => id !== this.selected);
    if (!others.includes(this.other)) this.other = others[0] ?? null;
    const { activeElement } = document;
    const hadFocus = this.place.contains(activeElement);
    render(this.#panel(), this.place);
    // The button of an edit goes with it.
    if (hadFocus && !activeElement.isConnected) this.place.querySelector("#edits-title").focus();
    this.#showHead();
  }

  #panel() {
    const { editing } = this;
    return html`<section class="panel people" aria-labelledby="people-title">
      <div class="head"><div class="with-help"><h2 id="people-title">${PEOPLE.title}</h2>${helpLink("people-and-edits", PEOPLE.title)}</div>${this.#state()}</div>
      ${this.#notices()}
      ${lanes(this)}
      ${editing.job.edits_revision === null ? nothing : [actions(this), this.#list()]}
    </section>`;
  }

  // Revision that is shown, and how far its files are. Edits need not wait for them.
  #state() {
    const { job, isSending } = this.editing;
    if (isSending) return html`<p class="quiet">${PEOPLE.sending}</p>`;
    if (hasEnded(job)) return html`<p class="quiet">${job.revision === 0 ? PEOPLE.unedited : PEOPLE.revision(job.revision)}</p>`;
    const label = PEOPLE.inWork(job.revision);
    return html`<div class="making"><span>${PEOPLE.inWorkAt(label, percent(job.progress))}</span><progress max="1" .value=${job.progress} aria-label=${label}></progress></div>`;
  }

  #notices() {
    const { editing } = this;
    const { conflict, notice, job } = editing;
    const isBroken = !editing.isSending && job.revision > 0 && ["failed", "canceled"].includes(job.files_state ?? job.state);
    return html`${problemBox(editing.problem)}
      ${conflict ? html`<div class="problem" role="alert"><p>${PEOPLE.conflict}
          ${PEOPLE.notDone} <b>${conflict.words}</b>. ${conflict.changes.length ? PEOPLE.conflictRepeat : PEOPLE.conflictLost}</p>
        <div class="actions">${conflict.changes.length ? this.button(PEOPLE.repeat, () => editing.repeat()) : nothing}
          <button type="button" class="button small" @click=${() => editing.dismiss()}>${PEOPLE.drop}</button></div></div>` : nothing}
      ${notice ? html`<p class="notice">${notice}</p>` : nothing}
      ${editing.isBehind ? html`<div class="notice emptied"><p>${job.edits_revision === null ? PEOPLE.leftOut : PEOPLE.behind}</p>
        ${this.button(PEOPLE.apply, () => editing.apply().catch((problem) => editing.fail(problem)))}</div>` : nothing}
      ${this.people.people.length === 0 && this.people.found.length > 0 ? html`<div class="notice emptied"><p>${PEOPLE.emptied}</p>
        ${this.button(PEOPLE.undo, () => editing.undo(), { name: PEOPLE.emptiedUndo })}</div>` : nothing}
      ${isBroken ? html`<div class="problem" role="alert"><p>${PEOPLE.broken}</p>
        ${job.urls.retry ? html`<div class="actions">${this.button(PEOPLE.retry, () => this.#retry())}</div>` : nothing}</div>` : nothing}`;
  }

  #list() {
    const { editing } = this;
    const { edits } = editing;
    return html`<div class="edits">
      <div class="head"><h3 id="edits-title" tabindex="-1">${PEOPLE.edits}</h3><div class="actions">
        ${this.button(PEOPLE.undo, () => editing.undo(), { isOff: edits.length === 0, why: PEOPLE.nothingToUndo })}
        ${this.button(PEOPLE.redo, () => editing.redo(), { isOff: !editing.canRedo, why: PEOPLE.nothingToRedo })}</div></div>
      ${edits.length === 0 ? html`<p class="quiet">${PEOPLE.noEdits}</p>`
        : html`<ol aria-label=${PEOPLE.edits}>${edits.map((_, index) => this.#item(index))}</ol>`}
    </div>`;
  }

  #item(index) {
    const words = this.editing.wordsOf(index);
    const problem = this.people.outcomes[index]?.problem;
    return html`<li><span>${words}</span>
      ${this.button(PEOPLE.undo, () => this.editing.remove(index), { name: PEOPLE.undoOf(PEOPLE.undo, words), style: "ghost" })}
      ${problem ? html`<p class="notice">${PEOPLE.notApplied} ${problem.message} ${problem.hint}</p>` : nothing}</li>`;
  }

  // Button that keeps the focus while it can't be used, and says why.
  button(label, onClick, { name = null, isOff = false, why = "", style = "" } = {}) {
    const click = () => {
      if (isOff) announce(why);
      else onClick();
    };
    return html`<button type="button" class="button small ${style}" aria-label=${name ?? nothing}
      aria-disabled=${isOff ? "true" : "false"} title=${isOff && why ? why : nothing} @click=${click}>${label}</button>`;
  }

  async #retry() {
    feed.put(await call(this.editing.job.urls.retry, { method: "POST" }));
  }

  // Undo and redo by keys that are pressed anywhere on the page, but where a text is typed.
  key(event) {
    const isText = event.target.matches("input:not([type=radio], [type=checkbox], [type=range]), textarea");
    if (!this.#isOpen || this.people === null || isText || !(event.ctrlKey || event.metaKey)) return;
    const key = event.key.toLowerCase();
    const isRedo = key === "y" || (key === "z" && event.shiftKey);
    if (!isRedo && key !== "z") return;
    event.preventDefault();
    if (isRedo && this.editing.canRedo) this.editing.redo();
    else if (!isRedo && this.editing.canUndo) this.editing.undo();
    else announce(isRedo ? PEOPLE.nothingToRedo : PEOPLE.nothingToUndo);
  }

  // Move the line of the play head and the number of its frame, without drawing anything else.
  #showHead() {
    const { place, people } = this;
    const line = place.querySelector(".lanes-head");
    if (line === null || people === null) return;
    line.style.setProperty("--from", (this.frame + 0.5) / people.num_frames);
    for (const field of place.querySelectorAll(".frame-field")) if (field !== document.activeElement) field.value = this.frame;
    for (const text of place.querySelectorAll(".frame-text")) text.textContent = this.frame;
  }
}

// Identity timeline: a lane a person with their frames, the cut, and the play head.

// Lanes of all people. `panel` has `people`, `selected`, `select(id)`, and `seek(frame)` of the whole reconstruction.
export function lanes(panel) {
  const { people } = panel;
  const cut = [people.start_frame, people.num_frames - people.stop_frame];
  return html`<fieldset class="lanes">
    <legend>${PEOPLE.person}</legend>
    <div class="lanes-rows">
      ${repeat(people.people, ({ id }) => id, (person) => lane(panel, person))}
      <div class="lanes-over" aria-hidden="true">
        ${cut[0] ? html`<span class="cut-off" ${styled({ "--from": 0, "--share": cut[0] / people.num_frames })}></span>` : nothing}
        ${cut[1] ? html`<span class="cut-off" ${styled({ "--from": people.stop_frame / people.num_frames, "--share": cut[1] / people.num_frames })}></span>` : nothing}
        <span class="lanes-head"></span>
      </div>
    </div>
  </fieldset>`;
}

function lane(panel, person) {
  const { people } = panel;
  const { id, name, pieces } = person;
  const [first, last] = [pieces[0].start_frame, pieces.at(-1).stop_frame - 1];
  const go = (event) => {
    const { left, width } = event.currentTarget.getBoundingClientRect();
    panel.select(id);
    panel.seek(Math.floor(((event.clientX - left) / width) * people.num_frames));
  };
  return html`<div class="lane">
    <label class="lane-name">
      <input type="radio" name="edited-person" .checked=${panel.selected === id} @change=${() => panel.select(id)}>
      <span class="look-swatch" ${styled({ "--tint": personColor(id) })}></span>
      <span class="lane-text"><b>${name}</b> <span class="quiet">${PEOPLE.framesOf(first, last)}</span></span>
    </label>
    <div class="lane-track" aria-hidden="true" @click=${go}>${pieces.map((piece) => bar(id, piece, people))}</div>
  </div>`;
}

// Frames of a person in their one colour; hatched where they were another person's as found.
function bar(id, { person, start_frame: start, stop_frame: stop }, { num_frames: numFrames }) {
  const place = { "--from": start / numFrames, "--share": (stop - start) / numFrames, "--tint": personColor(id) };
  return html`<span class="bar-of ${person === id ? "" : "of-other"}" title=${PEOPLE.barTitle(start, stop - 1, person)} ${styled(place)}></span>`;
}
