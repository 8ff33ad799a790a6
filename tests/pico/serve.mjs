// A Pico for people: UART0 on a TCP port of this machine, at the pace of real time.
//
//   node serve.mjs <image.elf> [port]
//
// What comes from TCP is put on the line back to back at its rate, as a master's frame would be. One client at a time,
// the latest; ends when stdin ends, and so with the process that started it. Runs slower than real time, and says so,
// if the machine is too slow.

import { createServer } from 'node:net';

import { Pico } from './pico.mjs';

/** How often the board catches up with real time, in ms. */
const SLICE = 2;
/** How far it may be behind before the time lost is given up, in ms. */
const MOST_BEHIND = 100;
/** How long it may take to set its UART up, in ms of its own time. */
const LONGEST_START = 1000;

/** Characters from TCP on their way to the receive line, back to back. */
class Line {
  /** @param {Pico} board */
  constructor(board) {
    this.board = board;
    this.waiting = [];
    this.alarm = board.clock.createAlarm(() => this.arrive());
  }

  /** Puts bytes behind those under way. */
  put(bytes) {
    const isFree = !this.waiting.length;
    this.waiting.push(...bytes);
    if (isFree) this.alarm.schedule(this.board.characterNanos);
  }

  /** @private */
  arrive() {
    this.board.receive(this.waiting.shift());
    if (this.waiting.length) this.alarm.schedule(this.board.characterNanos);
  }
}

function main() {
  const [image, port = '0', ...rest] = process.argv.slice(2);
  if (!image || rest.length || !/^\d+$/.test(port)) throw new Error('usage: node serve.mjs <image.elf> [port]');

  let client = null;
  const said = (line) => /^(error|warning|reset|unheard)/.test(line) && console.error(`pico: ${line}`);
  const board = new Pico({ say: said, sent: (byte) => client?.write(Uint8Array.of(byte)) });
  board.load(image);
  board.powerOn();
  startUp(board);
  const line = new Line(board);

  const server = createServer((socket) => {
    client?.destroy();
    client = socket;
    socket.setNoDelay(true);
    socket.on('data', (bytes) => line.put(bytes));
    socket.on('error', () => {});
    socket.on('close', () => {
      if (client === socket) client = null;
    });
  });
  server.on('error', (error) => {
    console.error(`error: cannot listen on port ${port}: ${error.message}`);
    process.exit(1);
  });
  server.listen(Number(port), '127.0.0.1', () => {
    const kind = image.split('/').at(-1);
    console.log(`pico: ${kind} on 127.0.0.1:${server.address().port}`);
  });
  process.stdin.on('end', () => process.exit(0)).resume();

  keepPace(board);
}

/** Runs the board until its UART has a rate, and a little more, so that the first frame does not come too early. */
function startUp(board) {
  while (!board.characterNanos && board.clock.nanos < LONGEST_START * 1e6) board.run(board.clock.nanos + 1e6);
  board.run(board.clock.nanos + 1e6);
}

/** Lets the board's time follow real time for ever. */
function keepPace(board) {
  let zero = performance.now() - board.clock.nanos / 1e6;
  let wasSlow = false;
  setInterval(() => {
    const behind = performance.now() - zero - board.clock.nanos / 1e6;
    if (behind > MOST_BEHIND) {
      if (!wasSlow) console.error('pico: this machine is too slow for real time; the board runs slower');
      wasSlow = true;
      zero += behind - SLICE;
    }
    board.run(board.clock.nanos + Math.min(behind, 10 * SLICE) * 1e6);
  }, SLICE);
}

try {
  main();
} catch (error) {
  console.error(`error: ${error.message}`);
  process.exitCode = 1;
}
