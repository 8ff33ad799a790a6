// Commands to the flash past its window (RP2040 datasheet 4.10).

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { AT_125_MHZ, image } from './images.mjs';
import { Pico } from './pico.mjs';

/** Statements that select the flash by the override of its pin. */
const SELECT = `
        ldr     r1, =0x40018000
        ldr     r0, =0x200
        str     r0, [r1, #12]
`;

function run(source, before = () => {}) {
  const said = [];
  const board = new Pico({ say: (line) => said.push(line) });
  image(source)(board);
  board.powerOn();
  before(board);
  board.run(1e6);
  return { board, said };
}

test('a command while the window is open is a mistake', () => {
  const { said } = run(`
main:   ${AT_125_MHZ} ${SELECT}
        ldr     r1, =0x18000000
        movs    r0, #0x4b
        str     r0, [r1, #0x60]
stop:   b       stop
`);
  assert.match(said[0], /^error a command to the flash while it is read or busy/);
});

test('the flash knows its unique number and no other command (W25Q16JV 8.2.31)', () => {
  const { board, said } = run('main:   wfi');
  const { chip } = board;
  chip.hung = false;
  chip.xip = false;
  const [select, ssi] = [chip.peripherals[0x40018], chip.peripherals[0x18000]];
  const exchange = (bytes) => {
    select.writeUint32Atomic(12, 0x200, 0);
    const answer = bytes.map((byte) => {
      assert.equal(ssi.readUint32(0x28) & 8, 0, 'nothing is received before something is sent');
      ssi.writeUint32(0x60, byte);
      assert.equal(ssi.readUint32(0x28) & 8, 8);
      return ssi.readUint32(0x60);
    });
    select.writeUint32Atomic(12, 0x300, 0);
    return answer;
  };
  const answer = exchange([0x4b, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
  assert.deepEqual(answer.slice(5), [0xe6, 0x61, 0xa4, 0xd4, 0x17, 0x2f, 0x8b, 0x2c]);
  exchange([0x9f]);
  assert.match(said.at(-1), /^error the flash knows no command 9f here/);
});
