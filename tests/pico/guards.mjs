// What an image must do before it uses a peripheral, and may forget under rp2040js: there everything is out of reset
// and TIMER counts microseconds by itself.

const RESET_DONE = 0x08;
const TICK = 0x2c;
const MHZ = 1e6;

/** Bits of RESETS (RP2040 datasheet 2.14.3) by the peripherals' pages of 16 KiB. */
const RESET_BITS = {
  0x4004c: 1 << 0, 0x40030: 1 << 1, 0x50000: 1 << 2, 0x40044: 1 << 3, 0x40048: 1 << 4, 0x40014: 1 << 5,
  0x40018: 1 << 6, 0x4001c: 1 << 8, 0x40020: 1 << 9, 0x50200: 1 << 10, 0x50300: 1 << 11, 0x40028: 1 << 12,
  0x4002c: 1 << 13, 0x40050: 1 << 14, 0x4005c: 1 << 15, 0x4003c: 1 << 16, 0x40040: 1 << 17, 0x40004: 1 << 18,
  0x40000: 1 << 19, 0x4006c: 1 << 20, 0x40054: 1 << 21, 0x40034: 1 << 22, 0x40038: 1 << 23, 0x50100: 1 << 24,
  0x50110: 1 << 24,
};
const ALL = 0x1ffffff;
/** What the boot ROM has taken out of reset to reach the flash: IO_QSPI and PADS_QSPI. */
const BY_ROM = (1 << 6) | (1 << 9);

/**
 * Watches over the first use of peripherals.
 *
 * @param {object} chip the emulated RP2040
 * @param {(what: string, address: number) => void} complain told of a use that would fail on the chip
 */
export function guard(chip, complain) {
  const resets = chip.peripherals[0x4000c];
  resets.reset = ALL & ~BY_ROM;
  const { readUint32 } = resets;
  resets.readUint32 = (offset) => (offset === RESET_DONE ? ALL & ~resets.reset : readUint32.call(resets, offset));

  const watchdog = chip.peripherals[0x40058];
  const { writeUint32 } = watchdog;
  let cycles = 0;
  watchdog.writeUint32 = (offset, value) => {
    if (offset === TICK) cycles = value & 0x1ff;
    writeUint32.call(watchdog, offset, value);
  };

  chip.findPeripheral = (address) => {
    const page = (address >>> 14) << 2;
    if (resets.reset & RESET_BITS[page]) complain('access to a peripheral in reset', address);
    if (page === 0x40054 && chip.clocks.refFreq !== cycles * MHZ) {
      complain(`TIMER counts no microseconds: WATCHDOG.TICK divides ${chip.clocks.refFreq} Hz by ${cycles}`, address);
    }
    return chip.peripherals[page];
  };
}
