// Number of frames of an MP4 or QuickTime video, from its index (ISO/IEC 14496-12).

const MAX_INDEX_BYTES = 1 << 26;
const HEADER_BYTES = 16;

const typeAt = (view, at) => String.fromCharCode(...[4, 5, 6, 7].map((offset) => view.getUint8(at + offset)));

// Size of a box; that of the last box may be left open.
function sizeAt(view, at, rest) {
  const size = view.getUint32(at);
  if (size === 1) return Number(view.getBigUint64(at + 8));
  return size === 0 ? rest : size;
}

// Boxes in a part of an index as `{ type, from, to }` of their contents.
function boxesIn(view, { from, to }) {
  const boxes = [];
  for (let at = from; at + 8 <= to;) {
    const size = sizeAt(view, at, to - at);
    if (size < 8 || at + size > to) break;
    boxes.push({ type: typeAt(view, at), from: at + 8, to: at + size });
    at += size;
  }
  return boxes;
}

// Box at a path of types below a part; undefined if there is none.
const below = (view, part, ...path) => path.reduce((found, type) => found && boxesIn(view, found).find((box) => box.type === type), part);

function framesOfIndex(view) {
  for (const track of boxesIn(view, { from: 8, to: view.byteLength }).filter(({ type }) => type === "trak")) {
    const handler = below(view, track, "mdia", "hdlr");
    const sizes = below(view, track, "mdia", "minf", "stbl", "stsz");
    if (handler && sizes && typeAt(view, handler.from + 4) === "vide") return view.getUint32(sizes.from + 8) || null;
  }
  return null;
}

// Null of other files, and of videos without an index of all frames.
export async function numFramesOf(file) {
  try {
    for (let at = 0; at + 8 <= file.size;) {
      const header = new DataView(await file.slice(at, at + HEADER_BYTES).arrayBuffer());
      const size = sizeAt(header, 0, file.size - at);
      if (size < 8) return null;
      if (typeAt(header, 0) === "moov") {
        return size > MAX_INDEX_BYTES ? null : framesOfIndex(new DataView(await file.slice(at, at + size).arrayBuffer()));
      }
      at += size;
    }
  } catch (error) {
    if (!(error instanceof RangeError)) throw error; // a cut file
  }
  return null;
}
