// The chip around the core: what rp2040js lacked, by what the manuals say.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { AT_125_MHZ, image } from './images.mjs';
import { Pico } from './pico.mjs';

const MS = 1e6;
const RAM = 0x20000000;
/** Statements that enable interrupts by a mask, give them priorities, and begin TIMER's alarm 0 in 100 µs. */
const enable = (mask) => `
        ldr     r1, =0xe000e100
        ldr     r0, =${mask}
        str     r0, [r1]
`;
const alarm = (micros) => `
        ldr     r4, =0x40054000
        movs    r0, #1
        str     r0, [r4, #0x38]
        ldr     r0, [r4, #0x28]
        adds    r0, #${micros}
        str     r0, [r4, #0x10]
`;
const acknowledge = `
        ldr     r0, =0x40054000
        movs    r1, #1
        str     r1, [r0, #0x34]
`;

function run(source, nanos, before = () => {}) {
  const said = [];
  const board = new Pico({ say: (line) => said.push([board.clock.nanos, line]) });
  image(source)(board);
  before(board);
  board.powerOn();
  board.run(nanos);
  return { board, said, word: (index) => board.chip.readUint32(RAM + 4 * index) };
}

test('WFI with interrupts masked wakes, and the handler runs when they are allowed', () => {
  const { word } = run(`
main:   ${AT_125_MHZ} ${enable(1)} ${alarm(100)}
        ldr     r5, =${RAM}
        movs    r0, #0
        str     r0, [r5]
        cpsid i
        wfi
        ldr     r6, [r4, #0x28]         ; the time of waking
        ldr     r0, [r4, #0x10]
        subs    r6, r6, r0
        str     r6, [r5, #4]
        ldr     r0, [r5]                ; the handler has not run
        str     r0, [r5, #8]
        cpsie i
        nop
        ldr     r0, [r5]                ; now it has
        str     r0, [r5, #12]
stop:   b       stop
irq0:   ${acknowledge}
        movs    r0, #1
        ldr     r1, =${RAM}
        str     r0, [r1]
        bx      lr
`, MS);
  assert.deepEqual([word(1), word(2), word(3)], [0, 0, 1]);
});

test('WFI does not sleep when an interrupt is pending already', () => {
  const { word } = run(`
main:   ${AT_125_MHZ} ${enable(1)}
        cpsid i
        ${alarm(10)}
wait:   ldr     r0, [r4, #0x34]
        cmp     r0, #1
        bne     wait
        wfi
        ldr     r5, =${RAM}
        movs    r0, #7
        str     r0, [r5]
stop:   b       stop
irq0:   b       irq0
`, MS);
  assert.equal(word(0), 7);
});

test('a higher priority interrupts a handler, an equal one waits', () => {
  // Alarm 0 sets interrupts 26 (priority 0) and 25 (priority 1, its own) pending.
  const order = (irq) => `
irq${irq}: ldr  r0, =${RAM}
        ldr     r1, [r0]
        lsls    r1, r1, #8
        adds    r1, #${irq}
        str     r1, [r0]
`;
  const { word } = run(`
main:   ${AT_125_MHZ}
        ldr     r0, =${RAM}
        movs    r1, #0
        str     r1, [r0]
        ldr     r1, =0xe000e400
        movs    r0, #0x40
        str     r0, [r1]                ; interrupt 0: priority 1, 1: 0
        lsls    r0, r0, #8
        str     r0, [r1, #24]           ; interrupt 25: priority 1
        ${enable(0x2000003)} ${alarm(10)}
stop:   b       stop
${order(0)}
        ${acknowledge}
        ldr     r0, =0xe000e200
        ldr     r1, =0x2000002
        str     r1, [r0]
        dsb
        ldr     r0, =${RAM}
        ldr     r1, [r0]
        lsls    r1, r1, #8
        adds    r1, #0xee
        str     r1, [r0]
        bx      lr
${order(1)}
        bx      lr
${order(25)}
        bx      lr
`, MS);
  assert.equal(word(0).toString(16), '1ee19', 'interrupt 0, then 1 within it, its end, and 25 once');
});

test('an interrupt whose line falls before it is taken stays pending until ICPR', () => {
  const pulse = (clear) => `
main:   ${AT_125_MHZ} ${enable(1)}
        ldr     r5, =${RAM}
        movs    r0, #0
        str     r0, [r5]
        cpsid i
        ${alarm(10)}
wait:   ldr     r0, [r4, #0x34]
        cmp     r0, #1
        bne     wait
        str     r0, [r4, #0x34]
        ldr     r1, =0xe000e280
        movs    r0, #${clear}
        str     r0, [r1]
        cpsie i
stop:   b       stop
irq0:   ldr     r1, =${RAM}
        ldr     r0, [r1]
        adds    r0, #1
        str     r0, [r1]
        bx      lr
`;
  assert.equal(run(pulse(0), MS).word(0), 1);
  assert.equal(run(pulse(1), MS).word(0), 0);
});

