// Zip archives in the browser: their entries, and the content of one.

// Records of the format (APPNOTE.TXT of PKWARE, sections 4.3.12 to 4.3.16) by their first four bytes.
const [ENTRY, END, END_64, LOCATOR_64] = [0x02014b50, 0x06054b50, 0x06064b50, 0x07064b50];
const [END_BYTES, LOCATOR_BYTES, ENTRY_BYTES, LOCAL_BYTES] = [22, 20, 46, 30];
const MAX_COMMENT_BYTES = 0xffff;
const [STORED, DEFLATED] = [0, 8];
const MAX_CONTENT_BYTES = 4 * 2 ** 20; // as the service allows a frame

const viewOf = async (blob, start, end) => new DataView(await blob.slice(start, end).arrayBuffer());

/** Entries of an archive, a Blob: `{ name, start, method, packedBytes, numBytes }` each; throws if it is none. */
export async function entriesOf(blob) {
  const { start, numBytes } = await directoryOf(blob);
  const view = await viewOf(blob, start, start + numBytes);
  const decoder = new TextDecoder();
  const entries = [];
  for (let at = 0; at + ENTRY_BYTES <= view.byteLength && view.getUint32(at, true) === ENTRY;) {
    const [nameBytes, extraBytes, commentBytes] = [28, 30, 32].map((offset) => view.getUint16(at + offset, true));
    entries.push({
      name: decoder.decode(new Uint8Array(view.buffer, at + ENTRY_BYTES, nameBytes)), method: view.getUint16(at + 10, true),
      packedBytes: view.getUint32(at + 20, true), numBytes: view.getUint32(at + 24, true), start: view.getUint32(at + 42, true),
    });
    at += ENTRY_BYTES + nameBytes + extraBytes + commentBytes;
  }
  return entries;
}

/** Text of an entry. */
export async function textOf(blob, { name, start, method, packedBytes, numBytes }) {
  if (numBytes > MAX_CONTENT_BYTES || ![STORED, DEFLATED].includes(method)) throw new Error(`${name} in the zip is too large, or packed in an unusual way.`);
  const head = await viewOf(blob, start, start + LOCAL_BYTES);
  const first = start + LOCAL_BYTES + head.getUint16(26, true) + head.getUint16(28, true);
  const content = blob.slice(first, first + packedBytes);
  if (method === STORED) return content.text();
  return new Response(content.stream().pipeThrough(new DecompressionStream("deflate-raw")).pipeThrough(limited(name, numBytes))).text();
}

/** Stream that breaks off where there are more bytes than the archive states. */
function limited(name, numBytes) {
  let left = numBytes;
  return new TransformStream({
    transform(chunk, controller) {
      left -= chunk.byteLength;
      if (left < 0) throw new Error(`${name} in the zip is larger than it states.`);
      controller.enqueue(chunk);
    },
  });
}

/** Place of the list of entries. */
async function directoryOf(blob) {
  const from = Math.max(0, blob.size - END_BYTES - MAX_COMMENT_BYTES - LOCATOR_BYTES);
  const tail = await viewOf(blob, from, blob.size);
  for (let at = tail.byteLength - END_BYTES; at >= 0; at--) {
    if (tail.getUint32(at, true) !== END) continue;
    const locator = at - LOCATOR_BYTES;
    if (locator < 0 || tail.getUint32(locator, true) !== LOCATOR_64) return { numBytes: tail.getUint32(at + 12, true), start: tail.getUint32(at + 16, true) };
    const place = Number(tail.getBigUint64(locator + 8, true));
    const end = await viewOf(blob, place, place + 56);
    if (end.byteLength === 56 && end.getUint32(0, true) === END_64) return { numBytes: Number(end.getBigUint64(40, true)), start: Number(end.getBigUint64(48, true)) };
  }
  throw new Error("The file is no zip.");
}
