import assert from 'node:assert/strict';
import { mkdtempSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { test } from 'node:test';

import { image } from './images.mjs';
import { Pico } from './pico.mjs';

/** A block for an RP2040, typed from the specification. */
function block(number, count, address, byte) {
  const block = Buffer.alloc(512);
  block.set([0x55, 0x46, 0x32, 0x0a, 0x57, 0x51, 0x5d, 0x9e, 0x00, 0x20, 0x00, 0x00]);
  block.writeUInt32LE(address, 12);
  block.writeUInt32LE(256, 16);
  block.writeUInt32LE(number, 20);
  block.writeUInt32LE(count, 24);
  block.set([0x56, 0xff, 0x8b, 0xe4], 28);
  block.fill(byte, 32, 288);
  block.set([0x30, 0x6f, 0xb1, 0x0a], 508);
  return block;
}

/** A board whose flash was zero, with a UF2. */
function loaded(...blocks) {
  const directory = mkdtempSync(join(tmpdir(), 'uf2-'));
  const path = join(directory, 'it.uf2');
  writeFileSync(path, Buffer.concat(blocks));
  const board = new Pico();
  board.flash.bytes.fill(0);
  try {
    board.load(path);
  } finally {
    rmSync(directory, { recursive: true });
  }
  return board.flash.bytes;
}

test('a UF2 replaces the sectors of its blocks', () => {
  const flash = loaded(block(0, 2, 0x10001100, 0x11), block(1, 2, 0x10001200, 0x22));
  assert.equal(flash[0xfff], 0x00);
  assert.equal(flash[0x1000], 0xff);
  assert.equal(flash[0x1100], 0x11);
  assert.equal(flash[0x12ff], 0x22);
  assert.equal(flash[0x1300], 0xff);
  assert.equal(flash[0x1fff], 0xff);
  assert.equal(flash[0x2000], 0x00);
});

test('blocks that are none for an RP2040 with 2 MiB are refused', () => {
  const other = block(0, 1, 0x10000000, 0);
  other[28] = 0x59;
  const text = /^Error: the boot loader of an RP2040 would not take block 0 of the UF2$/;
  for (const wrong of [other, block(0, 2, 0x10000000, 0), block(0, 1, 0x10200000, 0), block(0, 1, 0x10000080, 0)]) {
    assert.throws(() => loaded(wrong), text);
  }
  assert.throws(() => loaded(block(0, 1, 0x10000000, 0), Buffer.alloc(1)), /whole blocks/);
});

test('the boot loader of the ROM ends the program', () => {
  const said = [];
  const board = new Pico({ say: (line) => said.push(line) });
  image(`
main:   movs    r0, #0x14
        ldrh    r0, [r0]
        ldr     r1, =0x4255
        movs    r2, #0x18
        ldrh    r2, [r2]
        blx     r2
        mov     r7, r0
        ldr     r0, =0x02000000
        movs    r1, #0
        blx     r7
        udf     #0
`)(board);
  board.powerOn();
  board.run(5e9);
  assert.deepEqual(said, ['boot loader 02000000']);
});
