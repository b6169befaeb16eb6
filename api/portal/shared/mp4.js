// Index of the pictures in an MP4 or QuickTime file (ISO/IEC 14496-12 and -15): their number, and for a decoder their places.

const HEAD_BYTES = 16;
const MAX_INDEX_BYTES = 64 * 2 ** 20;
const IDENTITY = [0x10000, 0, 0, 0, 0x10000, 0];

/**
 * Read the index of a video.
 *
 * `read(start, stop)` is a promise of the bytes `start` up to but without `stop`, an `ArrayBuffer`, or fewer at the end of the
 * file. Returns a promise of the index, or of null if this is no H.264 video of which each picture is shown as it is, in one
 * piece: of fragments, turned, or of another kind.
 *
 * The index has `codec` and `description` for a `VideoDecoder`, and of each sample, in the order of decoding, `offsets` and
 * `sizes` in bytes, `isKey`, and `frames`: its number in the order of showing.
 */
export async function readIndex(read) {
  const track = videoTrack(await findMovie(read));
  if (!track || !isUpright(path(track, "tkhd"))) return null;
  const table = path(track, "mdia", "minf", "stbl");
  const codec = table && readH264(path(table, "stsd"));
  const sizes = table && readSizes(path(table, "stsz"));
  if (!codec || !sizes || sizes.length === 0) return null;
  return { ...codec, sizes, offsets: readOffsets(table, sizes), isKey: readKeys(path(table, "stss"), sizes.length), frames: readFrames(table, sizes.length) };
}

/** Number of frames of a video file; null of other files, and of videos without an index of all frames. */
export async function countFrames(file) {
  const track = videoTrack(await findMovie((start, stop) => file.slice(start, stop).arrayBuffer(), file.size));
  const table = track && path(track, "mdia", "minf", "stbl", "stsz");
  return (table?.byteLength >= 12 && table.getUint32(8)) || null;
}

/** Content of the index, where there is one. The last box of a file of so many bytes may leave its size open. */
async function findMovie(read, numBytes = 0) {
  for (let start = 0; ;) {
    const head = new DataView(await read(start, start + HEAD_BYTES));
    if (head.byteLength < 8) return null;
    let [size, first] = [head.getUint32(0), 8];
    if (size === 0) size = numBytes - start;
    if (size === 1 && head.byteLength === HEAD_BYTES) [size, first] = [Number(head.getBigUint64(8)), HEAD_BYTES];
    if (readType(head, 4) === "moov") {
      if (size > MAX_INDEX_BYTES) return null;
      const movie = await read(start + first, start + size);
      return movie.byteLength === size - first ? new DataView(movie) : null;
    }
    if (size < first) return null;
    start += size;
  }
}

function readType(view, place) {
  return String.fromCharCode(...[0, 1, 2, 3].map((byte) => view.getUint8(place + byte)));
}

/** Boxes in a box, each with the view of its content. */
function boxes(view, place = 0) {
  const found = [];
  while (place + 8 <= view.byteLength) {
    const size = view.getUint32(place);
    if (size < 8 || place + size > view.byteLength) break;
    found.push({ type: readType(view, place + 4), view: new DataView(view.buffer, view.byteOffset + place + 8, size - 8) });
    place += size;
  }
  return found;
}

/** Content of the box at a path; undefined without one. */
function path(view, ...types) {
  return types.reduce((inside, wanted) => inside && boxes(inside).find(({ type }) => type === wanted)?.view, view);
}

function videoTrack(movie) {
  return movie && boxes(movie).filter(({ type }) => type === "trak").map(({ view }) => view).find(isVideo);
}

function isVideo(track) {
  const handler = path(track, "mdia", "hdlr");
  return handler?.byteLength >= 12 && readType(handler, 8) === "vide";
}

function isUpright(header) {
  if (!header) return false;
  const start = header.getUint8(0) === 1 ? 52 : 40;
  // Rows of three: the third number of each is a perspective, which is not used.
  return IDENTITY.every((value, number) => number % 3 === 2 || header.getInt32(start + 4 * number) === value);
}

function readH264(descriptions) {
  if (!descriptions || descriptions.getUint32(4) !== 1) return null;
  const [entry] = boxes(descriptions, 8);
  if (!entry || !["avc1", "avc3"].includes(entry.type)) return null;
  // After the fields of a visual sample entry.
  const configuration = boxes(entry.view, 78).find(({ type }) => type === "avcC")?.view;
  if (!configuration || configuration.byteLength < 7) return null;
  const hex = (byte) => configuration.getUint8(byte).toString(16).padStart(2, "0");
  const bytes = new Uint8Array(configuration.buffer, configuration.byteOffset, configuration.byteLength);
  return { codec: `${entry.type}.${hex(1)}${hex(2)}${hex(3)}`, description: bytes.slice() };
}

function readSizes(table) {
  if (!table) return null;
  const [same, count] = [table.getUint32(4), table.getUint32(8)];
  return Uint32Array.from({ length: count }, (_, sample) => same || table.getUint32(12 + 4 * sample));
}

/** First byte of each sample: samples follow each other within a chunk. */
function readOffsets(table, sizes) {
  const [narrow, wide, runs] = ["stco", "co64", "stsc"].map((type) => path(table, type));
  const chunkAt = (chunk) => (narrow ? narrow.getUint32(8 + 4 * chunk) : Number(wide.getBigUint64(8 + 8 * chunk)));
  const numChunks = (narrow ?? wide).getUint32(4);
  const numRuns = runs.getUint32(4);
  const offsets = new Float64Array(sizes.length);
  let [sample, run] = [0, 0];
  for (let chunk = 0; chunk < numChunks && sample < sizes.length; chunk++) {
    while (run + 1 < numRuns && runs.getUint32(8 + 12 * (run + 1)) <= chunk + 1) run += 1;
    let at = chunkAt(chunk);
    for (let left = runs.getUint32(12 + 12 * run); left > 0 && sample < sizes.length; left--) {
      offsets[sample] = at;
      at += sizes[sample];
      sample += 1;
    }
  }
  return offsets;
}

function readKeys(table, count) {
  const isKey = new Uint8Array(count).fill(table ? 0 : 1);
  for (let entry = 0; table && entry < table.getUint32(4); entry++) isKey[table.getUint32(8 + 4 * entry) - 1] = 1;
  return isKey;
}

/** Number of each sample in the order of showing. */
function readFrames(table, count) {
  const times = readRuns(path(table, "stts"), count, (view, place) => view.getUint32(place));
  // Times of decoding are sums; offsets to times of showing may be negative.
  for (let sample = 0, at = 0; sample < count; sample++) [times[sample], at] = [at, at + times[sample]];
  const later = path(table, "ctts");
  if (later) readRuns(later, count, (view, place) => view.getInt32(place)).forEach((offset, sample) => { times[sample] += offset; });
  const order = Uint32Array.from({ length: count }, (_, sample) => sample).sort((one, other) => times[one] - times[other] || one - other);
  const frames = new Uint32Array(count);
  order.forEach((sample, frame) => { frames[sample] = frame; });
  return frames;
}

/** Values of a table of runs, one a sample. */
function readRuns(table, count, valueAt) {
  const values = new Float64Array(count);
  let sample = 0;
  for (let run = 0; run < table.getUint32(4) && sample < count; run++) {
    const stop = Math.min(count, sample + table.getUint32(8 + 8 * run));
    values.fill(valueAt(table, 12 + 8 * run), sample, stop);
    sample = stop;
  }
  return values;
}
