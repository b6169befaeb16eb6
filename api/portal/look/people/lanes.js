// Identity timeline: a lane a person with their frames, the cut, and the play head.

import { html, nothing, repeat, styled } from "../../shared/lit.js";
import { colorOf } from "./words.js";

// Lanes of all people. `panel` has `people`, `selected`, `select(id)`, and `seek(frame)` of the whole reconstruction.
export function lanes(panel) {
  const { people } = panel;
  const cut = [people.start_frame, people.num_frames - people.stop_frame];
  return html`<fieldset class="lanes">
    <legend>Person</legend>
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
      <span class="look-swatch" ${styled({ "--tint": colorOf(id) })}></span>
      <span class="lane-text"><b>${name}</b> <span class="quiet">frames ${first} to ${last}</span></span>
    </label>
    <div class="lane-track" aria-hidden="true" @click=${go}>${pieces.map((piece) => bar(id, piece, people))}</div>
  </div>`;
}

// Frames of a person in their one colour; hatched where they were another person's as found.
function bar(id, { person, start_frame: start, stop_frame: stop }, { num_frames: numFrames }) {
  const place = { "--from": start / numFrames, "--share": (stop - start) / numFrames, "--tint": colorOf(id) };
  return html`<span class="bar-of ${person === id ? "" : "of-other"}" title="Frames ${start} to ${stop - 1}: person ${person} as found" ${styled(place)}></span>`;
}
