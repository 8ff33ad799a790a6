// UF2 files (https://github.com/microsoft/uf2).

const BLOCK = 512;
const MAGIC = [0x0a324655, 0x9e5d5157];
const LAST_MAGIC = 0x0ab16f30;
const FAMILY = 0xe48bff56;
const HAS_FAMILY = 0x2000;
const PAYLOAD = 256;

/** Whether bytes begin as a UF2 does. */
export const isUf2 = (file) => file.length >= BLOCK && file.readUInt32LE(0) === MAGIC[0];

/**
 * Puts the blocks of a UF2 where the boot loader of an RP2040 would. It erases the sectors of the blocks, and no others.
 *
 * @param {Buffer} file the content of the file
 * @param {Uint8Array} flash the whole flash
 * @param {number} base address of the flash
 * @param {number} sector bytes of a sector
 */
export function loadUf2(file, flash, base, sector) {
  if (file.length % BLOCK) throw new Error('the UF2 does not consist of whole blocks');
  const count = file.length / BLOCK;
  const erased = new Set();
  for (let number = 0; number < count; number++) {
    const block = file.subarray(number * BLOCK, (number + 1) * BLOCK);
    const [first, second, flags, address, bytes, index, total, family] = Array.from({ length: 8 }, (_, word) =>
      block.readUInt32LE(4 * word),
    );
    const isBlock = first === MAGIC[0] && second === MAGIC[1] && block.readUInt32LE(BLOCK - 4) === LAST_MAGIC;
    const isForUs = flags === HAS_FAMILY && family === FAMILY && bytes === PAYLOAD && address % PAYLOAD === 0;
    const at = address - base;
    if (!isBlock || !isForUs || index !== number || total !== count || at < 0 || at + bytes > flash.length) {
      throw new Error(`the boot loader of an RP2040 would not take block ${number} of the UF2`);
    }
    const begin = at - (at % sector);
    if (!erased.has(begin)) flash.fill(0xff, begin, begin + sector);
    erased.add(begin);
    flash.set(block.subarray(32, 32 + bytes), at);
  }
}
