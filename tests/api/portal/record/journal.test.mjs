// Journals of recordings: what is there of a take after its page was killed, and what is told of it.

import assert from "node:assert/strict";
import test from "node:test";

import { fileMessage, partKey, findLosses, parseJournal, readPart, stoppedMessage } from "../../../../api/portal/record/phone/journal.js";

const BEGIN = { fact: "begin", recording: "r", take: 3, part: 1, mime_type: "video/webm", at_s: 100 };
const FIRST = { fact: "first", at_s: 100.02, std_s: 0.004 };
const PIECES = [{ fact: "piece", until_s: 100.5, num_frames: 12, dropped: 0 }, { fact: "piece", until_s: 101, num_frames: 25, dropped: 1 }];
const END = { fact: "end", until_s: 101.2, num_frames: 30, dropped: 1 };
const part = (facts, more = {}) => readPart({ key: partKey("r", 3, facts[0].part), facts, numBytes: 1000, isOpen: false, ...more });

test("a torn line ends the journal", () => {
  const text = `${JSON.stringify(BEGIN)}\n${JSON.stringify(FIRST)}\n{"fact": "pie`;
  assert.deepEqual(parseJournal(text), [BEGIN, FIRST]);
  assert.equal(readPart({ key: "k", facts: parseJournal("{"), numBytes: 0, isOpen: false }), null);
});

test("a part that was ended lost nothing", () => {
  const ended = part([BEGIN, FIRST, ...PIECES, END]);
  assert.equal(ended.isCut, false);
  assert.ok(Math.abs(ended.durationS - 1.18) < 1e-9);
  assert.deepEqual([ended.numFrames, ended.dropped], [30, 1]);
  assert.deepEqual([...findLosses([ended], 101.3).values()], [[]]);
});

test("a part that is recorded now is not cut", () => {
  assert.equal(part([BEGIN, FIRST, PIECES[0]], { isOpen: true }).isCut, false);
});

test("a part that was cut lost what came after its last piece, up to the stop", () => {
  const cut = part([BEGIN, FIRST, ...PIECES]);
  assert.equal(cut.isCut, true);
  assert.deepEqual(findLosses([cut], 105).get(cut.key), [{ from_s: 101, to_s: 105 }]);
  assert.deepEqual(findLosses([cut], null).get(cut.key), []); // the take goes on
});

test("between two parts the loss is what lies between them", () => {
  const cut = part([BEGIN, FIRST, ...PIECES]);
  const second = part([{ ...BEGIN, part: 2, at_s: 102 }, { ...FIRST, at_s: 102.1 }, { ...END, until_s: 105 }]);
  const losses = findLosses([cut, second], 105);
  assert.deepEqual(losses.get(cut.key), [{ from_s: 101, to_s: 102.1 }]);
  assert.deepEqual(losses.get(second.key), []);
  const message = stoppedMessage(3, [cut, second], losses);
  assert.ok(Math.abs(message.lost_s - 1.1) < 1e-9);
  assert.deepEqual([message.num_parts, message.num_bytes, message.num_frames, message.is_cut], [2, 2000, 55, false]);
});

test("a part without a first frame is of the time of its beginning, roughly", () => {
  const early = part([BEGIN]);
  assert.deepEqual([early.firstFrameS, early.durationS, early.stdS], [100, 0, 0.1]);
});

test("an upload that is complete is told with all of the part's facts", () => {
  const sent = part([BEGIN, FIRST, ...PIECES, END, { fact: "upload", url: "/v1/uploads/u" }, { fact: "sent", upload_id: "u" }]);
  assert.deepEqual([sent.uploadUrl, sent.uploadId], ["/v1/uploads/u", "u"]);
  const message = fileMessage(sent, "u", []);
  assert.deepEqual(
    [message.type, message.take, message.part, message.upload_id, message.first_frame_s, message.std_s, message.num_frames, message.dropped_frames],
    ["file", 3, 1, "u", 100.02, 0.004, 30, 1],
  );
});

test("an upload that the service has no more counts for nothing", () => {
  const facts = [BEGIN, FIRST, ...PIECES, END, { fact: "upload", url: "/v1/uploads/u" }, { fact: "sent", upload_id: "u" }, { fact: "gone" }];
  const gone = part(facts);
  assert.deepEqual([gone.uploadUrl, gone.uploadId, gone.numFrames], [null, null, 30]);
  assert.deepEqual([gone.isAgain, part(facts.slice(0, -1)).isAgain], [true, false]);
  const again = part([...facts, { fact: "upload", url: "/v1/uploads/v" }, { fact: "sent", upload_id: "v" }]);
  assert.deepEqual([again.uploadUrl, again.uploadId, again.isAgain], ["/v1/uploads/v", "v", true]);
});
