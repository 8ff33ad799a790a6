// The USB controller as a device (RP2040 datasheet 4.1), in place of rp2040js's, which gives every buffer to the host as
// soon as it is AVAILABLE, knows no addresses, NAKs, stalls, packet numbers (DATA0, DATA1), suspension and times, and
// whose hosts see the second function of a device nowhere. Single buffers only; without the host's side of the controller,
// isochronous endpoints and remote wake-up.

import { BasePeripheral } from 'rp2040js';

const IRQ = 5;
const REG = {
  address: 0x00, main: 0x40, sofRead: 0x48, sie: 0x4c, status: 0x50, buffers: 0x58, abort: 0x60, aborted: 0x64,
  stallArm: 0x68, muxing: 0x74, power: 0x78, raw: 0x8c, enable: 0x90, force: 0x94, interrupts: 0x98,
};
const MAIN = { enable: 1 << 0, host: 1 << 1 };
const SIE = { pullUp: 1 << 16, interruptOf0: 1 << 29 };
/** Bits of SIE_STATUS. Those of events stay until they are written. */
const STATUS = {
  vbus: 1 << 0, suspended: 1 << 4, resume: 1 << 11, connected: 1 << 16, setup: 1 << 17, complete: 1 << 18,
  reset: 1 << 19, overflow: 1 << 26, ack: 1 << 30, sequence: 1 << 31,
};
const EVENTS = ~STATUS.vbus;
const MUXING = { toPhy: 1 << 0, softcon: 1 << 3 };
const POWER = { override: 1 << 2, detect: 1 << 3 };
const INT = { buffers: 1 << 4, reset: 1 << 12, suspend: 1 << 14, resume: 1 << 15, setup: 1 << 16, sof: 1 << 17 };

/** Offsets in the controller's memory: of the endpoints' control words, and of those of their buffers (4.1.2.5). */
const ENDPOINT_CONTROLS = 0x08;
const BUFFER_CONTROLS = 0x80;
const BUFFER_0 = 0x100;
const ENDPOINT = { enable: 1 << 31, interrupt: 1 << 29, offset: 0xffc0 };
const BUFFER = { full: 1 << 15, last: 1 << 14, data1: 1 << 13, stall: 1 << 11, available: 1 << 10, length: 0x3ff };

/** What the memory holds after a reset: nothing that an image could take for zeros. */
const NOISE = 0xa5;
/** ns of a cycle of clk_usb. */
const CYCLE = 1e9 / 48e6;
/** ns without a start of frame after which a device is suspended (USB 2.0, 7.1.7.6). */
const IDLE = 3_000_000;

/** The controller. Its cable is at {@link setup}, {@link input}, {@link output} and the events of the bus. */
export class UsbController extends BasePeripheral {
  /**
   * @param {object} rp2040 the chip: its `clock`, `setInterrupt`, `usbDPRAM` and clocks are used
   * @param {(what: string) => void} complain told of a use that would fail on the chip
   */
  constructor(rp2040, complain) {
    super(rp2040, 'USBCTRL');
    this.clock = rp2040.clock;
    this.memory = rp2040.usbDPRAMView;
    this.bytes = rp2040.usbDPRAM;
    this.complain = complain;
    this.address = 0;
    this.main = 0;
    this.sie = 0;
    this.status = 0;
    this.buffers = 0;
    this.abort = 0;
    this.aborted = 0;
    this.stallArm = 0;
    this.muxing = 0;
    this.power = 0;
    this.enabled = 0;
    this.forced = 0;
    this.frame = 0;
    this.sof = false;
    /** The endpoint in whose transaction the bus is, as a bit of the registers; 0 if there is none. */
    this.busy = 0;
    /** The control words of the buffers as the processor left them, and when it last changed more than AVAILABLE. */
    this.words = new Uint32Array(32);
    this.written = new Float64Array(32);
    this.bytes.fill(NOISE);
    this.words.fill(this.memory.getUint32(0, true));
    this.wasAttached = false;
    this.idle = this.clock.createAlarm(() => this.raise(STATUS.suspended));
  }

  /** Whether a computer at the other end of the cable sees a device. */
  get isAttached() {
    const needs = MUXING.toPhy | MUXING.softcon;
    return Boolean(
      this.main & MAIN.enable && this.sie & SIE.pullUp && (this.muxing & needs) === needs && this.status & STATUS.vbus,
    );
  }

