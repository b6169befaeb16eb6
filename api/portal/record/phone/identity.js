// Identity of this phone: the link that it was opened by, a secret of its own for each recording, and its name.

import { PHONE } from "../../shared/strings/phone.js";

const KEY = "multicap.phone";
const MAX_KEPT = 20;

function kept() {
  try {
    return JSON.parse(localStorage.getItem(KEY)) ?? [];
  } catch {
    return [];
  }
}

/** Recording and secret of an address that ends with `#join=RECORDING.SECRET`; null of another one. */
export function readJoin(hash) {
  const [, recording, secret] = /^#join=([0-9a-f-]{36})\.(mcl_[\w-]+)$/.exec(hash) ?? [];
  return recording ? { recording, secret } : null;
}

/**
 * Identity of the phone: `{ recording, secret, phoneId, name, isKnown }`; null if no link was opened here yet.
 *
 * A page that is opened again without the link continues with the last one.
 */
export function readIdentity(hash) {
  const entries = kept();
  const join = readJoin(hash) ?? entries.at(-1);
  if (!join) return null;
  const known = entries.find(({ recording }) => recording === join.recording);
  return { phoneId: crypto.randomUUID(), name: entries.at(-1)?.name ?? "", ...known, recording: join.recording, secret: join.secret, isKnown: known !== undefined };
}

/** Keep an identity for the next time that the page is opened. */
export function keepIdentity(identity) {
  const others = kept().filter(({ recording }) => recording !== identity.recording);
  try {
    localStorage.setItem(KEY, JSON.stringify([...others, identity].slice(-MAX_KEPT)));
  } catch { /* storage is off: a page that is opened again is another phone */ }
}

/** Short name of the browser and the device, from its user agent. */
export function describeDevice(userAgent) {
  const browsers = [["Edg", "Edge"], ["OPR", "Opera"], ["SamsungBrowser", "Samsung Internet"], ["Firefox", "Firefox"], ["FxiOS", "Firefox"], ["CriOS", "Chrome"], ["Chrome", "Chrome"], ["Safari", "Safari"]];
  const systems = [["iPhone", "iPhone"], ["iPad", "iPad"], ["Android", "Android"], ["CrOS", "ChromeOS"], ["Windows", "Windows"], ["Mac OS X", "Mac"], ["Linux", "Linux"]];
  const named = (names) => names.find(([part]) => userAgent.includes(part))?.[1];
  return PHONE.device(named(browsers), named(systems));
}

// Reserves of the phone: its battery, its storage, and a screen that stays on.

/** Charge of the battery, where the browser tells of it. */
export async function readBattery() {
  const battery = await navigator.getBattery?.().catch(() => null);
  return battery ? { battery: battery.level, charging: battery.charging } : {};
}

/** Bytes that the browser may still keep; null if it does not say. */
export async function readFreeBytes() {
  const estimate = await navigator.storage?.estimate?.().catch(() => null);
  return estimate?.quota === undefined ? null : Math.max(0, Math.floor(estimate.quota - estimate.usage));
}

/** Keeps the screen on as long as the page is seen. */
export class WakeLock {
  #lock = null;
  isHeld = false;

  constructor() {
    document.addEventListener("visibilitychange", this.#take);
    this.#take();
  }

  close() {
    document.removeEventListener("visibilitychange", this.#take);
    this.#lock?.release().catch(() => null);
  }

  #take = async () => {
    if (document.hidden || this.#lock?.released === false) return;
    this.#lock = await navigator.wakeLock?.request("screen").catch(() => null) ?? null;
    this.isHeld = this.#lock !== null;
  };
}
