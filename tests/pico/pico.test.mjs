// The board: boot, flash, watchdog, power, and that two runs are one.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { AT_125_MHZ, ECHO, STACK_TOP, image } from './images.mjs';
import { Pico } from './pico.mjs';
import { play } from './play.mjs';

const MS = 1e6;
const RAM = 0x20000000;

/** Statements that call a function of the ROM; what it takes in r0 to r3 comes from `setUp`. */
const rom = (code, setUp) => `
        movs    r0, #0x14
        ldrh    r0, [r0]
        ldr     r1, =${code.charCodeAt(0) | (code.charCodeAt(1) << 8)}
        movs    r2, #0x18
        ldrh    r2, [r2]
        blx     r2
        mov     r12, r0
        ${setUp}
        mov     r7, r12
        blx     r7
`;

/** A program that copies what is between its labels `ram` and `end` into RAM and goes there. */
const inRam = (body) => `
main:   ${AT_125_MHZ}
        ldr     r0, =0x20010000
        ldr     r1, =ram
        ldr     r2, =1024
copy:   ldmia   r1!, {r3}
        stmia   r0!, {r3}
        subs    r2, #4
        bne     copy
        ldr     r0, =0x20010001
        bx      r0
        .align 4
ram:    ${body}
`;

function start(source, before = () => {}) {
  const said = [];
  const board = new Pico({ say: (line) => said.push([board.clock.nanos, line]) });
  image(source)(board);
  before(board);
  board.powerOn();
  return { board, said, word: (index) => board.chip.readUint32(RAM + 4 * index) };
}

test('a second stage with a wrong checksum does not run', () => {
  const { board, said } = start('main: b main', (pico) => (pico.flash.bytes[0] ^= 1));
  board.run(MS);
  assert.deepEqual(said.map(([, line]) => line), ['error the second stage in flash has a wrong checksum']);
});

