// Part of the view Live with the programs that get the people: an address each, by protocol.

import { helpLink, html, nothing, selectField, typed } from "../shared/lit.js";
import { LIVE } from "../shared/strings/live.js";

const TEXT = LIVE.outputs;
const LOOPBACK = "127.0.0.1";

/** Chosen outputs of a capture; `changed` is called after each change. */
export class ChosenOutputs {
  protocols = []; // { scheme, label, port, is_server, has_people }; none: the operator allows no outputs
  rows = []; // { scheme, host, port, people }

  constructor(changed) {
    this.changed = changed;
  }

  /** Addresses of the outputs. */
  get addresses() {
    return this.rows.map(({ scheme, host, port, people }) => {
      const at = this.#protocol(scheme).port === null ? host : `${host.includes(":") ? `[${host}]` : host}:${port}`;
      return `${scheme}://${at}${people ? `?people=${people}` : ""}`;
    });
  }

  #protocol(scheme) { return this.protocols.find((protocol) => protocol.scheme === scheme); }

  // A row begins with the usual address of its protocol.
  #usual({ scheme, port }) { return { scheme, host: port === null ? TEXT.stream : LOOPBACK, port, people: "" }; }

  part(isLocked, playPattern) {
    if (!this.protocols.length) return nothing;
    return html`<section class="panel" aria-labelledby="chosen-outputs-title"><div class="with-help"><h2 id="chosen-outputs-title">${TEXT.title}</h2>${helpLink("live", TEXT.title)}</div>
      <p class="quiet">${TEXT.hint}</p>
      ${this.rows.map((row, place) => this.#row(row, place, isLocked))}
      <div class="actions">
        <button type="button" class="button small" ?disabled=${isLocked} @click=${() => { this.rows.push(this.#usual(this.protocols[0])); this.changed(); }}>${TEXT.add}</button>
        ${this.rows.length ? html`<button type="button" class="button small" ?disabled=${isLocked} @click=${playPattern}>${TEXT.pattern}</button>` : nothing}
      </div>
    </section>`;
  }

  #row(row, place, isLocked) {
    const protocol = this.#protocol(row.scheme);
    const field = (name, label, attributes) => html`<label class="field"><span>${label}</span><input autocomplete="off" spellcheck="false" maxlength="200" type=${attributes.type} min=${attributes.min ?? nothing} max=${attributes.max ?? nothing}
      .value=${typed(row[name])} ?disabled=${isLocked} @input=${(event) => { row[name] = event.target.value.trim(); }}></label>`;
    return html`<div class="live-output" role="group" aria-label=${TEXT.number(place + 1)}>
      ${selectField(TEXT.protocol, this.protocols.map(({ scheme, label }) => [scheme, label]), { chosen: row.scheme, choose: (scheme) => { Object.assign(row, this.#usual(this.#protocol(scheme))); this.changed(); }, isOff: isLocked })}
      ${field("host", protocol.port === null ? TEXT.name : protocol.is_server ? TEXT.listens : TEXT.host, { type: "text" })}
      ${protocol.port === null ? nothing : field("port", TEXT.port, { type: "number", min: 1, max: 65535 })}
      ${protocol.has_people ? field("people", TEXT.people, { type: "number", min: 1, max: 32 }) : nothing}
      <button type="button" class="button small" aria-label=${TEXT.removeNumber(place + 1)} ?disabled=${isLocked} @click=${() => { this.rows.splice(place, 1); this.changed(); }}>${TEXT.remove}</button>
    </div>`;
  }
}
