import assert from 'node:assert/strict';
import { test } from 'node:test';

import { Clock } from './clock.mjs';
import { ERROR, INT, Pl011 } from './uart.mjs';

const [DR, FR, IBRD, FBRD, LCR_H, CR] = [0, 0x18, 0x24, 0x28, 0x2c, 0x30];
const [IFLS, IMSC, RIS, MIS, ICR] = [0x34, 0x38, 0x3c, 0x40, 0x44];
const [BUSY, RXFE, TXFF, RXFF, TXFE] = [1 << 3, 1 << 4, 1 << 5, 1 << 6, 1 << 7];
const [PEN, STP2, FEN, EIGHT] = [1 << 1, 1 << 3, 1 << 4, 3 << 5];
// 125 MHz / (16 * (67 + 52/64)) = 115207 baud: 8680 ns a bit.
const BIT = 8680;

function uart(lcrH) {
  const clock = new Clock();
  const sent = [];
  const line = { irq: false, sent };
  const chip = { clock, setInterrupt: (irq, high) => irq === 20 && (line.irq = high), logger: { error: assert.fail } };
  const pl011 = new Pl011(chip, 20, { clockHz: () => 125e6, sent: (byte) => sent.push([clock.nanos, byte]) });
  const write = (offset, value) => pl011.writeUint32Atomic(offset, value, 0);
  write(IBRD, 67);
  write(FBRD, 52);
  write(LCR_H, lcrH);
  write(CR, 0x301);
  return { pl011, clock, line, write, read: (offset) => pl011.readUint32(offset) };
}

test('characters follow each other at the programmed rate and format', () => {
  for (const [format, bits] of [[EIGHT, 10], [EIGHT | PEN, 11], [EIGHT | PEN | STP2, 12], [2 << 5, 9]]) {
    const { clock, line, write, read } = uart(format | FEN);
    for (const byte of [1, 2, 3]) write(DR, byte);
    const end = 3 * bits * BIT;
    clock.advanceTo(end - 1);
    assert.equal(read(FR) & BUSY, BUSY);
    clock.advanceTo(end);
    assert.equal(read(FR) & BUSY, 0);
    assert.deepEqual(line.sent, [[0, 1], [bits * BIT, 2], [2 * bits * BIT, 3]]);
  }
});

test('the transmitter holds one character beside the one under way, or 32 with FIFO', () => {
  for (const [format, depth] of [[EIGHT, 1], [EIGHT | FEN, 32]]) {
    const { clock, write, read } = uart(format);
    assert.equal(read(FR), TXFE | RXFE);
    for (let count = 0; count < 1 + depth; count++) {
      assert.equal(read(FR) & TXFF, 0);
      write(DR, count);
    }
    assert.equal(read(FR) & (TXFF | TXFE), TXFF);
    clock.advanceTo(10 * BIT);
    assert.equal(read(FR) & TXFF, 0);
  }
});

test('without FIFO the transmit interrupt comes whenever the holding register becomes empty', () => {
  const { clock, line, write, read } = uart(EIGHT);
  write(IMSC, INT.tx);
  assert.equal(line.irq, false, 'not before the first character');
  write(DR, 1);
  assert.equal(line.irq, true, 'the first goes on at once');
  write(DR, 2);
  assert.equal(line.irq, false);
  clock.advanceTo(10 * BIT);
  assert.equal(line.irq, true);
  assert.equal(read(MIS), INT.tx);
  write(ICR, INT.tx);
  assert.equal(line.irq, false);
});

test('with FIFO the transmit interrupt comes when the level is passed, and not for a short frame', () => {
  const { clock, write, read } = uart(EIGHT | FEN);
  write(IFLS, 0); // an eighth: 4 characters
  for (let count = 0; count < 5; count++) write(DR, count);
  clock.advanceTo(60 * BIT);
  assert.equal(read(RIS), 0, 'one under way and four waiting never pass four');
  for (let count = 0; count < 6; count++) write(DR, count);
  clock.advanceTo(69 * BIT);
  assert.equal(read(RIS), 0);
  clock.advanceTo(70 * BIT);
  assert.equal(read(RIS), INT.tx);
});

