// People of a job: their colours, and frames that two of them share.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { personColor, numFrames, sharedFrames } from "../../../../api/portal/jobs/people/person_names.js";

const person = (...pieces) => ({ pieces: pieces.map(([start_frame, stop_frame]) => ({ person: 1, start_frame, stop_frame })) });

test("a person has the colour of the viewer and of the files", () => {
  const colours = JSON.parse(readFileSync(`${process.env.FIXTURES}/colours.json`, "utf8"));
  for (const [id, color] of Object.entries(colours)) assert.equal(personColor(Number(id)), color, `person ${id}`);
});

test("frames in which two people are there", () => {
  const one = person([0, 40], [50, 100]);
  assert.equal(numFrames(one), 90);
  assert.deepEqual(sharedFrames(one, person([30, 60])), { num: 20, first: 30, last: 59 });
  assert.deepEqual(sharedFrames(person([30, 60]), one), { num: 20, first: 30, last: 59 });
  assert.equal(sharedFrames(one, person([40, 50])).num, 0);
  assert.equal(sharedFrames(one, person([100, 120])).num, 0);
  assert.deepEqual(sharedFrames(one, one), { num: 90, first: 0, last: 99 });
});
