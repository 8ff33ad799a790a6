// Numbers as people read them.

const THIN = " ";
const MINUS = "−";

/** The order of names as people count: x2 before x10. */
export const byName = new Intl.Collator("en", { numeric: true }).compare;

/** A number with thin spaces between thousands, and at most `digits` decimals. */
export function number(value, digits = 0) {
  if (!Number.isFinite(value)) return "–";
  const [whole, part] = Math.abs(value).toFixed(digits).split(".");
  const grouped = whole.replace(/\B(?=(\d{3})+$)/g, THIN);
  const sign = value < 0 && Number(whole + (part ? "." + part : "")) !== 0 ? MINUS : "";
  return sign + grouped + (part ? "." + part : "");
}

/** Bench time in seconds, with minutes and hours from one minute on. */
export function clock(seconds, digits = 3) {
  const hours = Math.floor(seconds / 3600), minutes = Math.floor(seconds / 60) % 60;
  const rest = (seconds - Math.floor(seconds / 60) * 60).toFixed(digits);
  if (seconds < 60) return rest;
  const padded = rest.padStart(digits ? digits + 3 : 2, "0");
  return hours ? `${hours}:${String(minutes).padStart(2, "0")}:${padded}` : `${minutes}:${padded}`;
}

/** A duration with a unit that fits. */
export function duration(seconds) {
  if (seconds < 0.001) return `${number(seconds * 1e6)} µs`;
  if (seconds < 0.1) return `${number(seconds * 1e3, 1)} ms`;
  if (seconds < 1) return `${number(seconds * 1e3)} ms`;
  if (seconds < 60) return `${number(seconds, seconds < 10 ? 2 : 1)} s`;
  return `${clock(seconds, 0)} min`;
}

/** A register's value in hexadecimal; a negative one as the bits of 16 or 32 bits. */
export function hex(value, digits = 4) {
  const bits = value < 0 ? (digits > 4 ? value >>> 0 : value & 0xffff) : value;
  return "0x" + bits.toString(16).toUpperCase().padStart(digits, "0");
}

/** Numbers of messages without success in words, empty if there are none. */
export const failuresInWords = ({ refused, unanswered }) =>
  [[refused, "refused"], [unanswered, "unanswered"]].filter(([count]) => count).map(([count, word]) => `${number(count)} ${word}`).join(", ");

/** A rate from 0 to 1 as a percentage. */
export const percent = rate => `${number(rate * 100, rate > 0 && rate < 0.01 ? 2 : rate < 0.1 ? 1 : 0)} %`;
