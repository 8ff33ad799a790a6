// A PL011 that takes its time (RP2040 datasheet 4.2; "TRM" is ARM's DDI 0183), in place of rp2040js's, whose
// characters take none. Without DMA, loop-back, IrDA, flow control and breaks sent.

import { BasePeripheral } from 'rp2040js';

const REG = {
  dr: 0x00, rsr: 0x04, fr: 0x18, ibrd: 0x24, fbrd: 0x28, lcrH: 0x2c, cr: 0x30, ifls: 0x34,
  imsc: 0x38, ris: 0x3c, mis: 0x40, icr: 0x44, dmacr: 0x48,
};
const FR = { busy: 1 << 3, rxEmpty: 1 << 4, txFull: 1 << 5, rxFull: 1 << 6, txEmpty: 1 << 7 };
const LCR = { parity: 1 << 1, twoStops: 1 << 3, fifo: 1 << 4 };
const CR = { enable: 1 << 0, tx: 1 << 8, rx: 1 << 9 };
/** Interrupt bits. */
export const INT = {
  rx: 1 << 4, tx: 1 << 5, timeout: 1 << 6, framing: 1 << 7, parity: 1 << 8, break: 1 << 9, overrun: 1 << 10,
};
/** What may be wrong with a received character: bits of DR. */
export const ERROR = { framing: 1 << 8, parity: 1 << 9, break: 1 << 10, overrun: 1 << 11 };

const DEPTH = 32;
/** Characters at which the FIFOs' interrupts come, by the field of IFLS. */
const LEVELS = [4, 8, 16, 24, 28, 28, 28, 28];
/** The receive timeout, in bits without a character. */
const TIMEOUT_BITS = 32;

/** One UART. Characters begin and end at exact instants of virtual time. */
export class Pl011 extends BasePeripheral {
  /**
   * @param {object} rp2040 the chip: its `clock` and `setInterrupt` are used
   * @param {number} irq the UART's interrupt
   * @param {{clockHz: () => number, sent: (byte: number) => void}} line `clockHz` is the frequency of clk_peri in Hz,
   *   0 if it stands; `sent` is called at the instant at which the start bit of a character begins
   */
  constructor(rp2040, irq, line) {
    super(rp2040, 'UART');
    this.irq = irq;
    this.line = line;
    this.divisor = { integer: 0, fraction: 0 };
    this.latched = 0;
    this.format = 0;
    this.control = CR.tx | CR.rx;
    this.levels = 0x12;
    this.mask = 0;
    this.raw = 0;
    this.status = 0;
    this.dmacr = 0;
    this.tx = [];
    this.rx = [];
    this.shifting = false;
    this.overrun = false;
    this.endOfCharacter = rp2040.clock.createAlarm(() => this.shifted());
    this.silence = rp2040.clock.createAlarm(() => this.timedOut());
  }

  /** ns of one bit at the programmed rate; 0 if none is programmed. */
  get bitNanos() {
    const hz = this.line.clockHz();
    return hz ? (16e9 * this.latched) / (64 * hz) : 0;
  }

  /** ns of one character in the programmed format, from its start bit to the end of its last stop bit. */
  get characterNanos() {
    const data = 5 + ((this.format >> 5) & 3);
    const parity = this.format & LCR.parity ? 1 : 0;
    const stops = this.format & LCR.twoStops ? 2 : 1;
    return (1 + data + parity + stops) * this.bitNanos;
  }

  /**
   * A character's last stop bit has just ended on the receive line.
   *
   * @param {number} byte its data
   * @param {number} [errors] what is wrong with it, of {@link ERROR}
   * @returns {boolean} whether the UART was listening
   */
  receive(byte, errors = 0) {
    if (!(this.control & CR.enable && this.control & CR.rx && this.bitNanos)) return false;
    if (this.rx.length >= this.depth) {
      this.overrun = true;
      this.status |= 1 << 3;
      this.raw |= INT.overrun;
    } else {
      // An overrun is reported with the first character that found room again (TRM 2.4.3).
      this.rx.push(byte | errors | (this.overrun ? ERROR.overrun : 0));
      this.overrun = false;
      this.raw |= (errors >> 1) & (INT.framing | INT.parity | INT.break);
      if (this.rx.length === this.rxLevel) this.raw |= INT.rx;
    }
    this.silence.schedule(TIMEOUT_BITS * this.bitNanos);
    this.interrupt();
    return true;
  }

