// Words and choices of the host, the phone's camera and its link.

import assert from "node:assert/strict";
import test from "node:test";

import { boardName } from "../../../../api/portal/record/board/charuco.js";
import { isOfThisMachine } from "../../../../api/portal/record/room.js";
import { bestVideo, clipLosses, clipState, commonVideos, phoneFacts, phoneState, takeDurationS, videoWords } from "../../../../api/portal/record/host/state_words.js";
import { adjust, trackFacts, heldConstraints, LivePictures, livePacket, liveSize, smallSize } from "../../../../api/portal/record/phone/camera.js";
import { describeDevice, readJoin } from "../../../../api/portal/record/phone/identity.js";
import { bitsPerS, fileEnding } from "../../../../api/portal/record/phone/take_recorder.js";

const can = (width, height, rateHz) => ({ max_width: width, max_height: height, max_frame_rate_hz: rateHz });

test("the best video is one that every phone can, within what they record for long", () => {
  assert.equal(videoWords(bestVideo(commonVideos([can(4032, 3024, 60), can(1080, 1920, 29.97)]))), "1920 × 1080, 30 Hz");
  assert.equal(videoWords(bestVideo(commonVideos([can(4032, 3024, 240)]))), "1920 × 1080, 60 Hz");
  assert.equal(videoWords(bestVideo(commonVideos([can(1920, 1080, 60), can(640, 480, 25)]))), "640 × 480, 25 Hz");
  assert.equal(bestVideo(commonVideos([])), null);
  assert.equal(bestVideo(commonVideos([can(100, 80, 30)])), null);
});

test("a camera is held still where it can be, with the values that it has", () => {
  const settings = { exposureTime: 12, colorTemperature: 4000 };
  assert.deepEqual(
    heldConstraints({ exposureMode: ["continuous", "manual"], focusMode: ["continuous"], whiteBalanceMode: ["none", "continuous"] }, settings),
    { advanced: [{ exposureMode: "manual", exposureTime: 12 }, { whiteBalanceMode: "none", colorTemperature: 4000 }] },
  );
  assert.equal(heldConstraints({}, settings), null);
});

test("a phone that is held upright is asked for an upright picture, once", async () => {
  const asked = [];
  const track = (width, height) => ({ getSettings: () => ({ width, height, frameRate: 30 }), applyConstraints: async (constraints) => { asked.push(constraints); } });
  await adjust(track(480, 640), { width: 1920, height: 1080, frame_rate_hz: 30 });
  await adjust(track(1080, 1920), { width: 1920, height: 1080, frame_rate_hz: 30 });
  assert.deepEqual(asked.map(({ width, height }) => [width.ideal, height.ideal]), [[1080, 1920]]);
});

test("facts of a track have no fields that are unknown", () => {
  const track = { label: "", getSettings: () => ({ width: 640, height: 480, frameRate: 25 }), getCapabilities: () => ({ exposureMode: ["manual"] }) };
  assert.deepEqual(trackFacts(track), {
    track: { width: 640, height: 480, frame_rate_hz: 25 },
    capabilities: { max_width: 640, max_height: 480, max_frame_rate_hz: 25, locks: ["exposureMode"] },
  });
});

test("the link of a phone's page", () => {
  const id = "0190a1b2-0000-7000-8000-000000000001";
  assert.deepEqual(readJoin(`#join=${id}.mcl_aB-9_`), { recording: id, secret: "mcl_aB-9_" });
  for (const hash of ["", "#join=x.mcl_a", `#join=${id}`, `#join=${id}.mc_a`]) assert.equal(readJoin(hash), null);
  assert.ok(isOfThisMachine("http://localhost:8000/record#join=x"));
  assert.ok(!isOfThisMachine("https://192.168.1.7:8000/record#join=x"));
});

test("browsers and devices have short names", () => {
  assert.equal(describeDevice("Mozilla/5.0 (iPhone; CPU iPhone OS 18_0 like Mac OS X) AppleWebKit/605 Version/18.0 Mobile Safari/604.1"), "Safari on iPhone");
  assert.equal(describeDevice("Mozilla/5.0 (Linux; Android 14; Pixel 8) AppleWebKit/537.36 Chrome/130.0 Mobile Safari/537.36"), "Chrome on Android");
  assert.equal(describeDevice("curl"), "Browser");
});

test("sizes of files and of pictures", () => {
  assert.equal(bitsPerS({ width: 1920, height: 1080, frameRate: 30 }), 9_331_200);
  assert.equal(bitsPerS({ width: 640, height: 480, frameRate: 25 }), 4_000_000);
  assert.equal(fileEnding("video/mp4;codecs=avc1"), "mp4");
  assert.deepEqual(smallSize(1080, 1920), [135, 240]);
});

test("live pictures have the proportions of the camera, and at most 640 pixels a side", () => {
  const sizes = [[1920, 1080], [1080, 1920], [4032, 3024], [1280, 960], [384, 216], [1366, 768], [1918, 1078], [1921, 1081]];
  assert.deepEqual(sizes.map(([width, height]) => liveSize(width, height)), [[640, 360], [360, 640], [640, 480], [640, 480], [384, 216], [683, 384], [548, 308], [640, 360]]);
});

