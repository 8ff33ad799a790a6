// What rp2040js 1.4.1 gets wrong of the Cortex-M0+, put right on its core. Nothing else of it is changed here.

const HARD_FAULT = 3;
const MSP = 8;
const NVIC_ICPR = 0x280;
const AIRCR = 0xd0c;
const SYSRESETREQ = 0x05fa0004;
const LOWEST = 4;

/** Cycles from the end of an instruction to the first one of an interrupt's handler (Cortex-M0+ TRM 3.6.1). */
export const ENTRY_CYCLES = 15;

/**
 * Corrects the core of a chip.
 *
 * - WFI with PRIMASK set wakes on a pending interrupt and does not take it; here it took it, and slept through one
 *   that was pending before. {@link awakes} says when the core wakes.
 * - An interrupt stays pending when its line falls before it is taken, one set pending by software is taken once,
 *   and ICPR clears either; here pending was the state of the line.
 * - Bit 0 of a vector is not part of the handler's address; here it was, and a jump table in a handler was read one
 *   byte off.
 * - SBCS and ADCS set V wrongly where the operand is 0x7FFFFFFF and the carry makes it 0x80000000.
 * - BKPT and UDF are hard faults; AIRCR resets; here they did nothing.
 *
 * @param {object} chip the emulated RP2040
 * @param {{entered: (exception: number) => void, left: () => void, faulted: (address: number) => void,
 *   stacked: () => void, reset: () => void}} on called when an exception is entered and left, at a hard fault, when
 *   the main stack pointer is set, and when software asks for a reset
 */
export function correctCore(chip, on) {
  const { core } = chip;
  correctInterrupts(core, chip.ppb, on);
  correctOverflow(core);

  const { writeSpecialRegister } = core;
  core.writeSpecialRegister = function (register, value) {
    writeSpecialRegister.call(this, register, value);
    if (register === MSP) on.stacked();
  };
  const { writeUint32 } = chip.ppb;
  chip.ppb.writeUint32 = function (offset, value) {
    if (offset === NVIC_ICPR) core.pendingInterrupts &= ~value | core.lines;
    else if (offset === AIRCR) {
      if (value >>> 0 === SYSRESETREQ) on.reset();
    } else writeUint32.call(this, offset, value);
  };
  core.hardFault = function () {
    // rp2040js has stepped over the first half of the instruction and will step over the second after this.
    const address = this.PC - 2;
    on.faulted(address);
    this.PC = address;
    this.exceptionEntry(HARD_FAULT);
    if (this.breakRewind === 4) this.PC -= 2;
  };
}

/**
 * Whether a sleeping core wakes.
 *
 * @param {object} core a corrected core
 * @param {boolean} toServe whether only an interrupt counts that is served at once, as for the ROM's wait; WFI wakes
 *   for one that PRIMASK holds back, too
 */
export function awakes(core, toServe) {
  const limit = core.exceptionPriority(core.IPSR);
  return core.pendingBelow(toServe && core.PM ? Math.min(limit, 0) : limit) !== 0;
}

function correctInterrupts(core, ppb, on) {
  core.lines = 0;
  core.setInterrupt = function (irq, isHigh) {
    const bit = 1 << irq;
    if (!isHigh) this.lines &= ~bit;
    else if (!(this.lines & bit)) {
      this.lines |= bit;
      this.pendingInterrupts |= bit;
      this.interruptsUpdated = true;
    }
  };
  core.pendingBelow = function (limit) {
    const ready = this.pendingInterrupts & this.enabledInterrupts;
    if (!(ready || this.pendingSVCall || this.pendingPendSV || this.pendingSystick)) return 0;
    for (let priority = 0; priority < Math.min(limit, LOWEST); priority++) {
      if (this.pendingSVCall && priority === this.svCallPriority) return 11;
      if (this.pendingPendSV && priority === this.pendSVPriority) return 14;
      if (this.pendingSystick && priority === this.systickPriority) return 15;
      const level = ready & this.interruptPriorities[priority];
      if (level) return 16 + 31 - Math.clz32(level & -level);
    }
    return 0;
  };
  core.checkForInterrupts = function () {
    const limit = this.exceptionPriority(this.IPSR);
    const exception = this.pendingBelow(this.PM ? Math.min(limit, 0) : limit);
    if (!exception) {
      this.interruptsUpdated = false;
      return false;
    }
    if (exception === 11) this.pendingSVCall = false;
    else if (exception === 14) this.pendingPendSV = false;
    else if (exception === 15) this.pendingSystick = false;
    else this.pendingInterrupts &= ~(1 << (exception - 16));
    this.exceptionEntry(exception);
    return true;
  };

  const { exceptionEntry, exceptionReturn } = core;
  core.exceptionEntry = function (exception) {
    exceptionEntry.call(this, exception);
    this.PC &= ~1;
    on.entered(exception);
  };
  core.exceptionReturn = function (value) {
    if (this.IPSR >= 16) this.pendingInterrupts |= this.lines & (1 << (this.IPSR - 16));
    on.left();
    exceptionReturn.call(this, value);
  };
}

function correctOverflow(core) {
  const MOST = 0x7fffffff;
  // The operands as rp2040js passes them: with the carry added, so that only the instruction tells the two apart.
  // Its PC is odd from the beginning of a handler to the next branch.
  const carried = (opcode) => {
    const instruction = core.readUint16((core.PC & ~1) - 2);
    return instruction >> 6 === opcode ? instruction : undefined;
  };
  const { substractUpdateFlags, addUpdateFlags } = core;
  core.substractUpdateFlags = function (minuend, subtrahend) {
    const result = substractUpdateFlags.call(this, minuend, subtrahend);
    if (subtrahend === MOST + 1) {
      const sbcs = carried(0b0100000110);
      if (sbcs !== undefined && this.registers[(sbcs >> 3) & 7] === MOST) this.V = (minuend | 0) < 0;
    }
    return result;
  };
  core.addUpdateFlags = function (first, second) {
    const result = addUpdateFlags.call(this, first, second);
    if (second === MOST + 1) {
      const adcs = carried(0b0100000101);
      if (adcs !== undefined && this.registers[adcs & 7] === MOST) this.V = (first | 0) >= 0;
    }
    return result;
  };
}
