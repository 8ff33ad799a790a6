// One RP2040 between two resets: rp2040js with our ROM, flash, UART0, TIMER, USB and the corrections of its
// core.

import { RP2040 } from 'rp2040js';

import { ChipClock } from './clock.mjs';
import { correctCore } from './core.mjs';
import { BLOCK, FLASH_SIZE } from './flash.mjs';
import { guard } from './guards.mjs';
import { Pins } from './pins.mjs';
import { connectFlash } from './qspi.mjs';
import { CALL, ROM, bits, isValidBoot2 } from './rom.mjs';
import { Timer } from './timer.mjs';
import { Pl011 } from './uart.mjs';
import { Regulator } from './vreg.mjs';
import { UsbController } from './usbctrl.mjs';

const RAM = 0x20000000;
const RAM_SIZE = 264 * 1024;
const UART0_IRQ = 20;
const SSI_ENABLE = 0x08;
/** SYSINFO's CHIP_ID (2.20.2): revision B2, which is sold today. rp2040js is a B1. */
const CHIP_ID = 0x20002927;
/** The processor's bit in PSM.WDSEL: without it a watchdog resets nothing. */
const PROC0 = 1 << 16;

/** A chip that has just come out of reset. */
export class Chip extends RP2040 {
  /**
   * @param {object} board what the chip is soldered to
   * @param {import('./clock.mjs').Clock} board.clock the time of the world
   * @param {import('./flash.mjs').Flash} board.flash the flash chip
   * @param {Map<number, boolean>} board.driven the pins that the world drives
   * @param {import('./stats.mjs').Stats} board.stats counts what is executed
   * @param {(line: string) => void} board.say told what happens
   * @param {(byte: number) => void} board.sent told each character at its start bit
   * @param {(cause: string) => void} board.reset asked to reset the chip
   * @param {(light: number) => void} board.startBootLoader asked to start the ROM's boot loader, with a light's pin as a bit
   */
  constructor(board) {
    super(new ChipClock(board.clock));
    const { stats, say } = board;
    this.board = board;
    this.ram16 = new Uint16Array(this.sram.buffer);
    this.ram32 = new Uint32Array(this.sram.buffer);
    this.flash = board.flash.bytes;
    this.flash16 = new Uint16Array(this.flash.buffer, this.flash.byteOffset, FLASH_SIZE / 2);
    this.flashView = new DataView(this.flash.buffer, this.flash.byteOffset, FLASH_SIZE);
    this.bootrom.set(ROM);
    /** Whether reads of the flash window reach the flash. */
    this.xip = true;
    /** Whether the CPU has stopped for good. */
    this.hung = false;
    /** Whether the core sleeps in the ROM's wait for the flash. */
    this.waitsForFlash = false;

    const warned = new Set();
    const warn = (part, text) => {
      if (!warned.has(part + text)) say(`warning ${part}: ${text}`);
      warned.add(part + text);
    };
    this.logger = { debug() {}, info() {}, warn, error: warn };

    correctCore(this, {
      entered: (exception) => stats.entered(exception),
      left: () => stats.left(),
      faulted: (address) => {
        if (this.core.IPSR === 3) this.hung = true;
        else say(`error hard fault at ${hex(address)}`);
      },
      stacked: () => stats.stacked(this.core.SP),
      reset: () => board.reset('request'),
    });
    this.onBreak = (code) => (this.core.PC < this.bootrom.byteLength ? this.call(code) : this.core.hardFault());

    this.pins = new Pins(this, board.driven, say);
    this.peripherals[0x40054] = new Timer(this);
    const line = {
      clockHz: () => this.clocks.periFreq,
      sent: (byte) => this.pins.transmits && board.sent(byte),
    };
    this.uart[0] = this.peripherals[0x40034] = new Pl011(this, UART0_IRQ, line);
    const ssi = this.peripherals[0x18000];
    const { writeUint32 } = ssi;
    ssi.writeUint32 = (offset, value) => {
      if (offset === SSI_ENABLE) this.xip = Boolean(value & 1);
      writeUint32.call(ssi, offset, value);
    };
    const inProgram = (what) => this.hung || this.stop(`${what} at ${hex(this.core.PC)}`);
    this.flashPins = connectFlash(this, board.flash, inProgram);
    this.usbCtrl = this.peripherals[0x50110] = new UsbController(this, inProgram);
    const sysinfo = this.peripherals[0x40000];
    const { readUint32: readInfo } = sysinfo;
    sysinfo.readUint32 = (offset) => (offset ? readInfo.call(sysinfo, offset) : CHIP_ID);
    const regulator = (this.peripherals[0x40064] = new Regulator(this));
    this.watchdog = this.peripherals[0x40058];
    this.watchdog.onWatchdogTrigger = () => {
      if (this.peripherals[0x40010].wdsel & PROC0) board.reset('watchdog');
      else this.stop('the watchdog resets nothing: PSM.WDSEL does not name the processor');
      // rp2040js would call again at once.
      this.watchdog.alarm.enable = false;
    };

    guard(this, (what, address) => this.complain(what, address));

    // The ring oscillator until the image chooses otherwise; time per cycle follows.
    this.clkSys = this.clocks.sysFreq;
    this.cycleNanos = 1e9 / this.clkSys;
    this.addClockListener((hz) => {
      if (hz > regulator.mostHz) inProgram(`the core has too low a voltage for ${hz / 1e6} MHz`);
      this.cycleNanos = 1e9 / hz;
      // Whole ns again, so that 8 ns cycles stay exact.
      board.clock.advanceTo(Math.ceil(board.clock.nanos));
    });
    this.core.VTOR = 0;
    this.core.reset();
  }

