// The boot ROM: ours, because rp2040js has none.
//
// It has the tables of the real one (RP2040 datasheet 2.8.3) and of its functions those that a drive calls.
// Its boot takes no time for USB, for the search of the flash chip or for a second try: it waits for a flash
// that is still at work from before the reset, checks the second stage and runs it.

import { assemble } from './thumb.mjs';

/** Numbers of the `bkpt` with which the ROM asks the harness to do a thing. */
export const CALL = { boot: 0, missing: 1, erase: 2, program: 3, wait: 4, exitXip: 5, enterXip: 6, bootLoader: 7, bits: 8 };

/** Where the second stage is copied to and run. */
export const BOOT2_AT = 0x20041f00;

const call = Object.fromEntries(Object.entries(CALL).map(([name, number]) => [name, `bkpt #${number}`]));

const SOURCE = `
        .word   ${BOOT2_AT}, reset+1, stop+1, stop+1
        .word   0x0301754d              ; 'M', 'u', 1, version 3
        .hword  functions, data
        .hword  lookup+1, 0

functions:
        .hword  0x3443, memcpy44+1      ; 'C4'
        .hword  0x434d, memcpy+1        ; 'MC'
        .hword  0x3453, memset4+1       ; 'S4'
        .hword  0x534d, memset+1        ; 'MS'
        .hword  0x4649, done+1          ; 'IF': the pins are always connected
        .hword  0x5845, exit_xip+1      ; 'EX'
        .hword  0x4552, erase+1         ; 'RE'
        .hword  0x5052, program+1       ; 'RP'
        .hword  0x4346, done+1          ; 'FC': there is no cache
        .hword  0x5843, enter_xip+1     ; 'CX'
        .hword  0x4255, usb_boot+1      ; 'UB'
        .hword  0x3350, popcount+1      ; 'P3'
        .hword  0x3352, reverse+1       ; 'R3'
        .hword  0x334c, clz+1           ; 'L3'
        .hword  0x3354, ctz+1           ; 'T3'
data:
        .hword  0, 0

lookup: ldrh    r2, [r0]
        cmp     r2, #0
        beq     absent
        ldrh    r3, [r0, #2]
        adds    r0, #4
        cmp     r2, r1
        bne     lookup
        mov     r0, r3
        bx      lr
absent: ${call.missing}
        movs    r0, #0
        bx      lr

memcpy44:
        mov     r12, r0
words:  subs    r2, #4
        blo     copied
        ldmia   r1!, {r3}
        stmia   r0!, {r3}
        b       words
copied: mov     r0, r12
        bx      lr

memcpy: mov     r12, r0
bytes:  subs    r2, #1
        blo     copied
        ldrb    r3, [r1]
        strb    r3, [r0]
        adds    r1, #1
        adds    r0, #1
        b       bytes

memset4:
memset: mov     r12, r0
fill:   subs    r2, #1
        blo     copied
        strb    r1, [r0]
        adds    r0, #1
        b       fill

exit_xip:
        ${call.exitXip}
        bx      lr
enter_xip:
        ${call.enterXip}
        bx      lr

; The harness sends the CPU back to the wait until the flash is ready; interrupts are served meanwhile.
erase:  ${call.erase}
        ${call.wait}
        bx      lr
program:
        ${call.program}
        ${call.wait}
done:   bx      lr

usb_boot:
        ${call.bootLoader}
        b       stop

popcount:
        bkpt    #${CALL.bits}
        bx      lr
reverse:
        bkpt    #${CALL.bits + 1}
        bx      lr
clz:    bkpt    #${CALL.bits + 2}
        bx      lr
ctz:    bkpt    #${CALL.bits + 3}
        bx      lr

reset:  ${call.wait}
        ${call.boot}                    ; stops here if the checksum of the second stage is wrong
        ldr     r0, =${BOOT2_AT}
        ldr     r1, =0x10000000
        ldr     r2, =256
        bl      memcpy44
        movs    r1, #0                  ; the second stage knows by a zero that the ROM calls it
        mov     lr, r1
        adds    r0, #1
        bx      r0

stop:   b       stop
`;

/** The ROM as words from address 0. */
export const ROM = new Uint32Array(assemble(SOURCE, 0).bytes.buffer);

/**
 * What the ROM's bit functions compute.
 *
 * @param {number} which 0 to 3: population count, reversal, leading zeros, trailing zeros
 * @param {number} word 32 bits
 * @returns {number} the result
 */
export function bits(which, word) {
  const text = (word >>> 0).toString(2).padStart(32, '0');
  switch (which) {
    case 0:
      return text.replaceAll('0', '').length;
    case 1:
      return parseInt([...text].reverse().join(''), 2);
    case 2:
      return Math.clz32(word);
    default:
      return word ? 31 - Math.clz32(word & -word) : 32;
  }
}

/**
 * Whether the second stage's last word is its checksum, as the real ROM demands (datasheet 2.8.1.3.1).
 *
 * @param {Uint8Array} boot2 256 bytes
 */
export function isValidBoot2(boot2) {
  const view = new DataView(boot2.buffer, boot2.byteOffset, 256);
  return view.getUint32(252, true) === boot2Checksum(boot2);
}

/**
 * CRC-32 as the boot ROM reckons it: polynomial 0x04C11DB7, not reflected, over the first 252 bytes.
 *
 * @param {Uint8Array} boot2 at least 252 bytes
 */
export function boot2Checksum(boot2) {
  let crc = 0xffffffff;
  for (const byte of boot2.subarray(0, 252)) {
    crc ^= byte << 24;
    for (let bit = 0; bit < 8; bit++) crc = crc & 0x80000000 ? (crc << 1) ^ 0x04c11db7 : crc << 1;
  }
  return crc >>> 0;
}