test("a live picture has its time before it", async () => {
  const packet = Buffer.from(await livePacket(12.5, new Blob([new Uint8Array([255, 216])])).arrayBuffer());
  assert.equal(packet.toString("hex"), `${Buffer.from("MCP1").toString("hex")}0000000000002940ffd8`);
});

test("live pictures come at the asked rate, with times of the service, and none that is too large", async () => {
  const sent = [];
  const drawn = { drawImage: () => null };
  const jpegs = [10, 10, 500, 10];
  globalThis.document = { createElement: () => ({ getContext: () => drawn, toBlob: (resolve) => resolve(new Blob([new Uint8Array(jpegs.shift() ?? 10)])) }) };
  let pictures;
  const times = Array.from({ length: 13 }, (_, number) => number / 30);
  const frames = { isLate: true, frame: async (wanted) => {
    while (times.length && !wanted({ timeS: times[0] })) times.shift();
    if (!times.length) pictures.stop();
    return times.length ? { timeS: times.shift() } : null;
  } };
  const clock = { isKnown: true, serverS: (timeS) => 1000 + timeS };
  const done = new Promise((resolve) => { setTimeout(resolve, 50); });
  pictures = new LivePictures({ videoWidth: 1920, videoHeight: 1080 }, frames, { rateHz: 10, maxBytes: 100, clock, isBusy: () => false, send: (packet) => sent.push(packet) });
  await done;
  const read = async (packet) => new DataView(await packet.arrayBuffer()).getFloat64(4, true);
  assert.deepEqual((await Promise.all(sent.map(read))).map((timeS) => Math.round(100 * (timeS - 1000)) / 100), [0, 0.1, 0.3, 0.4]);
  delete globalThis.document;
});

test("a phone's state and facts as words", () => {
  const status = { state: "recording", track: { width: 1920, height: 1080, frame_rate_hz: 29.97 }, battery: 0.1, charging: false, free_bytes: 2e9, clock: { std_s: 0.0031 }, dropped_frames: 2 };
  assert.deepEqual(phoneState({ is_connected: true, status }), ["recording", "bad"]);
  assert.deepEqual(phoneState({ is_connected: false, status }), ["not connected", "mute"]);
  assert.deepEqual(phoneFacts({ status }).map(({ text }) => text), ["1920 × 1080", "30 Hz", "battery 10 %", "clock ± 3 ms", "2.0 GB free", "2 dropped"]);
  assert.deepEqual(phoneFacts({ status }).map(({ isWorse }) => Boolean(isWorse)), [false, false, true, false, false, true]);
  assert.deepEqual(phoneFacts(null), []);
});

test("a clip is here when all of its parts are", () => {
  const clip = { started: {}, stopped: { num_parts: 2, lost_s: 1.5, dropped_frames: 0 }, files: [] };
  const live = { is_connected: true, status: { sending: { take: 4, sent_bytes: 30, num_bytes: 60 } } };
  assert.deepEqual(clipState(clip, live, 4), { words: "50 % sent", tone: "run", isHere: false });
  assert.equal(clipState(clip, live, 5).words, "on the phone");
  assert.equal(clipState(clip, null, 4).tone, "warn");
  assert.equal(clipState({ ...clip, files: [{}] }, live, 5).isHere, false);
  assert.equal(clipState({ ...clip, files: [{}, {}] }, null, 4).isHere, true);
  assert.equal(clipState({ ...clip, started: { part: 3 }, files: [{}, {}] }, null, 4).isHere, false);
  assert.equal(clipState({ started: {}, stopped: null, files: [] }, live, 5).words, "recording");
});

test("what was lost is said, with its times in the take", () => {
  const file = { facts: { lost: [{ from_s: 1012.25, to_s: 1013.75 }] } };
  const clip = { started: {}, stopped: { lost_s: 1.5, dropped_frames: 3 }, files: [file] };
  assert.deepEqual(clipLosses(clip, 1000), ["lost 1.5 s, from 0:12.3 to 0:13.8", "3 frames dropped"]);
  assert.deepEqual(clipLosses({ ...clip, files: [] }, 1000), ["lost 1.5 s", "3 frames dropped"]);
  assert.deepEqual(clipLosses({ started: {}, stopped: { lost_s: 0, dropped_frames: 0 }, files: [{ facts: { lost: [] } }] }, 1000), []);
});

test("a take lasts until its stop, or until now", () => {
  const take = { start_s: 100, stop_s: 130, state: "recorded" };
  assert.equal(takeDurationS(take, 500), 30);
  assert.equal(takeDurationS({ ...take, state: "recording" }, 104), 4);
  assert.equal(takeDurationS({ ...take, state: "recording" }, 99), 0);
});

test("a board is named in metres", () => {
  assert.equal(boardName(36), "charuco:7x5:0.036:0.027:DICT_4X4_50");
});
