// Camera of the phone: opened at a size and rate, its exposure, focus and white balance held still.

import { cleanName } from "../names.js";

// Sound as it is: what makes calls pleasant would take the claps and beeps out that clocks are measured by.
const SOUND = { echoCancellation: false, noiseSuppression: false, autoGainControl: false };
// Modes that hold a value still, with the setting that they hold.
const HELD = [["exposureMode", "exposureTime"], ["focusMode", "focusDistance"], ["whiteBalanceMode", "colorTemperature"]];
const STILL = ["manual", "none"]; // browsers name it by one or the other
const USUAL_RATE_HZ = 30;

/** Constraints of a size and rate that a camera reaches as closely as it can. */
export function videoConstraints({ width, height, frame_rate_hz: rateHz }, facing) {
  return { facingMode: facing, width: { ideal: width }, height: { ideal: height }, frameRate: { ideal: rateHz } };
}

/** Constraints that hold a camera's exposure, focus and white balance as they are, where it can; null where it can't. */
export function heldConstraints(capabilities, settings) {
  const held = HELD.map(([mode, value]) => {
    const still = STILL.find((name) => capabilities[mode]?.includes(name));
    return still ? { [mode]: still, ...(settings[value] !== undefined && { [value]: settings[value] }) } : null;
  }).filter(Boolean);
  return held.length ? { advanced: held } : null;
}

/** Camera and microphone as one stream; a phone without a microphone, or that keeps it to itself, sends no sound. */
export async function openCamera(wanted, facing = "environment") {
  const video = videoConstraints(wanted, facing);
  try {
    return await navigator.mediaDevices.getUserMedia({ video, audio: SOUND });
  } catch {
    return navigator.mediaDevices.getUserMedia({ video });
  }
}

/** Hold the camera still, but for its size and rate. Returns the names of what is held. */
export async function holdStill(track) {
  const constraints = heldConstraints(track.getCapabilities?.() ?? {}, track.getSettings());
  if (!constraints) return [];
  const held = [];
  // One by one: a camera that refuses one of them may hold the others.
  for (const constraint of constraints.advanced) {
    await track.applyConstraints({ ...track.getConstraints(), advanced: [...held, constraint] }).then(() => held.push(constraint), () => null);
  }
  return held.map((constraint) => Object.keys(constraint)[0]);
}

/** Let the camera choose its exposure, focus and white balance again. */
export const release = (track) => track.applyConstraints({ ...track.getConstraints(), advanced: [] }).catch(() => null);

/** Size and rate as a phone has them that is held upright, or lies on its long side. */
export function turned({ width, height, frame_rate_hz: rateHz }, isUpright) {
  const [long, short] = [Math.max(width, height), Math.min(width, height)];
  return isUpright ? { width: short, height: long, frame_rate_hz: rateHz } : { width: long, height: short, frame_rate_hz: rateHz };
}

/** Bring the camera to a size and rate, unless it has them; it is not turned. */
export async function adjust(track, settings) {
  const now = track.getSettings();
  const wanted = turned(settings, now.height > now.width);
  const isThere = now.width === wanted.width && now.height === wanted.height && Math.abs((now.frameRate ?? wanted.frame_rate_hz) - wanted.frame_rate_hz) < 0.5;
  if (!isThere) await track.applyConstraints(videoConstraints(wanted, now.facingMode)).catch(() => null);
}

/**
 * Facts and abilities of the track as the service takes them; none of a camera that does not tell its size.
 *
 * Browsers that don't tell a rate record about 30 frames a second.
 */
export function factsOf(track) {
  const { width, height, frameRate: toldRate, facingMode } = track.getSettings();
  if (!(width > 0 && height > 0)) return {};
  const frameRate = toldRate > 0 ? toldRate : USUAL_RATE_HZ;
  const can = track.getCapabilities?.() ?? {};
  const label = cleanName(track.label ?? "", 100);
  return {
    track: { width, height, frame_rate_hz: frameRate, ...(facingMode && { facing: facingMode }), ...(label && { label }) },
    capabilities: {
      max_width: can.width?.max ?? width, max_height: can.height?.max ?? height, max_frame_rate_hz: can.frameRate?.max || frameRate,
      locks: HELD.map(([mode]) => mode).filter((mode) => STILL.some((name) => can[mode]?.includes(name))),
    },
  };
}

/** Frames that the browser itself had to leave out since the track began; null where it does not say. */
export const discardedFrames = (track) => track.stats?.discardedFrames ?? null;

/** Sentence of a camera that can't be opened. */
export function cameraProblem({ name }) {
  if (!globalThis.isSecureContext) return { message: "Browsers give the camera to encrypted pages only.", hint: "Open the link that begins with https." };
  if (name === "NotAllowedError") return { message: "The camera is not allowed.", hint: "Allow it in the settings of the browser for this page, and try again." };
  if (name === "NotFoundError") return { message: "This device has no camera.", hint: null };
  return { message: "The camera can't be opened.", hint: "Close other apps that use it, and try again." };
}
