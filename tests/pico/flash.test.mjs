import assert from 'node:assert/strict';
import { test } from 'node:test';

import { Clock } from './clock.mjs';
import { Flash } from './flash.mjs';

const MS = 1e6;

function flash() {
  const clock = new Clock();
  const said = [];
  const chip = new Flash(clock, (line) => said.push([clock.nanos, line]));
  chip.onCut = () => {
    said.push([clock.nanos, 'cut']);
    chip.powerFails();
  };
  return { clock, said, chip };
}

test('a sector is erased in 45 ms, one after the other, a block in 150 ms', () => {
  const { clock, said, chip } = flash();
  chip.bytes.fill(0);
  chip.erase(0x0f000, 0x12000, true);
  clock.advanceTo(239 * MS);
  assert.equal(chip.busy, true);
  clock.advanceTo(240 * MS);
  assert.equal(chip.busy, false);
  assert.deepEqual(said, [[0, 'erase 0x00f000'], [45 * MS, 'erase 0x010000 block'], [195 * MS, 'erase 0x020000']]);
  assert.equal(chip.bytes[0x0efff], 0);
  assert.ok(chip.bytes.subarray(0x0f000, 0x21000).every((byte) => byte === 0xff));
  assert.equal(chip.bytes[0x21000], 0);
});

test('without blocks every sector takes its 45 ms', () => {
  const { clock, chip } = flash();
  chip.erase(0x10000, 0x10000);
  clock.advanceTo(16 * 45 * MS - 1);
  assert.equal(chip.busy, true);
  clock.advanceTo(16 * 45 * MS);
  assert.equal(chip.busy, false);
});

test('programming takes 0.4 ms a page and only clears bits', () => {
  const { clock, said, chip } = flash();
  chip.bytes.fill(0b1100, 0x1000, 0x1100);
  chip.program(0x1000, new Uint8Array(512).fill(0b1010));
  clock.advanceTo(0.8 * MS - 1);
  assert.equal(chip.busy, true);
  clock.advanceTo(0.8 * MS);
  assert.equal(chip.busy, false);
  assert.deepEqual(said, [[0, 'program 0x001000 256'], [0.4 * MS, 'program 0x001100 256']]);
  assert.ok(chip.bytes.subarray(0x1000, 0x1100).every((byte) => byte === 0b1000));
  assert.ok(chip.bytes.subarray(0x1100, 0x1200).every((byte) => byte === 0b1010));
});

test('a cut leaves whole bytes, one half byte and the rest untouched', () => {
  const { clock, said, chip } = flash();
  chip.cutAfter(256 + 64);
  chip.program(0, new Uint8Array(512).fill(0x5a));
  clock.advanceTo(MS);
  assert.deepEqual(said.at(-1), [0.5 * MS, 'cut']);
  assert.ok(chip.bytes.subarray(0, 320).every((byte) => byte === 0x5a));
  assert.equal(chip.bytes[320], 0x5f);
  assert.ok(chip.bytes.subarray(321, 512).every((byte) => byte === 0xff));
  assert.equal(chip.busy, false);
});

test('a cut counts from the byte that is under way', () => {
  const { clock, said, chip } = flash();
  chip.bytes.fill(0);
  chip.erase(0, 4096);
  clock.advanceTo(22.5 * MS);
  chip.cutAfter(1024);
  clock.advanceTo(100 * MS);
  assert.deepEqual(said.at(-1), [33.75 * MS, 'cut']);
  assert.equal(chip.bytes.lastIndexOf(0xff), 3071);
  assert.equal(chip.bytes[3072], 0xf0);
});

test('power that fails at any time leaves what was done by then', () => {
  const { clock, chip } = flash();
  chip.program(0, new Uint8Array(256).fill(0));
  clock.advanceTo(0.1 * MS);
  chip.powerFails();
  clock.advanceTo(MS);
  assert.equal(chip.bytes.lastIndexOf(0x00), 63);
  assert.equal(chip.bytes[64], 0x0f);
});

test('parts of units are refused', () => {
  const { chip } = flash();
  assert.throws(() => chip.erase(0x800, 4096), /not whole units of 4096/);
  assert.throws(() => chip.erase(0x1000, 100), /not whole units of 4096/);
  assert.throws(() => chip.program(0x1010, new Uint8Array(256)), /not whole units of 256/);
  assert.throws(() => chip.erase(0x1ff000, 8192), /in the chip/);
});
