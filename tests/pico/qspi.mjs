// The flash chip without its window: bytes that the processor exchanges with it through the SSI (RP2040 datasheet 4.10),
// while it selects the chip by an override of the pin (2.19.6.2). The chip knows one command, that for its unique number.

import { BasePeripheral } from 'rp2040js';

const SELECT = 0x0c;
const OVERRIDE = { mask: 3 << 8, low: 2 << 8 };
const PINS = 0x30;
const SSI = { status: 0x28, data: 0x60 };
const STATUS = { notFull: 1 << 1, empty: 1 << 2, received: 1 << 3 };
/** "Read Unique ID Number" (W25Q16JV data sheet 8.2.31): after it and four bytes more the chip says its number. */
const READ_UNIQUE_ID = 0x4b;
const BEFORE_ID = 5;

/** Registers of the flash's pins. */
class QspiPins extends BasePeripheral {
  constructor(rp2040) {
    super(rp2040, 'IO_QSPI');
    this.words = new Map();
  }

  /** Whether software holds the chip selected. */
  get isSelected() {
    return (this.words.get(SELECT) & OVERRIDE.mask) === OVERRIDE.low;
  }

  /** Lets the SSI select the chip, as the ROM's flash_flush_cache does. */
  release() {
    this.words.delete(SELECT);
  }

  readUint32(offset) {
    return offset < PINS ? (this.words.get(offset) ?? 0) : super.readUint32(offset);
  }

  writeUint32(offset, value) {
    if (offset < PINS) this.words.set(offset, value);
    else super.writeUint32(offset, value);
  }
}

/**
 * Lets a chip exchange bytes with its flash.
 *
 * @param {object} chip the emulated RP2040, with `xip`, whether the window is open
 * @param {import('./flash.mjs').Flash} flash the flash chip
 * @param {(what: string) => void} complain told of what the flash would not answer
 * @returns {QspiPins} the pins
 */
export function connectFlash(chip, flash, complain) {
  const pins = new QspiPins(chip);
  chip.peripherals[0x40018] = pins;
  const ssi = chip.peripherals[0x18000];
  const { readUint32, writeUint32 } = ssi;
  let sent = [];
  const received = [];
  pins.writeUint32 = function (offset, value) {
    const wasSelected = this.isSelected;
    QspiPins.prototype.writeUint32.call(this, offset, value);
    if (!wasSelected && this.isSelected) sent = [];
  };
  ssi.writeUint32 = (offset, value) => {
    if (offset !== SSI.data || !pins.isSelected) {
      writeUint32.call(ssi, offset, value);
      return;
    }
    if (chip.xip || flash.busy) complain('a command to the flash while it is read or busy');
    sent.push(value & 0xff);
    if (sent[0] !== READ_UNIQUE_ID) complain(`the flash knows no command ${sent[0].toString(16)} here`);
    received.push(flash.uniqueId[sent.length - 1 - BEFORE_ID] ?? 0xff);
  };
  ssi.readUint32 = (offset) => {
    if (!pins.isSelected) return readUint32.call(ssi, offset);
    if (offset === SSI.status) return STATUS.notFull | STATUS.empty | (received.length ? STATUS.received : 0);
    if (offset === SSI.data) return received.shift() ?? 0;
    return readUint32.call(ssi, offset);
  };
  return pins;
}