  /** Called by rp2040js when clk_peri changes; characters take the clock of their start. */
  clkPeriChanged() {
    this.pump();
    this.interrupt();
  }

  readUint32(offset) {
    switch (offset) {
      case REG.dr:
        return this.take();
      case REG.rsr:
        return this.status;
      case REG.fr:
        return this.flags;
      case REG.ibrd:
        return this.divisor.integer;
      case REG.fbrd:
        return this.divisor.fraction;
      case REG.lcrH:
        return this.format;
      case REG.cr:
        return this.control;
      case REG.ifls:
        return this.levels;
      case REG.imsc:
        return this.mask;
      case REG.ris:
        return this.raw;
      case REG.mis:
        return this.raw & this.mask;
      case REG.dmacr:
        return this.dmacr;
    }
    return super.readUint32(offset);
  }

  writeUint32(offset, value) {
    switch (offset) {
      case REG.dr:
        this.put(value & 0xff);
        break;
      case REG.rsr:
        this.status = 0;
        break;
      case REG.ibrd:
        this.divisor.integer = value & 0xffff;
        break;
      case REG.fbrd:
        this.divisor.fraction = value & 0x3f;
        break;
      case REG.lcrH:
        // The divisors take effect with this write (datasheet 4.2.7.1); changing FEN empties the FIFOs.
        if ((value ^ this.format) & LCR.fifo) [this.tx, this.rx] = [[], []];
        this.latched = this.divisor.integer * 64 + this.divisor.fraction;
        this.format = value & 0xff;
        break;
      case REG.cr:
        this.control = value & 0xffff;
        this.pump();
        break;
      case REG.ifls:
        this.levels = value & 0x3f;
        break;
      case REG.imsc:
        this.mask = value & 0x7ff;
        break;
      case REG.icr:
        this.raw &= ~this.rawWriteValue;
        break;
      case REG.dmacr:
        this.dmacr = value & 7;
        break;
      default:
        super.writeUint32(offset, value);
        return;
    }
    this.interrupt();
  }

  /** @private */
  get depth() {
    return this.format & LCR.fifo ? DEPTH : 1;
  }

  /** @private Received characters that raise the interrupt. */
  get rxLevel() {
    return this.format & LCR.fifo ? LEVELS[(this.levels >> 3) & 7] : 1;
  }

  /** @private Characters left to transmit that raise the interrupt. */
  get txLevel() {
    return this.format & LCR.fifo ? LEVELS[this.levels & 7] : 0;
  }

  /** @private */
  get flags() {
    return (
      (this.shifting || this.tx.length ? FR.busy : 0) |
      (this.rx.length ? 0 : FR.rxEmpty) |
      (this.rx.length >= this.depth ? FR.rxFull : 0) |
      (this.tx.length ? 0 : FR.txEmpty) |
      (this.tx.length >= this.depth ? FR.txFull : 0)
    );
  }

  /** @private */
  interrupt() {
    this.rp2040.setInterrupt(this.irq, Boolean(this.raw & this.mask));
  }

  /** @private */
  take() {
    const character = this.rx.shift() ?? 0;
    this.status = (this.status & ~7) | ((character >> 8) & 0xf);
    if (this.rx.length < this.rxLevel) this.raw &= ~INT.rx;
    if (!this.rx.length) {
      this.raw &= ~INT.timeout;
      this.silence.cancel();
    }
    this.interrupt();
    return character;
  }

  /** @private */
  put(byte) {
    if (this.tx.length >= this.depth) {
      this.error(`0x${byte.toString(16)} is lost: the transmit FIFO is full`);
      return;
    }
    this.tx.push(byte);
    if (this.tx.length > this.txLevel) this.raw &= ~INT.tx;
    this.pump();
  }

  /** @private Begins the next character if the line is free. */
  pump() {
    const canSend = this.control & CR.enable && this.control & CR.tx && this.bitNanos;
    if (this.shifting || !this.tx.length || !canSend) return;
    const byte = this.tx.shift();
    // The interrupt comes with the passing of the level, not with being below it (TRM 2.8.2).
    if (this.tx.length === this.txLevel) this.raw |= INT.tx;
    this.shifting = true;
    this.endOfCharacter.schedule(this.characterNanos);
    this.line.sent(byte);
  }

  /** @private */
  shifted() {
    this.shifting = false;
    this.pump();
    this.interrupt();
  }

  /** @private */
  timedOut() {
    if (!this.rx.length) return;
    this.raw |= INT.timeout;
    this.interrupt();
  }
}
