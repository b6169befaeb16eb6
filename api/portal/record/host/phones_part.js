// Part of the view Record with the phones: how they join, and what they see.

import { confirm } from "../../shared/dialog.js";
import { moment } from "../../shared/format.js";
import { html, nothing, repeat } from "../../shared/lit.js";
import { isOfThisMachine } from "../join_links.js";
import { cleanName } from "../names.js";
import { phoneFacts, phoneState } from "./take_words.js";

/** Link and QR code by which phones join. */
export function joinPart(recording) {
  const { join } = recording;
  const renew = async () => {
    const text = "Phones that have joined need the new link, too, before they record or send again.";
    if (join && !await confirm({ title: "Make a new link?", text, action: "Make a new link", refusal: "Keep the link" })) return;
    await recording.renewJoin();
  };
  return html`<section class="panel record-join" aria-labelledby="join-title"><h2 id="join-title">Phones join by this code</h2>
    ${join ? html`<img class="record-code" alt="QR code of the link" src=${`data:image/svg+xml,${encodeURIComponent(join.qr_svg)}`}>
      <a class="record-link" href=${join.url} target="_blank" rel="noopener">${join.url}</a>
      ${isOfThisMachine(join.url) ? html`<p class="notice" role="status">Only this machine can open this address. Start the service with <code>multicap serve --https</code>, and open this page by the address that it prints.</p>` : nothing}
      <p class="quiet">It opens this recording alone, until ${moment(join.expires_at)}. Whoever has it can join.</p>`
    : html`<p class="quiet">The link is shown once, in the browser that made the recording.</p>`}
    <div class="actions"><button type="button" class="button small" @click=${renew}>New link</button></div></section>`;
}

function phoneCard(view, recording, phone) {
  const { number, name, device, live } = phone;
  const [words, tone] = phoneState(live);
  const picture = recording.pictures.get(number);
  const remove = async () => {
    const text = "It can't come back. Clips that it has sent stay.";
    if (await confirm({ title: `Remove ${name}?`, text, action: "Remove the phone" })) recording.send({ type: "remove", phone: number });
  };
  const rename = (event) => {
    event.preventDefault();
    const wanted = cleanName(event.target.elements.name.value);
    view.renamed = null;
    if (wanted && wanted !== name) recording.send({ type: "rename", phone: number, name: wanted });
    view.draw();
  };
  return html`<li class="record-phone" data-tone=${tone}>
    <div class="record-picture">${picture && live?.is_connected ? html`<img src=${picture} alt="Picture of ${name}">` : html`<span class="quiet">no picture</span>`}</div>
    <div class="head">${view.renamed === number
    ? html`<form class="rename" @submit=${rename}><input name="name" maxlength="64" required aria-label="New name of ${name}" value=${name} autocomplete="off"><button class="button small primary">Save</button></form>`
    : html`<h3>${name}</h3>`}<span class="state" data-tone=${tone}>${words}</span></div>
    <p class="quiet facts">${phoneFacts(live).map(({ text, isWorse }) => html`<span class=${isWorse ? "worse" : ""}>${text}</span>`)}</p>
    <p class="quiet">${device}</p>
    ${live?.status?.error ? html`<p class="problem">${live.status.error}</p>` : nothing}
    <div class="actions"><button type="button" class="button small" aria-label="Rename ${name}" @click=${() => { view.renamed = number; view.draw(); }}>Rename</button>
      <button type="button" class="button small danger-quiet" aria-label="Remove ${name}" @click=${remove}>Remove</button></div></li>`;
}

/** Phones of the recording, with their pictures. */
export function phonesPart(view, recording) {
  const { phones } = recording;
  return html`<section class="panel" aria-labelledby="phones-title"><h2 id="phones-title">Phones</h2>
    ${phones.length ? html`<ul class="record-phones" aria-label="Phones">${repeat(phones, ({ number }) => number, (phone) => phoneCard(view, recording, phone))}</ul>`
    : html`<p class="quiet">No phone has joined yet. Two see people in three dimensions, four around them see them well.</p>`}</section>`;
}
