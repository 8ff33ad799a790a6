// A serial port over Telnet, by RFC 854 and RFC 2217.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { ComPort } from './rfc2217.mjs';

function opened() {
  const log = { sent: [], data: [], lines: [], dtr: [] };
  const port = new ComPort({
    send: (bytes) => log.sent.push(...bytes),
    data: (bytes) => log.data.push(...bytes),
    line: (baud, format) => log.lines.push(`${baud} ${format}`),
    dtr: (isOn) => log.dtr.push(isOn),
  });
  const ask = (...bytes) => {
    log.sent = [];
    port.take(Uint8Array.from(bytes));
    return log.sent;
  };
  return { port, log, ask };
}

test('it offers the option at once, agrees once, and refuses what it does not know', () => {
  const { log, ask } = opened();
  assert.deepEqual(log.sent, [
    255, 251, 0, 255, 253, 0, 255, 251, 3, 255, 253, 3, 255, 251, 44, 255, 253, 44,
  ]);
  assert.deepEqual(ask(255, 251, 44, 255, 253, 44), [], 'it has said so already');
  assert.deepEqual(ask(255, 253, 1), [255, 252, 1]);
  assert.deepEqual(ask(255, 251, 1), [255, 254, 1]);
  assert.deepEqual(ask(255, 251, 1), []);
});

test('255 is doubled in data, both ways, and packets may end anywhere', () => {
  const { port, log, ask } = opened();
  ask(1, 255);
  ask(255, 2);
  assert.deepEqual(log.data, [1, 255, 2]);
  log.sent = [];
  port.write(Uint8Array.of(3, 255, 4));
  assert.deepEqual(log.sent, [3, 255, 255, 4]);
});

test('settings are set and answered; impossible ones and 0 ask', () => {
  const { log, ask } = opened();
  assert.deepEqual(ask(255, 250, 44, 1, 0, 0, 0x25, 0x80, 255, 240), [255, 250, 44, 101, 0, 0, 0x25, 0x80, 255, 240]);
  assert.deepEqual(ask(255, 250, 44, 2, 7, 255, 240), [255, 250, 44, 102, 7, 255, 240]);
  assert.deepEqual(ask(255, 250, 44, 3, 3, 255, 240), [255, 250, 44, 103, 3, 255, 240]);
  assert.deepEqual(ask(255, 250, 44, 4, 2, 255, 240), [255, 250, 44, 104, 2, 255, 240]);
  assert.equal(log.lines.at(-1), '9600 7E2');
  const { length } = log.lines;
  assert.deepEqual(ask(255, 250, 44, 1, 0, 0, 0, 0, 255, 240), [255, 250, 44, 101, 0, 0, 0x25, 0x80, 255, 240]);
  assert.deepEqual(ask(255, 250, 44, 3, 0, 255, 240), [255, 250, 44, 103, 3, 255, 240]);
  assert.deepEqual(ask(255, 250, 44, 2, 99, 255, 240), [255, 250, 44, 102, 7, 255, 240]);
  assert.equal(log.lines.length, length);
  assert.deepEqual(ask(255, 250, 44, 1, 0, 0, 255, 255, 255, 255, 255, 240), [
    255, 250, 44, 101, 0, 0, 255, 255, 255, 255, 255, 240,
  ], '65535 baud, with 255 doubled');
});

test('DTR is switched and told', () => {
  const { log, ask } = opened();
  assert.deepEqual(ask(255, 250, 44, 5, 7, 255, 240), [255, 250, 44, 105, 8, 255, 240]);
  assert.deepEqual(ask(255, 250, 44, 5, 9, 255, 240), [255, 250, 44, 105, 9, 255, 240]);
  assert.deepEqual(ask(255, 250, 44, 5, 7, 255, 240), [255, 250, 44, 105, 9, 255, 240]);
  assert.deepEqual(ask(255, 250, 44, 5, 8, 255, 240), [255, 250, 44, 105, 8, 255, 240]);
  assert.deepEqual(log.dtr, [false, true]);
});

test('no bytes make it fail', () => {
  const { log, port } = opened();
  let seed = 1;
  for (let count = 0; count < 100_000; count++) {
    seed = (seed * 1103515245 + 12345) & 0x7fffffff;
    const byte = (seed >> 16) & 0xff;
    port.take(Uint8Array.of(byte > 200 ? 255 : byte, byte));
  }
  assert.ok(log.data.length > 0);
});
