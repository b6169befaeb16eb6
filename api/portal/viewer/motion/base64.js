// Arrays of numbers in texts of JSON.

/** Little-endian integers in base64. */
export function integers(text, Kind = Int16Array) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Kind(bytes.buffer);
}
