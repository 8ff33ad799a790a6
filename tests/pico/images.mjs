// Tiny images for the tests.

import { boot2Checksum } from './rom.mjs';
import { assemble } from './thumb.mjs';

const BOOT2 = assemble(`
        ldr     r0, =0x10000100
        ldr     r1, =0xe000ed08
        str     r0, [r1]
        ldmia   r0!, {r0, r1}
        msr     msp, r0
        bx      r1
`, 0x20041f00).bytes;

/** Where the stack of an image begins. */
export const STACK_TOP = 0x20040000;

/**
 * An image: a second stage that starts what follows it, and a program which runs from flash.
 *
 * @param {string} source the program, see thumb.mjs; begins at its label `main`, and its labels `irq0` … `irq25` are
 *   handlers of interrupts
 * @returns {(board: object) => void} puts it into the flash of a board
 */
export function image(source) {
  const program = assemble(source, 0x10000200);
  const stage = new Uint8Array(256);
  stage.set(BOOT2);
  new DataView(stage.buffer).setUint32(252, boot2Checksum(stage), true);
  const vectors = new Uint32Array(48);
  vectors[0] = STACK_TOP;
  vectors[1] = program.labels.main | 1;
  for (let irq = 0; irq < 26; irq++) vectors[16 + irq] = (program.labels[`irq${irq}`] ?? 0) | 1;
  if ('hardfault' in program.labels) vectors[3] = program.labels.hardfault | 1;
  return (board) => {
    board.flash.bytes.set(stage, 0);
    board.flash.bytes.set(new Uint8Array(vectors.buffer), 0x100);
    board.flash.bytes.set(program.bytes, 0x200);
  };
}

/**
 * Statements that take everything out of reset and make clk_sys and clk_peri 125 MHz, so that a cycle takes 8 ns,
 * and TIMER count microseconds; clobber r0 and r1.
 */
export const AT_125_MHZ = `
        ldr     r1, =0x4000c000         ; RESETS
        movs    r0, #0
        str     r0, [r1]
        ldr     r1, =0x40028000         ; PLL_SYS: 12 MHz * 125 / 6 / 2
        movs    r0, #125
        str     r0, [r1, #8]
        ldr     r0, =0x00062000
        str     r0, [r1, #12]
        ldr     r1, =0x40008000         ; CLOCKS
        movs    r0, #2
        str     r0, [r1, #0x30]         ; clk_ref from the crystal
        movs    r0, #1
        str     r0, [r1, #0x3c]         ; clk_sys from PLL_SYS
        ldr     r0, =0x800
        str     r0, [r1, #0x48]         ; clk_peri from clk_sys
        ldr     r1, =0x40058000         ; WATCHDOG: a tick every 12 cycles of clk_ref
        ldr     r0, =0x20c
        str     r0, [r1, #0x2c]
`;

/** Statements that set GP0 and GP1 up for UART0 and enable it; clobbers r0 and r1. */
export const uart = (lcrH, integer, fraction) => `
        ldr     r1, =0x40014000
        movs    r0, #2
        str     r0, [r1, #4]
        str     r0, [r1, #12]
        ldr     r1, =0x40034000
        ldr     r0, =${integer}
        str     r0, [r1, #0x24]
        movs    r0, #${fraction}
        str     r0, [r1, #0x28]
        movs    r0, #${lcrH}
        str     r0, [r1, #0x2c]
        ldr     r0, =0x301
        str     r0, [r1, #0x30]
`;

/** A program that sends back what it receives, 115200 baud 8N1, in the interrupt. */
export const ECHO = `
main:   ${AT_125_MHZ} ${uart(0x60, 67, 52)}
        movs    r0, #16
        str     r0, [r1, #0x38]
        ldr     r0, =0xe000e100
        ldr     r2, =0x100000
        str     r2, [r0]
sleep:  wfi
        b       sleep
irq20:  push    {r4, lr}
        ldr     r1, =0x40034000
        ldr     r0, [r1]
        str     r0, [r1]
        pop     {r4, pc}
`;

/** The ELF file of an image, one segment for the beginning of the flash. */
export function elf(source) {
  const flash = new Uint8Array(4096).fill(0xff);
  image(source)({ flash: { bytes: flash } });
  const header = new DataView(new ArrayBuffer(84));
  header.setUint32(0, 0x7f454c46);
  const little = (offset, ...words) => words.forEach((word, index) => header.setUint32(offset + 4 * index, word, true));
  header.setUint16(18, 40, true); // ARM
  little(28, 52); // one program header, of 32 bytes, there
  header.setUint16(42, 32, true);
  header.setUint16(44, 1, true);
  little(52, 1, 84, 0x20000000, 0x10000000, flash.length, flash.length);
  return Buffer.concat([new Uint8Array(header.buffer), flash]);
}
