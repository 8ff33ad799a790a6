// The TIMER (RP2040 datasheet 4.6), in place of rp2040js's: that one fires early by the fraction of a microsecond
// which has passed when an alarm is written, and counts from the start of the emulator and not from reset.

import { BasePeripheral } from 'rp2040js';

const REG = { timehr: 0x08, timelr: 0x0c, alarm0: 0x10, alarm3: 0x1c, armed: 0x20, rawh: 0x24, rawl: 0x28 };
const INT = { raw: 0x34, enable: 0x38, force: 0x3c, status: 0x40 };

/** Counts microseconds since reset; its four alarms are interrupts 0 to 3. */
export class Timer extends BasePeripheral {
  constructor(rp2040) {
    super(rp2040, 'TIMER');
    this.clock = rp2040.clock;
    this.zero = this.clock.nanos;
    this.latchedHigh = 0;
    this.targets = [0, 0, 0, 0];
    this.armed = 0;
    this.raw = 0;
    this.enabled = 0;
    this.forced = 0;
    this.alarms = this.targets.map((_, index) => this.clock.createAlarm(() => this.fire(index)));
  }

  /** Whole microseconds since reset. */
  get micros() {
    return Math.floor((this.clock.nanos - this.zero) / 1000);
  }

  readUint32(offset) {
    switch (offset) {
      case REG.timelr:
        this.latchedHigh = Math.floor(this.micros / 2 ** 32);
        return this.micros >>> 0;
      case REG.timehr:
        return this.latchedHigh;
      case REG.rawl:
        return this.micros >>> 0;
      case REG.rawh:
        return Math.floor(this.micros / 2 ** 32);
      case REG.armed:
        return this.armed;
      case INT.raw:
        return this.raw;
      case INT.enable:
        return this.enabled;
      case INT.force:
        return this.forced;
      case INT.status:
        return (this.raw & this.enabled) | this.forced;
    }
    if (offset >= REG.alarm0 && offset <= REG.alarm3) return this.targets[(offset - REG.alarm0) / 4];
    return super.readUint32(offset);
  }

  writeUint32(offset, value) {
    if (offset >= REG.alarm0 && offset <= REG.alarm3) {
      this.arm((offset - REG.alarm0) / 4, value >>> 0);
      return;
    }
    switch (offset) {
      case REG.armed:
        this.disarm(this.rawWriteValue & this.armed);
        return;
      case INT.raw:
        this.raw &= ~this.rawWriteValue;
        break;
      case INT.enable:
        this.enabled = value & 0xf;
        break;
      case INT.force:
        this.forced = value & 0xf;
        break;
      default:
        super.writeUint32(offset, value);
        return;
    }
    this.interrupt();
  }

  /** @private An alarm fires when the counter comes to its value; one that is not ahead waits for the next round. */
  arm(index, target) {
    const round = 2 ** 32;
    const ahead = (target - (this.micros % round) + round) % round || round;
    this.targets[index] = target;
    this.armed |= 1 << index;
    this.alarms[index].schedule(this.zero + (this.micros + ahead) * 1000 - this.clock.nanos);
  }

  /** @private */
  disarm(mask) {
    this.armed &= ~mask;
    this.alarms.forEach((alarm, index) => mask & (1 << index) && alarm.cancel());
  }

  /** @private */
  fire(index) {
    this.armed &= ~(1 << index);
    this.raw |= 1 << index;
    this.interrupt();
  }

  /** @private */
  interrupt() {
    const status = (this.raw & this.enabled) | this.forced;
    for (let index = 0; index < 4; index++) this.rp2040.setInterrupt(index, Boolean(status & (1 << index)));
  }
}
