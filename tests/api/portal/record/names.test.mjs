// Names that people type, and facts of cameras, as the service takes them.

import assert from "node:assert/strict";
import test from "node:test";

import { cleanName } from "../../../../api/portal/record/room.js";
import { trackFacts } from "../../../../api/portal/record/phone/camera.js";

test("names keep what can be seen", () => {
  assert.equal(cleanName("  Anna's\tphone\n"), "Anna's phone");
  assert.equal(cleanName("Fenster\u00a0links\u3000窓"), "Fenster links 窓");
  assert.equal(cleanName("<img src=x>"), "<img src=x>");
});

test("names lose what turns or hides text, and slashes", () => {
  assert.equal(cleanName("a\u202egpj.exe\u0000\u200b"), "agpj.exe");
  assert.equal(cleanName("../../etc\\passwd"), "..-..-etc-passwd");
  assert.equal(cleanName("👩\u200d🔧 at work"), "👩🔧 at work");
  for (const nothing of ["", "  ", ".", "..", " . ", "\u200b", "\ud800"]) assert.equal(cleanName(nothing), "");
});

test("long names are cut between characters", () => {
  assert.equal(cleanName("🙂".repeat(70)), "🙂".repeat(64));
  assert.equal(cleanName("a".repeat(300), 200).length, 200);
});

const track = (settings, capabilities = {}, label = "") => ({ label, getSettings: () => settings, getCapabilities: () => capabilities });

test("a camera that does not tell its size is told of as none", () => {
  assert.deepEqual(trackFacts(track({})), {});
  assert.deepEqual(trackFacts(track({ width: 0, height: 0, frameRate: 30 })), {});
});

test("a camera without a rate has a usual one", () => {
  for (const frameRate of [undefined, 0]) {
    const facts = trackFacts(track({ width: 640, height: 480, frameRate }, {}, "Kamera\u200e hinten"));
    assert.deepEqual(facts.track, { width: 640, height: 480, frame_rate_hz: 30, label: "Kamera hinten" });
    assert.equal(facts.capabilities.max_frame_rate_hz, 30);
  }
});
