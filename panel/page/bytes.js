// The parts of a frame, as far as they are known: Modbus RTU, Modbus/TCP or text.

const FUNCTIONS = {
  1: "read coils", 2: "read discrete inputs", 3: "read holding registers", 4: "read input registers", 5: "write a coil",
  6: "write a register", 7: "read exception status", 8: "diagnostics", 15: "write coils", 16: "write registers",
  17: "report server id", 22: "mask write a register", 23: "read and write registers", 43: "read identification",
};

const EXCEPTIONS = {
  1: "illegal function", 2: "illegal data address", 3: "illegal data value", 4: "server device failure",
  5: "acknowledge", 6: "server device busy", 8: "memory parity error", 10: "gateway path unavailable",
  11: "gateway target failed to respond",
};

export const toBytes = hex => (hex.match(/../g) ?? []).map(pair => parseInt(pair, 16));
const pairs = bytes => bytes.map(byte => byte.toString(16).toUpperCase().padStart(2, "0")).join(" ");
const word = (bytes, at) => 256 * bytes[at] + bytes[at + 1];

/** CRC-16 of Modbus; 0 over a frame that ends with its right CRC. */
function crc(bytes) {
  let rest = 0xffff;
  for (const byte of bytes) {
    rest ^= byte;
    for (let bit = 0; bit < 8; bit++) rest = rest & 1 ? (rest >> 1) ^ 0xa001 : rest >> 1;
  }
  return rest;
}

const isText = bytes => bytes.length > 0 && bytes.every(byte => (byte >= 32 && byte < 127) || [3, 10, 13, 27].includes(byte));

/** Printable characters as they are, others by their names. */
function characters(bytes) {
  const names = { 3: "␃", 10: "␊", 13: "␍", 27: "␛" };
  return bytes.map(byte => names[byte] ?? (byte >= 32 && byte < 127 ? String.fromCharCode(byte) : "·")).join("");
}

/** A frame as a list of `[bytes in hexadecimal, meaning]`. */
export function parts(hex, isAnswer) {
  const bytes = toBytes(hex);
  if (bytes.length >= 4 && crc(bytes) === 0) {
    return [
      [pairs(bytes.slice(0, 1)), bytes[0] === 0 ? "to all addresses" : `address ${bytes[0]}`],
      ...pdu(bytes.slice(1, -2), isAnswer),
      [pairs(bytes.slice(-2)), "CRC, right"],
    ];
  }
  if (bytes.length >= 8 && word(bytes, 2) === 0 && word(bytes, 4) === bytes.length - 6) {
    return [
      [pairs(bytes.slice(0, 2)), `transaction ${word(bytes, 0)}`],
      [pairs(bytes.slice(2, 4)), "protocol"],
      [pairs(bytes.slice(4, 6)), `${bytes.length - 6} bytes follow`],
      [pairs(bytes.slice(6, 7)), `unit ${bytes[6]}`],
      ...pdu(bytes.slice(7), isAnswer),
    ];
  }
  if (isText(bytes)) return [[pairs(bytes), characters(bytes)]];
  return [[pairs(bytes), bytes.length >= 4 ? "no valid frame: the CRC does not match" : "too short for a frame"]];
}

/** The hint for a request to addresses without a register that has registers one beside them; undefined for others. */
export function besideRegisters(request, registers) {
  const bytes = toBytes(request);
  const [code, ...rest] = bytes.length >= 4 && crc(bytes) === 0 ? bytes.slice(1, -2) : bytes.slice(7);
  const space = { 1: "coil", 2: "discrete", 3: "holding", 4: "input", 5: "coil", 6: "holding", 15: "coil", 16: "holding" }[code];
  if (!space || rest.length < 4) return undefined;
  const first = word(rest, 0), count = [5, 6].includes(code) ? 1 : word(rest, 2);
  const exists = at => registers.some(register => register.space === space && at >= register.address && at < register.address + register.addresses);
  const allFrom = from => Array.from({ length: Math.min(count, 2000) }, (_, i) => from + i).every(exists);
  const other = allFrom(first) ? undefined : [first - 1, first + 1].find(allFrom);
  return other === undefined ? undefined
    : `Is it one off? There is a register at 0x${other.toString(16).toUpperCase().padStart(4, "0")} (${other}). The manuals of these drives and pymodbus count registers from 0, some masters, such as mbpoll, from 1.`;
}

function pdu(bytes, isAnswer) {
  const code = bytes[0];
  const list = [];
  let at = 0;
  const take = (count, meaning) => {
    if (count <= 0 || at >= bytes.length) return;
    const piece = bytes.slice(at, at + count);
    list.push([pairs(piece), meaning(piece)]);
    at += count;
  };
  const number = name => piece => `${name} ${piece.length > 1 ? word(piece, 0) : piece[0]}`;
  const address = piece => `${[1, 5, 15].includes(code) ? "coil" : code === 2 ? "discrete input" : "register"} 0x${word(piece, 0).toString(16).toUpperCase().padStart(4, "0")} (${word(piece, 0)})`;
  const words = () => {
    while (at + 1 < bytes.length) take(2, piece => String(word(piece, 0)));
  };
  if (isAnswer && code & 0x80) {
    take(1, () => `${FUNCTIONS[code & 0x7f] ?? `function ${code & 0x7f}`}: refused (0x80 added)`);
    take(1, piece => `exception ${piece[0]}: ${EXCEPTIONS[piece[0]] ?? "of the maker"}`);
  } else {
    take(1, () => `function ${code}: ${FUNCTIONS[code] ?? "of the maker"}`);
    if ([1, 2, 3, 4].includes(code)) {
      if (isAnswer) {
        take(1, number("bytes:"));
        if (code > 2) words();
      } else {
        take(2, address);
        take(2, number("how many:"));
      }
    } else if (code === 5 || code === 6) {
      take(2, address);
      take(2, code === 5 ? piece => ({ 0: "off", 0xff00: "on" })[word(piece, 0)] ?? `value ${word(piece, 0)}` : number("value"));
    } else if (code === 15 || code === 16) {
      take(2, address);
      take(2, number("how many:"));
      if (!isAnswer) {
        take(1, number("bytes:"));
        if (code === 16) words();
      }
    }
  }
  take(bytes.length - at, () => "data");
  return list;
}
