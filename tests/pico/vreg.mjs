// The voltage regulator of the core (RP2040 datasheet 2.10.6), which the system clock depends on (2.15.3).

import { BasePeripheral } from 'rp2040js';

const VREG = 0x0;
/** Output of the regulator, bits 7:4. After power-on it is 1.10 V. */
const AFTER_POWER_ON = 0xb1;
const V_1_15 = 12;
const REGULATED = 1 << 12;
/** Greatest frequency at 1.10 V and at 1.15 V, in Hz. */
const [MOST, MOST_AT_1_15_V] = [133e6, 200e6];

/** Registers of the regulator. */
export class Regulator extends BasePeripheral {
  constructor(rp2040) {
    super(rp2040, 'VREG');
    this.vreg = AFTER_POWER_ON;
  }

  /** The greatest frequency of the system clock now, in Hz. */
  get mostHz() {
    return ((this.vreg >> 4) & 0xf) >= V_1_15 ? MOST_AT_1_15_V : MOST;
  }

  readUint32(offset) {
    return offset === VREG ? this.vreg | REGULATED : super.readUint32(offset);
  }

  writeUint32(offset, value) {
    if (offset === VREG) this.vreg = value;
    else super.writeUint32(offset, value);
  }
}
