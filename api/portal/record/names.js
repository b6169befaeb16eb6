// Names of phones and takes as the service takes them: on one line, without invisible characters and slashes.

const MAX_LENGTH = 64;

/** Name that was typed, as it can be sent; empty if nothing of it can. */
export function cleanName(text, maxLength = MAX_LENGTH) {
  const name = text.replace(/[\s\p{Z}]+/gu, " ").replace(/\p{C}/gu, "").replace(/[/\\]/g, "-").trim();
  return /^[ .]*$/.test(name) ? "" : [...name].slice(0, maxLength).join("").trim();
}
