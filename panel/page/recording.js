// A part of a recording, from one bench time to another. The bench records always; this cuts out of what it has kept.

const NANO = 1e9; // both formats count nanoseconds of bench time

/** The part of a file from `from` to `to`, in seconds. A trace stays whole: a replay needs its beginning. */
export async function cut(format, blob, from, to) {
  if (format === "vcd") return new Blob([cutVcd(await blob.text(), from * NANO, to * NANO)], { type: blob.type });
  if (format === "pcapng") return new Blob(cutPcapng(await blob.arrayBuffer(), from * NANO, to * NANO), { type: blob.type });
  return blob;
}

/** Waveforms (IEEE 1364-2001, section 18): a value from before the part holds at its beginning. */
export function cutVcd(text, from, to) {
  const end = text.indexOf("$enddefinitions");
  const body = text.indexOf("\n", end) + 1;
  const values = new Map(), part = [];
  let time = 0, begun = false;
  const begin = () => {
    begun = true;
    part.push(`#${Math.round(from)}`, "$dumpvars", ...values.values(), "$end");
  };
  for (const line of text.slice(body).split("\n")) {
    if (line === "" || line.startsWith("$")) continue;
    if (line.startsWith("#")) {
      time = Number(line.slice(1));
      if (time > to) break;
      if (time > from && !begun) begin();
      if (begun) part.push(line);
    } else if (begun) part.push(line);
    else values.set(/^[rs]/.test(line) ? line.slice(line.lastIndexOf(" ") + 1) : line.slice(1), line);
  }
  if (!begun) begin();
  if (time < to || part.at(-1) !== `#${time}`) part.push(`#${Math.round(to)}`);
  return `${text.slice(0, body)}${part.join("\n")}\n`;
}

/** Frames: the blocks with packets (type 6) of the part, and all blocks that describe. */
export function cutPcapng(bytes, from, to) {
  const view = new DataView(bytes), kept = [];
  for (let at = 0; at + 12 <= view.byteLength;) {
    const length = view.getUint32(at + 4, true);
    if (length < 12) break;
    const time = view.getUint32(at + 12, true) * 2 ** 32 + view.getUint32(at + 16, true);
    if (view.getUint32(at, true) !== 6 || (time >= from && time <= to)) kept.push(bytes.slice(at, at + length));
    at += length;
  }
  return kept;
}
