// Identity of this phone: the link that it was opened by, a secret of its own for each recording, and its name.

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
 * A page that is opened again without the link goes on with the last one.
 */
export function identityOf(hash) {
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
export function deviceOf(userAgent) {
  const browsers = [["Edg", "Edge"], ["OPR", "Opera"], ["SamsungBrowser", "Samsung Internet"], ["Firefox", "Firefox"], ["FxiOS", "Firefox"], ["CriOS", "Chrome"], ["Chrome", "Chrome"], ["Safari", "Safari"]];
  const systems = [["iPhone", "iPhone"], ["iPad", "iPad"], ["Android", "Android"], ["CrOS", "ChromeOS"], ["Windows", "Windows"], ["Mac OS X", "Mac"], ["Linux", "Linux"]];
  const named = (names) => names.find(([part]) => userAgent.includes(part))?.[1];
  return [named(browsers) ?? "Browser", named(systems)].filter(Boolean).join(" on ");
}
