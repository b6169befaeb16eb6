// Play head, and times of cameras.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Player, frameRange } from "../../../../api/portal/viewer/player.js";
import { FrameClock } from "../../../../api/portal/viewer/video/frame_times.js";

const player = () => new Player({ startS: 2, rateHz: 25, numFrames: 100 });

test("frames and times", () => {
  const one = player();
  one.seek(50);
  assert.equal(one.timeS, 4);
  assert.equal(one.frame, 50);
  one.step(-60);
  assert.equal(one.frame, 0);
  one.seek(1000);
  assert.equal(one.frame, 99);
});

test("numbers of the source begin with the earliest take", () => {
  const takes = [
    { start_time_s: 40.2, frame_rate_hz: 25, num_frames: 10, first_source_frame: 1005 },
    { start_time_s: 40, frame_rate_hz: 25, num_frames: 8, first_source_frame: 1000 },
  ];
  const both = new Player(frameRange(takes));
  assert.deepEqual([both.firstSourceFrame, both.numFrames], [1000, 15]);
  both.setRange(frameRange(takes.slice(0, 1)));
  assert.deepEqual([both.firstSourceFrame, both.frame], [1005, 0]);
  assert.equal(player().firstSourceFrame, 0);
});

test("playing goes on by the speed, and loops", () => {
  const one = player();
  one.play();
  one.setSpeed(0.5);
  for (let tick = 0; tick < 10; tick++) one.advance(0.04);
  assert.equal(one.frame, 5);
  one.seek(99);
  assert.equal(one.advance(0.1), true);
  assert.equal(one.frame, 0);
});

test("without a loop the end pauses, and playing again begins at the start", () => {
  const one = player();
  one.setLooping(false);
  one.play();
  one.seek(99);
  one.advance(0.1);
  assert.ok(!one.isPlaying);
  assert.equal(one.frame, 99);
  one.play();
  assert.equal(one.frame, 0);
});

test("a range plays alone, and loops", () => {
  const one = player();
  one.setSpan({ from: 20 });
  one.setSpan({ to: 30 });
  assert.deepEqual([one.span, one.hasSpan], [{ from: 20, to: 30 }, true]);
  one.seek(90);
  one.play();
  assert.equal(one.frame, 20);
  one.seek(30);
  assert.equal(one.advance(0.1), true);
  assert.equal(one.frame, 20);
  one.setLooping(false);
  one.seek(30);
  one.advance(0.1);
  assert.deepEqual([one.isPlaying, one.frame], [false, 30]);
  // A mark behind the other one moves it away.
  one.setSpan({ from: 50 });
  assert.deepEqual(one.span, { from: 50, to: 99 });
  one.setSpan({ to: 10 });
  assert.deepEqual(one.span, { from: 0, to: 10 });
  one.setSpan();
  assert.ok(!one.hasSpan);
});

test("frames of another rate are at their own times, and the range keeps its times", () => {
  const take = { start_time_s: 2, frame_rate_hz: 50, num_frames: 100, first_source_frame: 0 };
  const one = new Player(frameRange([take]));
  one.setSpan({ from: 50 });
  one.setRange(frameRange([take], 24));
  assert.deepEqual([one.numFrames, one.span.from], [48, 24]);
  one.seek(12);
  assert.equal(one.frameTimeS, 2.5);
});

test("a tab that was hidden does not jump ahead", () => {
  const one = player();
  one.play();
  one.advance(60);
  assert.ok(one.frame <= 25);
});

test("a camera's clock with an offset, a pause and its own rate", () => {
  // 30 frames a second from 1.5 s on; after frame 299 a pause of 5 s, which the video does not have.
  const clock = new FrameClock([[0, 1.5, 0], [299, 1.5 + 299 / 30, 299 / 30], [300, 6.5 + 300 / 30, 300 / 30], [599, 6.5 + 599 / 30, 599 / 30]]);
  assert.ok(clock.hasVideo);
  assert.equal(clock.frameAt(1.4), null);
  assert.equal(clock.frameAt(1.49), 0);
  assert.equal(clock.frameAt(1.5 + 100.4 / 30), 100);
  assert.ok(Math.abs(clock.frameTime(450) - (6.5 + 15)) < 1e-9);
  assert.equal(clock.frameAtVideo(450.2 / 30), 450);
  assert.ok(Math.abs(clock.videoTimeAt(6.5 + 15) - 15) < 1e-9);
  assert.equal(clock.frameAt(6.5 + 620 / 30), null);
});

test("cameras without video or frames", () => {
  assert.ok(!new FrameClock([[0, 0], [9, 1]]).hasVideo);
  assert.equal(new FrameClock([]).frameAt(0), null);
});
