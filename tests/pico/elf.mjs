// Images.

import { readFileSync } from 'node:fs';

const FLASH = 0x10000000;
const LOAD = 1;

/**
 * Puts the segments of a 32-bit little-endian ELF where a programmer would: at their physical addresses in flash.
 *
 * @param {string} path the file
 * @param {Uint8Array} flash the whole flash
 */
export function loadElf(path, flash) {
  const file = readFileSync(path);
  if (file.length < 52 || file.readUInt32BE(0) !== 0x7f454c46 || file.readUInt16LE(18) !== 40) {
    throw new Error(`${path} is no ELF file for ARM`);
  }
  const [table, size, count] = [file.readUInt32LE(28), file.readUInt16LE(42), file.readUInt16LE(44)];
  for (let index = 0; index < count; index++) {
    const header = table + index * size;
    const [type, offset, , address, bytes] = [0, 4, 8, 12, 16].map((at) => file.readUInt32LE(header + at));
    if (type !== LOAD || bytes === 0) continue;
    const at = address - FLASH;
    if (at < 0 || at + bytes > flash.length) {
      throw new Error(`${path} has a segment for 0x${address.toString(16)}, which is not in the flash`);
    }
    flash.set(file.subarray(offset, offset + bytes), at);
  }
}
