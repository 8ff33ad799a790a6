// A Pico for people: UART0 on a TCP port of this machine, at the pace of real time.
//
//   node serve.mjs <image.elf> [port] [--usb]
//
// What comes from TCP is put on the line back to back at its rate, as a master's frame would be. One client at a time,
// the latest; ends when stdin ends, and so with the process that started it. Runs slower than real time, and says so,
// if the machine is too slow. A line on stdin is an event of script.mjs without its time, like `power off`, `power on` or
// `usb unplug`, and happens at once.
//
// --usb  connects a computer to the USB cable. When it has configured the device, one line says where the ports are:
//
//          pico: usb E661A4D4172F8B2C: bus rfc2217://127.0.0.1:41001, control 127.0.0.1:41002
//
//        `bus` is a serial port over Telnet (RFC 2217): the client sets baud rate, format and DTR. `control` is raw bytes.
//        A connection opens its port, and asserts DTR; its end closes the port.

import { createServer } from 'node:net';
import { createInterface } from 'node:readline';
import { parseArgs } from 'node:util';

import { Pico } from './pico.mjs';
import { ComPort } from './rfc2217.mjs';
import { readAction } from './script.mjs';

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

/** The ports of the USB cable on TCP, each with one client at a time, the latest. */
class Cable {
  /** @param {Pico} board */
  constructor(board) {
    this.board = board;
    this.clients = {};
    this.addresses = {};
    this.serial = '';
  }

  /** Handles what the computer says. */
  said(line) {
    const [what, ...words] = line.split(' ');
    if (what === 'serial') [this.serial] = words;
    // A device that comes again has forgotten its settings.
    if (line === 'configured') {
      if (Object.keys(this.addresses).length) Object.values(this.clients).forEach((client) => client.open());
      else this.listen();
    }
    if (what === 'failed' || what === 'gone') console.error(`pico: usb ${line}`);
    if (what === 'unusable') {
      console.error('error: the computer cannot use the USB device');
      process.exit(1);
    }
  }

  /** Gives a client what its port sends. */
  received(name, bytes) {
    this.clients[name]?.write(bytes);
  }

  /** @private */
  async listen() {
    const serve = (name, connect) => {
      const server = createServer((socket) => {
        this.clients[name]?.socket.destroy();
        const client = connect(socket);
        this.clients[name] = client;
        client.open();
        socket.setNoDelay(true);
        socket.on('error', () => {});
        socket.on('close', () => {
          if (this.clients[name] !== client) return;
          delete this.clients[name];
          this.board.usb.close(name);
        });
      });
      return new Promise((done) => {
        server.listen(0, '127.0.0.1', () => done(`127.0.0.1:${server.address().port}`));
      });
    };
    this.addresses = {
      bus: await serve('bus', (socket) => this.comPort(socket)),
      control: await serve('control', (socket) => this.raw(socket)),
    };
    const { bus, control } = this.addresses;
    console.log(`pico: usb ${this.serial}: bus rfc2217://${bus}, control ${control}`);
  }

  /** @private */
  raw(socket) {
    const { usb } = this.board;
    socket.on('data', (bytes) => usb.send('control', bytes));
    return { socket, open: () => usb.open('control'), write: (bytes) => socket.write(bytes) };
  }

  /** @private */
  comPort(socket) {
    const { usb } = this.board;
    let settings = null;
    const port = new ComPort({
      send: (bytes) => socket.write(bytes),
      data: (bytes) => usb.send('bus', bytes),
      dtr: (isOn) => usb.dtr('bus', isOn),
      line: (...line) => {
        settings = line;
        usb.line(...line);
      },
    });
    socket.on('data', (bytes) => port.take(bytes));
    const open = () => {
      usb.open('bus');
      if (settings) usb.line(...settings);
      if (!port.isDtrOn) usb.dtr('bus', false);
    };
    return { socket, open, write: (bytes) => port.write(bytes) };
  }
}

function main() {
  const { values, positionals } = parseArgs({ allowPositionals: true, options: { usb: { type: 'boolean' } } });
  const [image, port = '0', ...rest] = positionals;
  if (!image || rest.length || !/^\d+$/.test(port)) throw new Error('usage: node serve.mjs <image.elf> [port] [--usb]');

  let client = null;
  let cable = null;
  const said = (line) => {
    if (line.startsWith('usb ')) cable?.said(line.slice('usb '.length));
    else if (/^(error|warning|reset|unheard)/.test(line)) console.error(`pico: ${line}`);
  };
  const sent = (byte) => client?.write(Uint8Array.of(byte));
  const board = new Pico({ say: said, sent, received: (name, bytes) => cable?.received(name, bytes) });
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
    if (!values.usb) return;
    cable = new Cable(board);
    board.usb.plug();
  });
  const world = createInterface({ input: process.stdin });
  world.on('line', (text) => happen(board, text)).on('close', () => process.exit(0));

  keepPace(board);
}

/** Lets an event happen that a line of text is. */
function happen(board, text) {
  const words = text.trim().split(/\s+/);
  if (!words[0]) return;
  try {
    readAction(words)(board, board.clock.nanos);
  } catch (error) {
    console.error(`error: ${error.message}`);
  }
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
