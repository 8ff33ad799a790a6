// A Raspberry Pi Pico in virtual time.

import { readFileSync } from 'node:fs';

import { Chip } from './chip.mjs';
import { Clock } from './clock.mjs';
import { ENTRY_CYCLES, awakes } from './core.mjs';
import { loadElf } from './elf.mjs';
import { Flash, SECTOR } from './flash.mjs';
import { Stats } from './stats.mjs';
import { isUf2, loadUf2 } from './uf2.mjs';
import { UsbHost } from './usb.mjs';

/** Address of the flash. */
const FLASH = 0x10000000;
/** What RAM holds after power-on: nothing that an image could take for zeros. */
const NOISE = 0xa5;

/** A board: the chip, its flash, its pins, the line of UART0, and a computer at its USB cable. Time stands still between calls of {@link run}. */
export class Pico {
  /**
   * @param {object} [tell]
   * @param {(line: string) => void} [tell.say] told what the board does: `pin 3 high`, `flash erase 0x1ff000`, `reset
   *   watchdog`, `boot loader 02000000`, `error …`; `clock.nanos` says when
   * @param {(byte: number) => void} [tell.sent] told each character at the instant at which its start bit begins
   * @param {(port: string, bytes: Uint8Array) => void} [tell.received] told each packet of a port of the USB cable
   */
  constructor({ say = () => {}, sent = () => {}, received = () => {} } = {}) {
    this.say = say;
    this.sent = sent;
    this.clock = new Clock();
    this.stats = new Stats();
    /** Whether to look for the marks of {@link Stats.look}; costs a sixth of the speed. */
    this.looksForMarks = false;
    this.flash = new Flash(this.clock, (line) => say(`flash ${line}`));
    this.flash.onCut = () => this.powerOff();
    this.flash.onIdle = () => this.flashIsIdle();
    /** The computer at the other end of the USB cable; not connected at first. */
    this.usb = new UsbHost(this, { say: (line) => say(`usb ${line}`), received });
    /** Pins that the world drives: number to level. */
    this.driven = new Map();
    /** @type {?Chip} */
    this.chip = null;
  }

  /** Puts an ELF file or a UF2 into flash. */
  load(path) {
    const file = readFileSync(path);
    if (isUf2(file)) loadUf2(file, this.flash.bytes, FLASH, SECTOR);
    else loadElf(path, this.flash.bytes);
  }

  /** Turns power on: the image starts, and RAM has lost everything. Does nothing if power is on. */
  powerOn() {
    if (this.chip) return;
    this.chip = new Chip(this);
    this.chip.sram.fill(NOISE);
    this.stats.restart();
  }

  /** Turns power off; the flash is left as it is in this instant, a page or a sector under way partly done. */
  powerOff() {
    if (!this.chip) return;
    this.say('power off');
    this.chip.turnOff();
    this.chip = null;
    this.flash.powerFails();
  }

  /** Resets the chip; RAM and flash keep what they hold, and the flash goes on with what it does. */
  reset(cause) {
    this.say(`reset ${cause}`);
    const before = this.chip;
    before.turnOff();
    this.chip = new Chip(this);
    this.chip.sram.set(before.sram);
    this.chip.watchdog.scratchData.set(before.watchdog.scratchData);
    this.chip.watchdog.reason = cause === 'watchdog' ? before.watchdog.reason : 0;
    this.stats.restart();
  }

  /** Starts the boot loader of the ROM, which waits for ever: there is no USB. */
  startBootLoader(light) {
    this.say(`boot loader ${light.toString(16).padStart(8, '0')}`);
    this.chip.turnOff();
    this.chip = new Chip(this);
    this.chip.hung = true;
    this.stats.restart();
  }

  /** Says what a word of the memory holds. */
  peek(address) {
    const hex = (word) => word.toString(16).padStart(8, '0');
    if (this.chip) this.say(`peek ${hex(address)} ${hex(this.chip.readUint32(address))}`);
  }

  /** Makes the CPU loop for ever with interrupts off. */
  hang() {
    if (this.chip) this.chip.hung = true;
  }

  /**
   * The world drives a pin, or lets go of it.
   *
   * @param {number} number 0 to 29
   * @param {?boolean} level high or low; `null` lets the pin float
   */
  drive(number, level) {
    if (level === null) this.driven.delete(number);
    else this.driven.set(number, level);
    this.chip?.pins.changed(number);
  }

  /**
   * The last stop bit of a character has just ended on UART0's receive line.
   *
   * @param {number} byte its data
   * @param {number} [errors] of `ERROR` in uart.mjs
   */
  receive(byte, errors = 0) {
    const heard = this.chip?.pins.receives && this.chip.uart[0].receive(byte, errors);
    if (!heard) this.say(`unheard ${byte.toString(16).padStart(2, '0')}`);
  }

  /** ns of a character on UART0's line in its present format and rate; 0 if there is none. */
  get characterNanos() {
    return this.chip?.uart[0].characterNanos ?? 0;
  }

  /**
   * Lets the board run until an instant, or to the end of the instruction in which it falls.
   *
   * @param {number} until ns since the first power-on
   */
  run(until) {
    const { clock, stats, looksForMarks } = this;
    while (clock.nanos < until) {
      const { chip } = this;
      if (!chip || chip.hung) {
        clock.advanceTo(Math.min(clock.next, until));
        continue;
      }
      const { core } = chip;
      if (core.waiting) {
        if (awakes(core, chip.waitsForFlash)) core.waiting = false;
        else {
          clock.advanceTo(Math.min(clock.next, until));
          continue;
        }
      }
      if (core.interruptsUpdated && core.checkForInterrupts()) this.spend(ENTRY_CYCLES);
      const { registers } = core;
      while (clock.nanos < until && !core.waiting && !core.interruptsUpdated && !chip.hung && this.chip === chip) {
        if (looksForMarks) stats.look(chip.readUint16(registers[15]));
        const cycles = core.executeInstruction();
        stats.instructions++;
        if (registers[13] < stats.lowestSp) stats.lowestSp = registers[13];
        stats.cycles += cycles;
        const now = clock.nanos + cycles * chip.cycleNanos;
        if (now >= clock.next) clock.advanceTo(now);
        else clock.nanos = now;
      }
    }
  }

  /** @private */
  spend(cycles) {
    this.stats.cycles += cycles;
    this.clock.advanceTo(this.clock.nanos + cycles * this.chip.cycleNanos);
  }

  /** @private */
  flashIsIdle() {
    if (this.chip?.waitsForFlash) this.chip.core.waiting = this.chip.waitsForFlash = false;
  }
}
