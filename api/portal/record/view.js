// View Record: phones as cameras. The list of recordings; one of them is loaded when it is opened.

import { call, persistently } from "../shared/api.js";
import { moment } from "../shared/format.js";
import { helpLink, html, nothing, problemBox, render } from "../shared/lit.js";
import { address, go } from "../shared/page.js";
import { COMMON, COUNTS, PROBLEMS } from "../shared/strings/common.js";
import { RECORD } from "../shared/strings/record.js";
import { keepJoin } from "./room.js";

/** List of recordings, and the form of a new one. */
class RecordingList {
  #isClosed = false;
  #recordings = null;
  #problem = null;

  constructor(place) {
    this.place = place;
    this.#load();
    this.draw();
  }

  close() {
    this.#isClosed = true;
  }

  async #load() {
    try {
      const away = (problem) => { this.#problem = problem; this.draw(); };
      this.#recordings = (await persistently(() => call("/v1/recordings"), { isOver: () => this.#isClosed, away })).recordings;
      this.#problem = null;
    } catch (problem) {
      this.#problem = problem;
    }
    this.draw();
  }

  async #add(event) {
    event.preventDefault();
    const name = event.target.elements.name.value.trim();
    try {
      const { id, join } = await call("/v1/recordings", { method: "POST", body: name ? { name } : {} });
      keepJoin(id, join);
      go("record", id);
    } catch (problem) {
      this.#problem = problem;
      this.draw();
    }
  }

  draw() {
    if (this.#isClosed) return;
    render(html`<div class="with-help"><h1 class="title">${RECORD.title}</h1>${helpLink("phones", RECORD.title)}</div>
      <section class="panel record-new" aria-labelledby="new-title"><h2 id="new-title">${RECORD.intro}</h2>
        <p>${RECORD.introHint}</p>
        <form @submit=${(event) => this.#add(event)}><label class="field"><span>${RECORD.name}</span><input name="name" maxlength="200" placeholder=${RECORD.namePlaceholder} autocomplete="off"></label>
          <div class="actions"><button class="button primary">${RECORD.new}</button></div></form>
        ${problemBox(this.#problem)}</section>
      ${this.#recordings?.length ? html`<section class="panel" aria-labelledby="list-title"><h2 id="list-title">${RECORD.recordings}</h2>
        <ul class="record-list">${this.#recordings.map(({ id, name, created_at: created, expires_at: end, phones, takes }) => html`<li><a href=${address("record", id)}>${name}</a>
          <span class="quiet facts"><span>${moment(created)}</span><span>${COUNTS.phones(phones.length)}</span><span>${COUNTS.takes(takes.length)}</span><span>${RECORD.until(moment(end))}</span></span></li>`)}</ul></section>` : nothing}`, this.place);
  }
}

// View of one recording, whose module comes a moment later.
class RecordingPlace {
  #view = null;
  #isClosed = false;

  constructor(place, id) {
    render(html`<h1 class="title">${RECORD.title}</h1><p class="quiet">${COMMON.loading}</p>`, place);
    persistently(() => import("./host/host.js"), { isOver: () => this.#isClosed }).then(({ RecordingView }) => {
      if (!this.#isClosed) this.#view = new RecordingView(place, id);
    }, () => render(problemBox({ message: PROBLEMS.viewMissing }), place));
  }

  close() {
    this.#isClosed = true;
    this.#view?.close();
  }
}

export function open(place, route) {
  const view = route.id === null ? new RecordingList(place) : new RecordingPlace(place, route.id);
  return { title: RECORD.title, close: () => view.close() };
}