  /** The chip is gone: nothing of it happens any more. */
  turnOff() {
    this.clock.isOn = false;
  }

  readUint32(address) {
    address >>>= 0;
    const ram = address - RAM;
    if (ram >= 0 && ram < RAM_SIZE) {
      if (address & 3) this.complain('unaligned read', address);
      return this.ram32[ram >> 2];
    }
    if (address >>> 26 === 4) {
      return this.inFlash(address) ? this.flashView.getUint32(address & (FLASH_SIZE - 4), true) : 0;
    }
    return super.readUint32(address);
  }

  readUint16(address) {
    address >>>= 0;
    const ram = address - RAM;
    if (ram >= 0 && ram < RAM_SIZE) {
      if (address & 1) this.complain('unaligned read', address);
      return this.ram16[ram >> 1];
    }
    if (address >>> 26 === 4) return this.inFlash(address) ? this.flash16[(address & (FLASH_SIZE - 1)) >> 1] : 0;
    return super.readUint16(address);
  }

  readUint8(address) {
    address >>>= 0;
    const ram = address - RAM;
    if (ram >= 0 && ram < RAM_SIZE) return this.sram[ram];
    if (address >>> 26 === 4) return this.inFlash(address) ? this.flash[address & (FLASH_SIZE - 1)] : 0;
    return super.readUint8(address);
  }

  writeUint32(address, value) {
    address >>>= 0;
    const ram = address - RAM;
    if (ram >= 0 && ram < RAM_SIZE) {
      if (address & 3) this.complain('unaligned write', address);
      this.ram32[ram >> 2] = value;
    } else if (this.isWritable(address)) super.writeUint32(address, value);
  }

  writeUint16(address, value) {
    if (this.isWritable(address >>> 0)) super.writeUint16(address >>> 0, value);
  }

  writeUint8(address, value) {
    if (this.isWritable(address >>> 0)) super.writeUint8(address >>> 0, value);
  }

  /** @private Whether a read of the flash window can be answered. */
  inFlash(address) {
    if (this.xip && !this.board.flash.busy) return true;
    this.complain(`read while ${this.board.flash.busy ? 'the flash is busy' : 'the flash window is closed'}`, address);
    return false;
  }

  /** @private */
  isWritable(address) {
    const isMemory = address < 0x10000 || address >>> 26 === 4;
    if (isMemory) this.complain('write to read-only memory', address);
    return !isMemory;
  }

  /** @private An access that would fault on the chip, or read nonsense: the CPU stops. */
  complain(what, address) {
    if (!this.hung) this.stop(`${what}: ${hex(address)} at ${hex(this.core.PC)}`);
  }

  /** @private What the ROM asks for. */
  call(code) {
    const { core, board } = this;
    const [r0, r1, r2] = core.registers;
    switch (code) {
      case CALL.boot:
        if (!isValidBoot2(this.flash)) this.stop('the second stage in flash has a wrong checksum');
        return;
      case CALL.missing:
        this.stop(`there is no ROM function '${String.fromCharCode(r1 & 0xff, r1 >> 8)}' here`);
        return;
      case CALL.exitXip:
        this.xip = false;
        return;
      case CALL.enterXip:
        this.flashPins.release();
        this.xip = true;
        return;
      case CALL.erase:
        this.operate(() => board.flash.erase(r0, r1, r2 === BLOCK));
        return;
      case CALL.program:
        this.operate(() => {
          const from = r1 - RAM;
          if (from < 0 || from + r2 > RAM_SIZE) throw new RangeError(`flash program from ${hex(r1)}: not in RAM`);
          board.flash.program(r0, this.sram.subarray(from, from + r2));
        });
        return;
      case CALL.bootLoader:
        board.startBootLoader(r0);
        return;
      case CALL.wait:
        this.waitsForFlash = core.waiting = board.flash.busy;
        if (core.waiting) core.PC -= 2;
        return;
      default:
        core.registers[0] = bits(code - CALL.bits, r0);
    }
  }

  /** @private */
  operate(operation) {
    if (this.xip) {
      this.stop('flash operation without flash_exit_xip');
      return;
    }
    try {
      operation();
    } catch (error) {
      if (!(error instanceof RangeError)) throw error;
      this.stop(error.message);
    }
  }

  /** @private */
  stop(why) {
    this.board.say(`error ${why}`);
    this.hung = true;
  }
}

function hex(number) {
  return `0x${(number >>> 0).toString(16).padStart(8, '0')}`;
}