  /**
   * A setup packet has arrived.
   *
   * @param {number} address of the device
   * @param {Uint8Array} packet 8 bytes
   * @returns {?string} `ack`; `null` if no device answers
   */
  setup(address, packet) {
    if (address !== this.address) return null;
    this.bytes.set(packet);
    // A setup packet ends a stall of endpoint 0 (4.1.2.6.1).
    this.stallArm = 0;
    this.raise(STATUS.setup);
    return 'ack';
  }

  /**
   * The computer asks for a packet (4.1.2.6.2).
   *
   * @param {number} address of the device
   * @param {number} endpoint its number
   * @returns {?string|{data: 0|1, bytes: Uint8Array, end: (whole: boolean) => void}} `nak`, `stall`, or the packet; `end`
   *   is to be called when the transaction is over, with whether the packet has come and was acknowledged; `null` if no
   *   device answers
   */
  input(address, endpoint) {
    const place = this.begin(address, endpoint, 0);
    if (place === null) return null;
    const { word, bit, at, control } = place;
    if (word & BUFFER.stall && (endpoint || this.stallArm & 1)) return 'stall';
    if (this.abort & bit || !(word & BUFFER.available && word & BUFFER.full)) return 'nak';
    this.busy = bit;
    const length = word & BUFFER.length;
    return {
      data: word & BUFFER.data1 ? 1 : 0,
      bytes: this.bytes.slice(at, at + length),
      end: (whole) => {
        if (whole) this.end(bit, control, word & ~(BUFFER.available | BUFFER.full), STATUS.ack);
        else this.end(bit, control, null, 0);
      },
    };
  }

  /**
   * The computer sends a packet (4.1.2.6.3).
   *
   * @param {number} address of the device
   * @param {number} endpoint its number
   * @param {0|1} data the packet's number
   * @param {Uint8Array} bytes what is in it
   * @returns {?string|{end: (whole: boolean) => ?string}} `nak`, `stall`, or a function to be called when the transaction
   *   is over, with whether the packet has come; it returns `ack`, or `null` if the packet is too long; `null` if no device
   *   answers
   */
  output(address, endpoint, data, bytes) {
    const place = this.begin(address, endpoint, 1);
    if (place === null) return null;
    const { word, bit, at, control } = place;
    if (word & BUFFER.stall && (endpoint || this.stallArm & 2)) return 'stall';
    if (this.abort & bit || !(word & BUFFER.available) || word & BUFFER.full) return 'nak';
    this.busy = bit;
    const end = (whole) => {
      const fits = bytes.length <= (word & BUFFER.length);
      if (!whole || !fits) {
        this.end(bit, control, null, fits ? 0 : STATUS.overflow);
        return null;
      }
      if (data !== (word & BUFFER.data1 ? 1 : 0)) {
        // As if its acknowledgement had been lost: it is acknowledged again and dropped (USB 2.0, 8.6.4).
        this.end(bit, control, null, STATUS.sequence);
        return 'ack';
      }
      this.bytes.set(bytes, at);
      const left = word & ~(BUFFER.available | BUFFER.length);
      this.end(bit, control, left | BUFFER.full | bytes.length, STATUS.ack);
      return 'ack';
    };
    return { end };
  }

  /** A frame of 1 ms begins on the bus. */
  startOfFrame(number) {
    this.frame = number;
    this.sof = true;
    this.idle.schedule(IDLE);
    if (this.enabled & INT.sof) this.interrupt();
  }

  /** The computer begins to reset the device. */
  reset() {
    this.idle.cancel();
    this.raise(STATUS.reset);
  }

  /** The computer wakes the device. */
  resume() {
    this.idle.cancel();
    this.raise(STATUS.resume);
  }

  readUint32(offset) {
    switch (offset) {
      case REG.address:
        return this.address;
      case REG.main:
        return this.main;
      case REG.sofRead:
        this.sof = false;
        this.interrupt();
        return this.frame;
      case REG.sie:
        return this.sie;
      case REG.status:
        return this.status;
      case REG.buffers:
        return this.buffers;
      case REG.abort:
        return this.abort;
      case REG.aborted:
        return this.aborted;
      case REG.stallArm:
        return this.stallArm;
      case REG.muxing:
        return this.muxing;
      case REG.power:
        return this.power;
      case REG.raw:
        return this.raw;
      case REG.enable:
        return this.enabled;
      case REG.force:
        return this.forced;
      case REG.interrupts:
        return (this.raw & this.enabled) | this.forced;
    }
    return super.readUint32(offset);
  }