test('the ROM copies, fills and counts', () => {
  const { board, said, word } = start(`
main:   ${rom('C4', `ldr r0, =${RAM + 32}
        movs    r1, #0
        movs    r2, #8`)}
        ldr     r5, =${RAM}
        str     r0, [r5]
        ${rom('MS', `ldr r0, =${RAM + 40}
        movs    r1, #0x5a
        movs    r2, #3`)}
        ${rom('MC', `ldr r0, =${RAM + 48}
        movs    r1, #16
        movs    r2, #2`)}
        ${rom('P3', 'ldr r0, =0xf0f00001')}
        str     r0, [r5, #4]
        ${rom('L3', 'ldr r0, =0x00010000')}
        str     r0, [r5, #8]
        ${rom('T3', 'ldr r0, =0x00010000')}
        str     r0, [r5, #12]
        ${rom('R3', 'ldr r0, =0x00000003')}
        str     r0, [r5, #16]
        ${rom('XX', '')}
`);
  board.run(10 * MS);
  assert.deepEqual(said.map(([, line]) => line), ["error there is no ROM function 'XX' here"]);
  assert.deepEqual([0, 1, 2, 3, 4].map(word), [RAM + 32, 9, 15, 16, 0xc0000000]);
  assert.equal(word(8), 0x20041f00, 'the first word of the ROM is its stack');
  assert.equal(word(10), 0xa55a5a5a, 'RAM was noise before');
  assert.equal(word(12), 0xa5a5754d, "'M', 'u'");
});

/** Erases the sector at 0x1000 and programs its first page, while alarm 0 counts every 1000 µs in RAM word 0. */
const FLASHING = inRam(`
        ldr     r1, =0xe000ed08         ; vectors in RAM: only interrupt 0
        ldr     r0, =0x20020000
        str     r0, [r1]
        ldr     r1, =0x20010000
        ldr     r2, =handler
        ldr     r3, =ram
        subs    r2, r2, r3
        adds    r1, r1, r2
        adds    r1, #1
        str     r1, [r0, #64]
        ldr     r5, =${RAM}
        movs    r0, #0
        str     r0, [r5]
        ldr     r1, =0xe000e100
        movs    r0, #1
        str     r0, [r1]
        ldr     r4, =0x40054000
        str     r0, [r4, #0x38]
        ldr     r0, [r4, #0x28]
        ldr     r1, =1000
        adds    r0, r0, r1
        str     r0, [r4, #0x10]
        ${rom('IF', '')}
        ${rom('EX', '')}
        ${rom('RE', `ldr r0, =0x1000
        ldr     r1, =4096
        ldr     r2, =65536
        movs    r3, #0xd8`)}
        ldr     r0, [r5]
        str     r0, [r5, #4]            ; ticks during the erase
        ${rom('RP', `ldr r0, =0x1000
        ldr     r1, =${RAM}
        ldr     r2, =256`)}
        ${rom('FC', '')}
        ${rom('CX', '')}
        ldr     r1, =0x10001004
        ldr     r0, [r1]
        str     r0, [r5, #8]            ; what was programmed
stop:   wfi
        b       stop
        .align 4
handler:
        ldr     r0, =0x40054000
        movs    r1, #1
        str     r1, [r0, #0x34]
        ldr     r1, [r0, #0x10]
        ldr     r2, =1000
        adds    r1, r1, r2
        str     r1, [r0, #0x10]
        ldr     r0, =${RAM}
        ldr     r1, [r0]
        adds    r1, #1
        str     r1, [r0]
        bx      lr
`);

test('interrupts are served while the flash is at work, and it takes its time', () => {
  const { board, said, word } = start(FLASHING);
  board.run(60 * MS);
  const flash = said.filter(([, line]) => line.startsWith('flash'));
  assert.deepEqual(flash.map(([, line]) => line), ['flash erase 0x001000', 'flash program 0x001000 256']);
  const took = flash[1][0] - flash[0][0];
  assert.ok(took >= 45 * MS && took < 45.01 * MS, `${took} ns`);
  assert.deepEqual(said.filter(([, line]) => line.startsWith('error')), []);
  assert.ok(word(1) === 45 || word(1) === 44, `${word(1)} ticks of 1 ms in 45 ms`);
  assert.equal(word(2), word(1));
});

test('whoever reads the flash while it is at work is stopped', () => {
  const { board, said } = start(FLASHING.replace('handler:', 'handler: ldr r0, =0x10000000\nldr r0, [r0]\n'));
  board.run(60 * MS);
  const errors = said.filter(([, line]) => line.startsWith('error'));
  assert.equal(errors.length, 1);
  assert.match(errors[0][1], /^error read while the flash is busy: 0x10000000 at 0x2001\w+$/);
});

test('a cut in an erase leaves the flash partly erased and the board without power', () => {
  const { board, said } = start(FLASHING, (pico) => {
    pico.flash.bytes.fill(0, 0x1000, 0x2000);
    pico.flash.cutAfter(100);
  });
  board.run(60 * MS);
  assert.equal(said.at(-1)[1], 'power off');
  assert.equal(said.at(-1)[0] - said.at(-2)[0], (45 * MS * 100) / 4096);
  assert.equal(board.flash.bytes.lastIndexOf(0xff, 0x1fff), 0x1000 + 99);
  assert.equal(board.flash.bytes[0x1000 + 100], 0xf0);
  board.powerOn();
  board.run(120 * MS);
  assert.equal(said.at(-1)[1], 'flash program 0x001000 256');
});

test('a reset in an erase waits for the flash before it boots', () => {
  const { board, said } = start(FLASHING);
  board.run(20 * MS);
  board.reset('watchdog');
  board.run(60 * MS);
  const lines = said.filter(([, line]) => !line.startsWith('pin'));
  const erases = lines.filter(([, line]) => line.startsWith('flash erase'));
  assert.deepEqual(lines.map(([, line]) => line), ['flash erase 0x001000', 'reset watchdog', 'flash erase 0x001000']);
  assert.ok(erases[1][0] > erases[0][0] + 45 * MS);
});

/** Counts its starts in RAM word 0 and the watchdog's scratch 0; then lets the watchdog come after 500 µs. */
const WATCHED = `
main:   ${AT_125_MHZ}
        ldr     r4, =0x40058000
        ldr     r5, =${RAM}
        ldr     r0, [r5]
        adds    r0, #1
        str     r0, [r5]
        ldr     r0, [r4, #8]
        str     r0, [r5, #4]            ; the reason
        ldr     r0, [r4, #12]
        adds    r0, #1
        str     r0, [r4, #12]
        cmp     r0, #3
        beq     stop
        ldr     r1, =0x40010000         ; PSM.WDSEL
        ldr     r0, =0x0001fffc
        str     r0, [r1, #8]
        ldr     r0, =1000               ; twice the microseconds (RP2040-E1)
        str     r0, [r4, #4]
        ldr     r0, =0x40000000
        str     r0, [r4]
stop:   b       stop
`;

test('the watchdog resets the chip; RAM, scratch and flash stay', () => {
  const { board, said, word } = start(WATCHED);
  board.run(10 * MS);
  assert.deepEqual(said.map(([, line]) => line), ['reset watchdog', 'reset watchdog']);
  assert.deepEqual([word(0), word(1)], [0xa5a5a5a5 + 2 + 1, 1]);
});

test('the watchdog counts two a microsecond', () => {
  const period = (load) => {
    const { board, said } = start(WATCHED.replace('=1000 ', `=${load} `));
    board.run(10 * MS);
    return said[1][0] - said[0][0];
  };
  // The rest of the period is the boot, which may begin between two ns.
  assert.ok(Math.abs(period(3000) - period(1000) - MS) < 10);
});

test('a watchdog that may not reset the processor says so', () => {
  const { board, said } = start(WATCHED.replace('0x0001fffc', '0'));
  board.run(10 * MS);
  assert.match(said[0][1], /^error the watchdog resets nothing/);
});

test('power off and on is a new start with the flash of before', () => {
  const { board, word } = start(WATCHED.replace('str     r0, [r4]\n', ''));
  board.run(MS);
  assert.equal(word(0), 0xa5a5a5a6);
  board.flash.bytes[0x100000] = 1;
  board.powerOff();
  board.run(2 * MS);
  board.powerOn();
  board.run(3 * MS);
  assert.equal(word(0), 0xa5a5a5a6);
  assert.equal(board.flash.bytes[0x100000], 1);
});

test('two runs print the same, and what they print is right', () => {
  const script = `
500 rx 31 32          # the end of the stop bit of 31
1000 spoiled parity 41
1500.5 power off
1600 rx 33
2000 power on
2500 rx 34
2600 hang
2700 rx 35
3000 end`;
  const run = () => play({ load: image(ECHO), script, stack: [STACK_TOP - 4096, STACK_TOP] }).output;
  const output = run();
  assert.equal(run(), output);
  const lines = output.trim().split('\n');
  const at = (line) => Number(lines.find((text) => text.endsWith(` ${line}`)).split(' ')[0]);
  // Cycles of 8 ns before the store: entry 15, push 2, load 2, load from the UART 4.
  assert.equal(at('tx 31'), 500_000 + 23 * 8);
  assert.equal(at('tx 32') - at('tx 31'), 86_800);
  assert.ok(at('tx 41') > 1_000_000, 'the image does not look at the error bits');
  assert.equal(at('power off'), 1_500_500);
  assert.equal(at('unheard 33'), 1_600_000);
  assert.ok(at('tx 34') > 2_500_000);
  assert.equal(lines.some((line) => line.endsWith('tx 35')), false);
  // With the store, 5, but without the pop, whose cycles go to what follows.
  assert.ok(lines.includes('stat exception 36 times 4 worst 5 cycles 28 total 20 cycles 112'), output);
  assert.equal(lines.at(-1), 'stat stack 40 of 4096', '32 bytes of the exception frame and two words');
});

test('instructions between marks are counted without those of interrupts', () => {
  const measured = (between) => {
    const source = ECHO.replace('sleep:', `mov r10, r10\n${between}\nmov r11, r11\nsleep:`);
    const { output } = play({ load: image(source), script: '450 rx 31\n9000 end', marks: true });
    return output.trim().split('\n').at(-1);
  };
  assert.equal(measured('nop\nnop\nnop'), 'stat marked times 1 least 3 worst 3 total 3');
  // 2 to begin with and 3 a round; the character comes in the middle.
  const loop = 'ldr r2, =50000\nmovs r3, #0\nround: subs r2, #1\ncmp r2, #0\nbne round';
  assert.equal(measured(loop), `stat marked times 1 least 150002 worst 150002 total 150002`);
});

test('a script that cannot be read is refused with its line', () => {
  const attempt = (script) => () => play({ load: () => {}, script });
  assert.throws(attempt('1 rx 0g\n2 end'), /^Error: script, line 1: `0g`/);
  assert.throws(attempt('2 hang\n1 end'), /line 2: times must ascend/);
  assert.throws(attempt('2 jump\n3 end'), /line 1: unknown event `jump`/);
  assert.throws(attempt('2 hang'), /the last line must be/);
});
