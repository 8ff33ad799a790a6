// Makes a PNG of a screen small: at most 256 colours, and the best compression.

import { crc32, deflateSync, inflateSync } from "node:zlib";

const SIGNATURE = Buffer.from([0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a]);
const COLOURS = 256;

/** The chunks of a PNG: [type, data]. */
function* chunks(png) {
  for (let place = 8; place < png.length;) {
    const length = png.readUInt32BE(place);
    yield [png.toString("latin1", place + 4, place + 8), png.subarray(place + 8, place + 8 + length)];
    place += 12 + length;
  }
}

function chunk(type, data) {
  const body = Buffer.concat([Buffer.from(type, "latin1"), data]);
  const frame = Buffer.alloc(8);
  frame.writeUInt32BE(data.length, 0);
  frame.writeUInt32BE(crc32(body), 4);
  return Buffer.concat([frame.subarray(0, 4), body, frame.subarray(4)]);
}

/** Pixels as 0xRRGGBB. */
function pixels(header, data) {
  const [width, height, depth, type] = [header.readUInt32BE(0), header.readUInt32BE(4), header[8], header[9]];
  if (depth !== 8 || (type !== 2 && type !== 6)) throw new Error(`a PNG of depth ${depth} and type ${type}`);
  const of = type === 2 ? 3 : 4, stride = width * of, lines = inflateSync(data), out = new Uint32Array(width * height);
  let above = Buffer.alloc(stride);
  for (let y = 0; y < height; y++) {
    const filter = lines[y * (stride + 1)], line = Buffer.from(lines.subarray(y * (stride + 1) + 1, (y + 1) * (stride + 1)));
    for (let x = 0; x < stride; x++) {
      const a = x < of ? 0 : line[x - of], b = above[x], c = x < of ? 0 : above[x - of], p = a + b - c;
      const nearest = Math.abs(p - a) <= Math.abs(p - b) && Math.abs(p - a) <= Math.abs(p - c) ? a : Math.abs(p - b) <= Math.abs(p - c) ? b : c;
      line[x] += [0, a, b, (a + b) >> 1, nearest][filter];
    }
    for (let x = 0; x < width; x++) out[y * width + x] = (line[x * of] << 16) | (line[x * of + 1] << 8) | line[x * of + 2];
    above = line;
  }
  return { width, height, out };
}

const distance = (a, b) => ((a >> 16) - (b >> 16)) ** 2 + (((a >> 8) & 255) - ((b >> 8) & 255)) ** 2 + ((a & 255) - (b & 255)) ** 2;

/** A PNG of the same screen with a palette of its most frequent colours; others become the nearest one. */
export function small(png) {
  const all = [...chunks(png)], header = Buffer.from(all[0][1]);
  const { width, height, out } = pixels(header, Buffer.concat(all.filter(([type]) => type === "IDAT").map(([, data]) => data)));
  const counts = new Map();
  for (const pixel of out) counts.set(pixel, (counts.get(pixel) ?? 0) + 1);
  const frequent = [...counts].sort((a, b) => b[1] - a[1]).map(([pixel]) => pixel);
  const palette = [];
  // Two colours that nobody can tell apart need one place.
  for (const pixel of frequent) if (palette.length < COLOURS && palette.every(other => distance(pixel, other) > 30)) palette.push(pixel);
  const nearest = new Map(frequent.map(pixel => [pixel, palette.reduce((best, other, at) => (distance(pixel, other) < distance(pixel, palette[best]) ? at : best), 0)]));
  const lines = Buffer.alloc((width + 1) * height);
  for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) lines[y * (width + 1) + 1 + x] = nearest.get(out[y * width + x]);
  header[9] = 3;
  const colours = Buffer.from(palette.flatMap(pixel => [pixel >> 16, (pixel >> 8) & 255, pixel & 255]));
  return Buffer.concat([SIGNATURE, chunk("IHDR", header), chunk("PLTE", colours), chunk("IDAT", deflateSync(lines, { level: 9 })), chunk("IEND", Buffer.alloc(0))]);
}
