// Slate: the screen flashes white and beeps, so that all phones see and hear the same moment.

const FLASHES_MS = [300, 900]; // fewer than three a second
const FLASH_MS = 120;
const END_MS = 1500;
const [BEEP_HZ, VOLUME] = [1000, 0.8];

function beep(audio, atS) {
  const tone = new OscillatorNode(audio, { frequency: BEEP_HZ });
  const volume = new GainNode(audio, { gain: VOLUME });
  tone.connect(volume).connect(audio.destination);
  tone.start(atS);
  tone.stop(atS + FLASH_MS / 1000);
}

/** Show the slate over the whole page; resolves when it is over. */
export async function slate() {
  const dialog = Object.assign(document.createElement("dialog"), { className: "slate", ariaLabel: "Slate" });
  document.body.append(dialog);
  dialog.showModal();
  await dialog.requestFullscreen?.().catch(() => null);
  const audio = new AudioContext();
  const beginS = audio.currentTime;
  for (const atMs of FLASHES_MS) {
    beep(audio, beginS + atMs / 1000);
    setTimeout(() => dialog.classList.add("lit"), atMs);
    setTimeout(() => dialog.classList.remove("lit"), atMs + FLASH_MS);
  }
  await new Promise((resolve) => { setTimeout(resolve, END_MS); });
  if (document.fullscreenElement === dialog) await document.exitFullscreen().catch(() => null);
  dialog.remove();
  await audio.close();
}
