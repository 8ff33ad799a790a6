// The flash chip: a W25Q16JV, which takes its time.

/** Bytes of the whole chip. */
export const FLASH_SIZE = 2 * 1024 * 1024;
/** Bytes that an erase takes at least. */
export const SECTOR = 4096;
/** Bytes that one program operation takes at most. */
export const PAGE = 256;

/** Bytes of the blocks that can be erased at once. */
export const BLOCK = 65536;
/** Typical times in ns (W25Q16JV data sheet 9.6). */
const TIME = { sector: 45_000_000, block: 150_000_000, page: 400_000 };

/**
 * Erases and programs in virtual time, one sector, block or page after another. A byte of them is done when its
 * share of the time is over; when power fails, those bytes are done, the next one has only its upper half done, and
 * the others are untouched.
 */
export class Flash {
  /**
   * @param {object} clock the virtual clock
   * @param {(line: string) => void} say told what begins, e.g. `erase 0x1ff000`
   */
  constructor(clock, say) {
    this.clock = clock;
    this.say = say;
    this.bytes = new Uint8Array(FLASH_SIZE).fill(0xff);
    /** The number that every chip has of its own. */
    this.uniqueId = Uint8Array.of(0xe6, 0x61, 0xa4, 0xd4, 0x17, 0x2f, 0x8b, 0x2c);
    /** Called when the last operation is over. */
    this.onIdle = () => {};
    /** Called when power is to fail, after {@link cutAfter}. */
    this.onCut = () => {};
    this.alarm = clock.createAlarm(() => this.ended());
    this.lost();
  }

  /** Whether an operation is under way. */
  get busy() {
    return this.step !== null;
  }

  /**
   * Erases whole sectors.
   *
   * @param {number} from offset in bytes, a multiple of 4096
   * @param {number} count bytes, a multiple of 4096
   * @param {boolean} [byBlocks] whether 64 KiB blocks are erased at once where they fit
   */
  erase(from, count, byBlocks = false) {
    this.check('erase', from, count, SECTOR);
    for (let at = from; at < from + count; ) {
      const size = byBlocks && at % BLOCK === 0 && from + count - at >= BLOCK ? BLOCK : SECTOR;
      const line = size === SECTOR ? `erase ${hex(at)}` : `erase ${hex(at)} block`;
      const nanos = size === SECTOR ? TIME.sector : TIME.block;
      this.steps.push({ at, size, nanos, line, byte: () => 0xff });
      at += size;
    }
    this.next();
  }

  /**
   * Programs whole pages: clears bits, never sets them.
   *
   * @param {number} to offset in bytes, a multiple of 256
   * @param {Uint8Array} data a multiple of 256 bytes, read when their page's turn comes
   */
  program(to, data) {
    this.check('program', to, data.length, PAGE);
    for (let from = 0; from < data.length; from += PAGE) {
      const at = to + from;
      const line = `program ${hex(at)} ${PAGE}`;
      const byte = (old, index) => old & data[from + index];
      this.steps.push({ at, size: PAGE, nanos: TIME.page, line, byte });
    }
    this.next();
  }

  /**
   * Lets power fail when so many more bytes are done and the next one begins.
   *
   * @param {number} count bytes, of erases and programs together
   */
  cutAfter(count) {
    this.cut = count + (this.busy ? this.done() : 0);
    if (this.busy) this.scheduleEnd();
  }

  /** Power has failed: leaves the operation under way partly done, and forgets the rest. */
  powerFails() {
    if (this.busy) this.apply(this.done(), true);
    this.lost();
  }

  /** @private Forgets every operation. */
  lost() {
    this.steps = [];
    this.step = null;
    this.begun = 0;
    this.cut = Infinity;
    this.alarm.cancel();
  }

  /** @private */
  check(what, at, count, unit) {
    if (at % unit || count % unit || at + count > FLASH_SIZE) {
      throw new RangeError(`flash ${what} of ${count} bytes at ${hex(at)}: not whole units of ${unit} in the chip`);
    }
  }

  /** @private Begins the next step, if there is one. */
  next() {
    if (this.busy) return;
    this.step = this.steps.shift() ?? null;
    if (!this.step) return;
    this.begun = this.clock.nanos;
    this.say(this.step.line);
    this.scheduleEnd();
  }

  /** @private */
  scheduleEnd() {
    const { nanos, size } = this.step;
    const share = Math.min(this.cut / size, 1);
    this.alarm.schedule(Math.max(this.begun + nanos * share - this.clock.nanos, 0));
  }

  /** @private How many bytes of the present step are done. */
  done() {
    const { nanos, size } = this.step;
    return Math.min(Math.floor(((this.clock.nanos - this.begun) / nanos) * size + 1e-6), size);
  }

  /** @private */
  ended() {
    const { size } = this.step;
    if (this.cut < size) {
      this.onCut();
      return;
    }
    this.cut -= size;
    this.apply(size, false);
    this.step = null;
    this.next();
    if (!this.busy) this.onIdle();
  }

  /** @private */
  apply(count, half) {
    const { at, size, byte } = this.step;
    for (let index = 0; index < count; index++) this.bytes[at + index] = byte(this.bytes[at + index], index);
    if (half && count < size) {
      const old = this.bytes[at + count];
      this.bytes[at + count] = (byte(old, count) & 0xf0) | (old & 0x0f);
    }
  }
}

function hex(number) {
  return `0x${number.toString(16).padStart(6, '0')}`;
}