test('the receive interrupt comes at the level, the timeout after 32 bits of silence', () => {
  const { pl011, clock, line, write, read } = uart(EIGHT | FEN);
  write(IFLS, 0);
  write(IMSC, INT.rx | INT.timeout);
  for (const byte of [10, 11, 12]) pl011.receive(byte);
  assert.equal(read(RIS), 0);
  pl011.receive(13);
  assert.equal(read(RIS), INT.rx);
  assert.equal(read(DR), 10);
  assert.equal(read(RIS), 0);
  clock.advanceTo(32 * BIT - 1);
  assert.equal(read(RIS), 0);
  clock.advanceTo(32 * BIT);
  assert.equal(read(MIS), INT.timeout);
  assert.equal(line.irq, true);
  assert.deepEqual([read(DR), read(DR)], [11, 12]);
  assert.equal(line.irq, true);
  assert.equal(read(DR), 13);
  assert.equal(line.irq, false, 'the last character takes the timeout with it');
  assert.equal(read(FR) & RXFE, RXFE);
});

test('every character puts the timeout off', () => {
  const { pl011, clock, read } = uart(EIGHT | FEN);
  pl011.receive(1);
  clock.advanceTo(20 * BIT);
  pl011.receive(2);
  clock.advanceTo(51 * BIT);
  assert.equal(read(RIS), 0);
  clock.advanceTo(52 * BIT);
  assert.equal(read(RIS), INT.timeout);
});

test('a character that finds no room is lost, and the next one says so', () => {
  for (const [format, depth] of [[EIGHT, 1], [EIGHT | FEN, 32]]) {
    const { pl011, read, write } = uart(format);
    for (let count = 0; count < depth; count++) pl011.receive(count);
    assert.equal(read(FR) & RXFF, RXFF);
    assert.equal(read(RIS) & INT.overrun, 0);
    pl011.receive(0x55);
    assert.equal(read(RIS) & INT.overrun, INT.overrun);
    for (let count = 0; count < depth; count++) assert.equal(read(DR), count);
    pl011.receive(0x66);
    assert.equal(read(DR), 0x66 | ERROR.overrun);
    write(ICR, 0x7ff);
    assert.equal(read(RIS) & INT.overrun, 0);
  }
});

test('a spoiled character carries its error and raises its interrupt', () => {
  const interrupts = { framing: 1 << 7, parity: 1 << 8, break: 1 << 9 };
  const bits = { framing: 1 << 8, parity: 1 << 9, break: 1 << 10 };
  for (const kind of Object.keys(interrupts)) {
    const { pl011, read } = uart(EIGHT | FEN);
    pl011.receive(0x41, ERROR[kind]);
    pl011.receive(0x42);
    assert.equal(read(RIS), interrupts[kind]);
    assert.deepEqual([read(DR), read(DR)], [0x41 | bits[kind], 0x42]);
  }
});

test('a new divisor takes effect with the next write of the format', () => {
  const { pl011, write } = uart(EIGHT);
  write(IBRD, 813); // 9600 baud: 813 + 51/64
  write(FBRD, 51);
  assert.equal(pl011.characterNanos, 10 * BIT);
  write(LCR_H, EIGHT);
  assert.equal(pl011.characterNanos, (10 * 16 * (813 + 51 / 64)) / 0.125);
});

test('a UART that is off neither hears nor sends', () => {
  const { pl011, clock, line, write, read } = uart(EIGHT);
  write(CR, 0x300);
  assert.equal(pl011.receive(1), false);
  write(DR, 2);
  clock.advanceTo(1e6);
  assert.deepEqual(line.sent, []);
  assert.equal(read(FR) & BUSY, BUSY, 'what waits keeps it busy');
  write(CR, 0x301);
  assert.deepEqual(line.sent, [[1e6, 2]]);
});
