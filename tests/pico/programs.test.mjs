// The programs as people and other tests start them.

import assert from 'node:assert/strict';
import { spawn, spawnSync } from 'node:child_process';
import { once } from 'node:events';
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { connect } from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, test } from 'node:test';

import { ECHO, elf } from './images.mjs';

const here = import.meta.dirname;
const directory = mkdtempSync(join(tmpdir(), 'pico-'));
const image = join(directory, 'echo');
writeFileSync(image, elf(ECHO));
after(() => rmSync(directory, { recursive: true }));

const play = (args, input) =>
  spawnSync(process.execPath, [join(here, 'play.mjs'), ...args], { input, encoding: 'utf8' });

test('play reads and writes the flash of a file', () => {
  const file = join(directory, 'flash');
  const script = '500 rx 41\n1000 end\n';
  const first = play([image, '--flash', file, '--stack', '0x2003f000', '0x20040000'], script);
  assert.equal(first.stderr, '');
  assert.match(first.stdout, /^\d+ tx 41\n/);
  assert.match(first.stdout, /\nstat stack 40 of 4096\n$/);
  const flash = readFileSync(file);
  assert.equal(flash.length, 2 * 1024 * 1024);
  flash[0x1fffff] = 0x12;
  writeFileSync(file, flash);
  assert.equal(play([image, '--flash', file], script).status, 0);
  assert.equal(readFileSync(file)[0x1fffff], 0x12);
});

test('play plays many scripts as it plays each', () => {
  const scripts = ['500 rx 41\n1000 end\n', '500 rx 42 43\n# no end\n3000 end\n', '500 rx 41\n1000 end\n'];
  const alone = scripts.map((script) => play([image], script).stdout);
  assert.match(alone[1], /^\d+ tx 42\n\d+ tx 43\n/);
  const many = play(['--many'], scripts.map((script) => `${image}\n${script}`).join(''));
  assert.equal(many.stderr, '');
  assert.equal(many.stdout, alone.map((output) => `${output}.\n`).join(''));
});

test('play says in one line what is wrong', () => {
  const refused = (args, input) => {
    const { status, stdout, stderr } = play(args, input);
    assert.equal(status, 1);
    assert.equal(stdout, '');
    return stderr;
  };
  assert.match(refused([], ''), /^error: usage: node play.mjs .*\n$/);
  assert.match(refused([join(here, 'package.json')], '1 end'), /^error: .*package.json is no ELF file for ARM\n$/);
  assert.match(refused([image, '--stack', '1'], '1 end'), /^error: usage/);
  assert.equal(refused(['--many'], `${image}\n1 pin 5 low\n`), 'error: the last script has no end\n');
  assert.match(refused(['--many'], `${image}\t--stack\t1\n1 end\n`), /^error: usage/);
});

test('serve puts UART0 on a port, for one client after the other, until stdin ends', async () => {
  const server = spawn(process.execPath, [join(here, 'serve.mjs'), image], { stdio: ['pipe', 'pipe', 'inherit'] });
  server.stdout.setEncoding('utf8');
  let line = '';
  while (!line.endsWith('\n')) line += (await once(server.stdout, 'data'))[0];
  const port = Number(/^pico: echo on 127\.0\.0\.1:(\d+)\n$/.exec(line)?.[1]);
  for (const frame of ['hello', 'again']) {
    const socket = connect(port, '127.0.0.1');
    await once(socket, 'connect');
    socket.write(frame);
    let answer = '';
    while (answer.length < frame.length) answer += (await once(socket, 'data'))[0].toString();
    assert.equal(answer, frame);
    socket.destroy();
    await once(socket, 'close');
  }
  server.stdin.end();
  const [code] = await once(server, 'exit');
  assert.equal(code, 0);
});
