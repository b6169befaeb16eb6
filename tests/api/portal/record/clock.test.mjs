// Clock of the service from messages there and back, and the time of the first frame.

import assert from "node:assert/strict";
import test from "node:test";

import { robustSlope, ServerClock } from "../../../../api/portal/record/service_clock.js";
import { PreviewFrames, frameTime } from "../../../../api/portal/record/phone/camera.js";
import { estimateFirstFrame } from "../../../../api/portal/record/phone/take_recorder.js";

const OFFSET_S = 1_700_000_000;

// Numbers between 0 and 1 that look random and are the same each time.
function numbers(seed) {
  let state = seed;
  return () => {
    state = (1664525 * state + 1013904223) % 4294967296;
    return state / 4294967296;
  };
}

// A clock that was fed for some seconds: `wayS()` is the time that a message takes one way.
function fed({ seconds, everyS = 2, ppm = 0, wayS }) {
  const clock = new ServerClock();
  const serverS = (localS) => OFFSET_S + localS * (1 + ppm / 1e6);
  for (let sentS = 0; sentS < seconds; sentS += everyS) {
    const there = wayS();
    clock.add(sentS, serverS(sentS + there), sentS + there + wayS());
  }
  return { clock, errorS: (localS) => clock.serverS(localS) - serverS(localS) };
}

test("the shortest round trips decide, whatever the others take", () => {
  const random = numbers(1);
  const { clock, errorS } = fed({ seconds: 40, wayS: () => (random() < 0.5 ? 0.002 + 0.001 * random() : 0.5 * random()) });
  assert.ok(Math.abs(errorS(40)) < 0.002, String(errorS(40)));
  const { std_s: std, drift_ppm: ppm } = clock.report(40);
  assert.ok(std > 0.0003 && std < 0.004, String(std));
  assert.equal(ppm, 0); // of less than a minute no drift is told
});

test("a drift of 80 ppm is measured over minutes", () => {
  const random = numbers(2);
  const { clock, errorS } = fed({ seconds: 400, ppm: 80, wayS: () => 0.003 + 0.002 * random() });
  assert.ok(Math.abs(clock.report(400).drift_ppm - 80) < 8, String(clock.report(400).drift_ppm));
  assert.ok(Math.abs(errorS(420)) < 0.002);
});

test("a way there that is longer than the way back is within what is stated", () => {
  let isBack = true;
  const { clock, errorS } = fed({ seconds: 30, wayS: () => { isBack = !isBack; return isBack ? 0.001 : 0.021; } });
  assert.ok(Math.abs(errorS(30)) < 2 * clock.report(30).std_s);
  assert.ok(Math.abs(errorS(30)) > 0.005);
});

test("times there and back are inverse", () => {
  const { clock } = fed({ seconds: 200, ppm: -40, wayS: () => 0.004 });
  for (const localS of [0, 100, 1000]) assert.ok(Math.abs(clock.localS(clock.serverS(localS)) - localS) < 1e-6);
});

test("a clock of the service that was set is followed at once", () => {
  const { clock } = fed({ seconds: 100, wayS: () => 0.004 });
  clock.add(100, OFFSET_S + 160, 100.008);
  assert.ok(Math.abs(clock.serverS(101) - OFFSET_S - 161) < 0.01);
});

test("nothing is known before the first answer", () => {
  assert.equal(new ServerClock().isKnown, false);
  assert.equal(new ServerClock().report(1), null);
  assert.equal(robustSlope([[1, 5]]), 0);
  assert.equal(robustSlope([[0, 0], [1, 2], [2, 4], [3, 100], [4, 8]]), 2);
});

// A `<video>` whose frames are shown by hand.
function fakeVideo() {
  let callback = null;
  return {
    requestVideoFrameCallback: (wanted) => { callback = wanted; return 1; },
    cancelVideoFrameCallback() { callback = null; },
    show(facts) { callback(0, { presentedFrames: 0, ...facts }); },
  };
}

test("frames that nobody saw are counted by the times of the others", async () => {
  const video = fakeVideo();
  const frames = new PreviewFrames(video);
  const times = [0, 40, 80, 120, 160, 200, 240, 400, 440];
  const shown = [1, 2, 3, 4, 5, 6, 7, 8, 11];
  const wanted = frames.frame(({ timeS }) => timeS > 0.3, 10);
  times.forEach((timeMs, place) => video.show({ captureTime: timeMs, presentationTime: timeMs + 5, presentedFrames: shown[place] }));
  assert.ok(Math.abs(frames.intervalS - 0.04) < 1e-9);
  assert.equal(frames.numMissing, 3); // between 240 and 400 ms; the last three were shown in one
  assert.equal(frames.numFrames, 11);
  assert.equal((await wanted).timeS, 0.4);
  const never = frames.frame(() => false, 10);
  frames.close();
  assert.equal(await never, null);
});

test("a frame's time is that of the camera where it is told", () => {
  assert.deepEqual(frameTime({ captureTime: 1500, presentationTime: 1530 }), { timeS: 1.5, stdS: 0.004 });
  assert.deepEqual(frameTime({ presentationTime: 1530 }), { timeS: 1.53, stdS: 0.02 });
});

test("the first frame is certain only if the recorder started in time", () => {
  const first = { timeS: 10.04, stdS: 0.004 };
  const at = { startedS: 10.01, intervalS: 0.04 };
  assert.deepEqual(estimateFirstFrame({ before: { lateS: 0.002 }, first, ...at }), { timeS: 10.04, stdS: 0.004 });
  assert.ok(estimateFirstFrame({ before: { lateS: 0.03 }, first, ...at }).stdS > 0.02);
  assert.ok(estimateFirstFrame({ before: null, first, ...at }).stdS > 0.02);
  assert.deepEqual(estimateFirstFrame({ before: null, first: null, ...at }), { timeS: 10.03, stdS: 0.05 });
});
