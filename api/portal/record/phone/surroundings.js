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