  writeUint32(offset, value) {
    switch (offset) {
      case REG.address:
        this.address = value & 0x7f;
        break;
      case REG.main:
        if (value & MAIN.host) this.warn('the controller is no host here');
        if (value & MAIN.enable) this.checkClock();
        this.main = value;
        break;
      case REG.sie:
        this.sie = value;
        break;
      case REG.status:
        this.status &= ~(this.rawWriteValue & EVENTS);
        break;
      case REG.buffers:
        this.buffers &= ~this.rawWriteValue;
        break;
      case REG.abort:
        this.abort = value;
        this.aborted |= value & ~this.busy;
        break;
      case REG.aborted:
        this.aborted &= ~this.rawWriteValue;
        break;
      case REG.stallArm:
        this.stallArm = value & 3;
        break;
      case REG.muxing:
        this.muxing = value;
        break;
      case REG.power:
        this.power = value;
        // The Pico has VBUS on no pin of the controller: only the override tells it.
        if (value & POWER.override && value & POWER.detect) this.status |= STATUS.vbus;
        else this.status &= ~STATUS.vbus;
        break;
      case REG.enable:
        this.enabled = value;
        break;
      case REG.force:
        this.forced = value;
        break;
      default:
        super.writeUint32(offset, value);
        return;
    }
    // A pull-up that nobody sees is a bus without frames.
    if (this.isAttached && !this.idle.scheduled && !this.wasAttached) this.idle.schedule(IDLE);
    this.wasAttached = this.isAttached;
    this.interrupt();
  }

  /**
   * The processor has written a word of the controller's memory. AVAILABLE is to be written after the other bits, when
   * the controller, with its slower clock, has seen those (4.1.2.5.1).
   */
  DPRAMUpdated(offset, value) {
    if (offset < BUFFER_CONTROLS || offset >= BUFFER_0) return;
    const index = (offset - BUFFER_CONTROLS) >> 2;
    const rest = (value ^ this.words[index]) & ~BUFFER.available;
    const now = this.clock.nanos;
    const isEarly = rest || now - this.written[index] < CYCLE;
    if (value & BUFFER.available && isEarly) {
      this.complain(`AVAILABLE too early after the other bits of a buffer's control word: ${hex(value)}`);
    }
    if (rest) this.written[index] = now;
    this.words[index] = value;
  }

  /** @private */
  get raw() {
    const { status } = this;
    return (
      (this.buffers ? INT.buffers : 0) |
      (status & STATUS.reset ? INT.reset : 0) |
      (status & STATUS.suspended ? INT.suspend : 0) |
      (status & STATUS.resume ? INT.resume : 0) |
      (status & STATUS.setup ? INT.setup : 0) |
      (this.sof ? INT.sof : 0)
    );
  }

  /** @private What belongs to an endpoint that a token names; `null` if there is none. */
  begin(address, endpoint, out) {
    if (address !== this.address) return null;
    const index = 2 * endpoint + out;
    const control = endpoint ? this.memory.getUint32(ENDPOINT_CONTROLS + 4 * (index - 2), true) : 0;
    if (endpoint && !(control & ENDPOINT.enable)) return null;
    return {
      control: { index, interrupts: endpoint ? control & ENDPOINT.interrupt : this.sie & SIE.interruptOf0 },
      word: this.memory.getUint32(BUFFER_CONTROLS + 4 * index, true),
      bit: 1 << index,
      at: endpoint ? control & ENDPOINT.offset : BUFFER_0,
    };
  }

  /** @private A transaction is over; `word` is what it leaves as the buffer's control word, `null` if what was there. */
  end(bit, { index, interrupts }, word, status) {
    this.busy = 0;
    this.aborted |= this.abort & bit;
    if (word !== null) {
      this.memory.setUint32(BUFFER_CONTROLS + 4 * index, word, true);
      this.words[index] = word;
      if (interrupts) this.buffers |= bit;
      if (word & BUFFER.last) status |= STATUS.complete;
    }
    this.raise(status);
  }

  /** @private */
  raise(status) {
    this.status |= status;
    this.interrupt();
  }

  /** @private */
  interrupt() {
    this.rp2040.setInterrupt(IRQ, Boolean((this.raw & this.enabled) | this.forced));
  }

  /** @private */
  checkClock() {
    const { clocks, pllUsb } = this.rp2040;
    const { usbCtrl, usbDiv } = clocks;
    const isOn = usbCtrl & (1 << 11) && !(usbCtrl & (7 << 5)) && usbDiv === 0x100;
    if (!isOn || pllUsb.frequency !== 48e6) this.complain('clk_usb is not 48 MHz from PLL_USB');
  }
}

function hex(number) {
  return `0x${(number >>> 0).toString(16)}`;
}