test('SBCS and ADCS know an overflow that the carry makes', () => {
  const flags = (instruction, first, second, carry) => {
    const { word } = run(`
main:   ldr     r5, =${RAM}
        movs    r0, #0
        str     r0, [r5]
        ldr     r1, =${first}
        ldr     r2, =${second}
        cmp     r0, #${carry ? 0 : 1}   ; sets or clears the carry
        ${instruction} r1, r2
        mrs     r0, primask             ; leaves the flags
        blt     less
        b       stop
less:   movs    r0, #1
        str     r0, [r5]
stop:   b       stop
`, 10 * MS);
    return word(0) === 1;
  };
  const [most, least] = [0x7fffffff, 0x80000000];
  // LT is the sign of the exact result.
  assert.equal(flags('sbcs', 0xffffffff, most, false), true, '-1 - MAX - 1');
  assert.equal(flags('sbcs', 0, most, false), true, '0 - MAX - 1');
  assert.equal(flags('sbcs', 0, least, true), false, '0 - MIN');
  assert.equal(flags('adcs', most, 0, true), false, 'MAX + 0 + 1');
  assert.equal(flags('adcs', most, 0xffffffff, true), false, 'MAX - 1 + 1');
  assert.equal(flags('adcs', least, 0, false), true, 'MIN + 0');
});

test('an alarm comes when the counter comes to it, to the cycle', () => {
  const { said } = run(`
main:   ${AT_125_MHZ}
        ldr     r0, =0x4001400c         ; GP1: SIO
        movs    r1, #5
        str     r1, [r0]
        ldr     r2, =0xd0000000
        movs    r3, #2
        str     r3, [r2, #0x24]
        ${enable(1)} ${alarm(100)}
        nop
sleep:  wfi
        b       sleep
irq0:   str     r3, [r2, #0x14]
        ${acknowledge}
        bx      lr
`, MS);
  const [[low], [high, what]] = said.slice(-2);
  assert.equal(what, 'pin 1 high');
  // TIMER counts from reset, at 0; the handler begins 15 cycles of 8 ns after the interrupt.
  assert.equal((high - 15 * 8) % 1000, 0);
  assert.ok(high - low > 99_000 && high - low < 101_000);
});

test('an alarm that is not ahead waits for the next round', () => {
  const { word } = run(`
main:   ${AT_125_MHZ} ${enable(1)} ${alarm(0)}
        ldr     r5, =${RAM}
        movs    r0, #0
        str     r0, [r5]
stop:   b       stop
irq0:   ldr     r5, =${RAM}
        movs    r0, #1
        str     r0, [r5]
        bx      lr
`, 10 * MS);
  assert.equal(word(0), 0);
});

test('edges of inputs interrupt once each; levels and pulls read back', () => {
  const { word, board } = run(`
main:   ${AT_125_MHZ}
        ldr     r5, =${RAM}
        movs    r0, #0
        str     r0, [r5]
        ldr     r1, =0x4001c018         ; pad of GP5: pull up
        movs    r0, #0x4a
        str     r0, [r1]
        ldr     r1, =0x400140f0         ; forget the edge that the pull made
        ldr     r0, =0x00c00000
        str     r0, [r1]
        ldr     r1, =0x40014100         ; IO_BANK0: GP5 falls or rises
        str     r0, [r1]
        ${enable(0x2000)}
sleep:  wfi
        b       sleep
irq13:  ldr     r1, =0x400140f0
        ldr     r0, =0x00c00000
        str     r0, [r1]
        ldr     r5, =${RAM}
        ldr     r0, [r5]
        adds    r0, #1
        str     r0, [r5]
        ldr     r1, =0xd0000004
        ldr     r0, [r1]
        str     r0, [r5, #4]
        bx      lr
`, MS);
  const count = () => [word(0), (word(1) >> 5) & 1];
  assert.equal(count()[0], 0, 'nothing has moved since');
  const steps = [[false, 1, 0], [false, 1, 0], [true, 2, 1], [null, 2, 1], [false, 3, 0], [null, 4, 1]];
  for (const [level, times, seen] of steps) {
    board.drive(5, level);
    board.run(board.clock.nanos + MS);
    assert.deepEqual(count(), [times, seen]);
  }
});

test('a peripheral in reset, and a TIMER without its tick, stop the image that uses them', () => {
  const use = (unreset, address) => run(`
main:   ${unreset}
        ldr     r1, =${address}
        ldr     r0, [r1]
stop:   b       stop
`, MS).said.map(([, line]) => line.replace(/ at 0x\w+$/, ''));
  const unreset = `
        ldr     r1, =0x4000c000
        movs    r0, #0
        str     r0, [r1]`;
  assert.deepEqual(use('', '0x40034018'), ['error access to a peripheral in reset: 0x40034018']);
  assert.deepEqual(use(unreset, '0x40034018'), []);
  assert.match(use(unreset, '0x40054028')[0], /^error TIMER counts no microseconds: .* divides 6500000 Hz by 0: /);
  assert.deepEqual(use(AT_125_MHZ, '0x40054028'), []);
});

test('UDF is a hard fault, said aloud and taken', () => {
  const { said, word } = run(`
main:   movs    r0, #0
        udf     #1
stop:   b       stop
hardfault:
        ldr     r5, =${RAM}
        movs    r0, #9
        str     r0, [r5]
        b       stop
`, MS);
  assert.deepEqual(said.map(([, line]) => line), ['error hard fault at 0x10000202']);
  assert.equal(word(0), 9);
});

test('the core needs 1.15 V for more than 133 MHz (2.15.3)', () => {
  const at200 = AT_125_MHZ.replace('movs    r0, #125', 'movs    r0, #100').replace('0x00062000', '0x00061000');
  const at115 = `
        ldr     r1, =0x40064000
        movs    r0, #0xc1
        str     r0, [r1]
`;
  const errors = (source) => run(`main: ${source}\nstop:   b       stop`, 2 * MS).said.filter(([, line]) => /error/.test(line));
  assert.match(errors(at200)[0]?.[1] ?? '', /too low a voltage for 200 MHz/);
  assert.deepEqual(errors(at115 + at200), []);
});
