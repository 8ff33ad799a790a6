// A computer at the Pico's USB cable: a host of full speed with a driver for serial ports (CDC-ACM), which does what
// Linux does. Sections cited are those of USB 2.0, and of the PSTN subclass 1.2.
//
// Everything the host does is a transaction: a token, data and an answer, which take the time of their bits on the bus. A
// frame of 1 ms begins with a start of frame and has room for up to 19 transactions of 64 bytes. What waits takes its turn.

/** ns of a byte on the bus. */
const BYTE = 8e9 / 12e6;
/** Bytes of a transaction beside its data: token, packet number, checks, answer and the gaps (5.8.4). */
const AROUND = 13;
/** Greatest size of a packet. */
const PACKET = 64;
const FRAME = 1e6;
/** Part of a frame in which transactions may run. */
const USABLE = FRAME - 20 * BYTE;
/** ns until the host asks an endpoint again that had nothing. */
const PAUSE = 125_000;
const MS = 1e6;
/** ns from plugging in to the first reset, of a reset, and after it until the first packet (7.1.7.3, 7.1.7.5). */
const DEBOUNCE = 100 * MS;
const RESET = 10 * MS;
const RECOVERY = 10 * MS;
/** ns after SET_ADDRESS (9.2.6.3), and of the signal that wakes a device (7.1.7.7). */
const SETTLE = 2 * MS;
const WAKE = 20 * MS;
/** ns after which a control transfer has failed (9.2.6.4). */
const PATIENCE = 5000 * MS;
/** How often a transaction, and an enumeration, is tried. */
const TRIES = 3;

const REQUEST = { clearFeature: 1, setAddress: 5, getDescriptor: 6, setConfiguration: 9 };
const DESCRIPTOR = { device: 1, configuration: 2, string: 3, interface: 4, endpoint: 5, qualifier: 6, association: 11, bos: 15 };
const ENGLISH = 0x409;
/** Requests of a serial port (PSTN 6.3). */
const PORT = { setCoding: 0x20, getCoding: 0x21, setState: 0x22 };
/** DTR and RTS, as Linux sets them when a program opens a port. */
const OPEN = 3;

/** Requests that no device may fall over. Most are to be refused; none may change what the ports do. */
const GARBAGE = [
  'c0 01 00 00 00 00 40 00', // of no vendor
  '40 01 00 00 00 00 08 00 + 01 02 03 04 05 06 07 08',
  'a1 21 00 00 63 00 07 00', // line coding of an interface that is not there
  '21 22 03 00 63 00 00 00',
  '21 20 00 00 00 00 03 00 + 80 25 00', // a line coding that is too short
  '21 20 00 00 00 00 2c 01 + *300', // and one that is longer than any buffer
  '21 23 ff ff 00 00 00 00', // a break
  '80 06 63 03 09 04 ff 00', // a string that is not there
  '80 06 00 63 00 00 ff ff', // a descriptor that is not there
  '80 06 00 02 00 00 00 00', // a descriptor of no length
  '00 09 63 00 00 00 00 00', // a configuration that is not there
  '02 01 00 00 7f 00 00 00', // ends the halt of an endpoint that is not there
  '02 03 00 00 8f 00 00 00', // halts an endpoint that is not there
  '82 00 00 00 7f 00 02 00', // its status
  '01 0b 63 00 63 00 00 00', // an interface that is not there
  'ff ff ff ff ff ff ff ff',
  '00 00 00 00 00 00 00 00',
];

/** The computer. Its time is that of the board. */
export class UsbHost {
  /**
   * @param {object} board its `clock` and its `chip` are used
   * @param {object} tell
   * @param {(line: string) => void} tell.say told what happens: `configured`, `product drivetwin`, …
   * @param {(port: string, bytes: Uint8Array) => void} tell.received told each packet of a port
   */
  constructor(board, { say, received }) {
    this.board = board;
    this.clock = board.clock;
    this.say = say;
    this.received = received;
    this.alarm = this.clock.createAlarm(() => this.step());
    this.timer = this.clock.createAlarm(() => this.advance());
    this.isPlugged = false;
    this.frame = 0;
    this.forget();
  }

  /** The ports of the configured device by their names, `bus` and `control`; empty if there is none. */
  ports = {};

  /** Connects the cable. */
  plug() {
    if (this.isPlugged) return;
    this.isPlugged = true;
    this.begunAt = -Infinity;
    this.alarm.schedule(0);
  }

  /** Disconnects it, in the middle of whatever is under way. */
  unplug() {
    this.isPlugged = false;
    this.forget();
    this.alarm.cancel();
  }

  /** Resets the device and configures it again. */
  reset() {
    if (this.device) this.start(this.device, this.enumerate());
  }

  /** Stops the frames, so that the device is suspended 3 ms later. */
  suspend() {
    this.isSuspended = true;
  }

  /** Wakes the device, and goes on with what was under way. */
  resume() {
    if (!this.isSuspended) return;
    this.isSuspended = false;
    this.device?.resume();
    this.begunAt = -Infinity;
    this.alarm.schedule(WAKE);
  }

  /** Sends bytes to a port. */
  send(name, bytes) {
    this.port(name)?.output.put(bytes);
  }

  /** A program opens a port: the host takes what the port sends, and asserts DTR. */
  open(name) {
    const port = this.port(name);
    if (!port) return;
    port.input.isWanted = true;
    // A program writes when the port is open, and not before.
    port.output.isHeld = true;
    this.request(port, PORT.setState, OPEN, undefined, () => (port.output.isHeld = false));
  }

  /** The program, which has the port open, switches DTR. */
  dtr(name, isOn) {
    const port = this.port(name);
    if (port) this.request(port, PORT.setState, isOn ? OPEN : OPEN & ~1);
  }

  /** The program closes it. */
  close(name) {
    const port = this.port(name);
    if (!port) return;
    port.input.isWanted = false;
    this.request(port, PORT.setState, 0);
  }

  /**
   * Sets the line of the port `bus`, and says what the device says about it then.
   *
   * @param {number} baud bits per second
   * @param {string} format data bits, parity and stop bits, e.g. `8E1`
   */
  line(baud, format) {
    const port = this.port('bus');
    if (!port) return;
    this.request(port, PORT.setCoding, 0, coding(baud, format));
    this.control.queue({
      setup: setup(0xa1, PORT.getCoding, 0, port.control, 7),
      done: (reply) => this.say(reply?.length === 7 ? `line ${text(reply)}` : `refused ${PORT.getCoding.toString(16)}`),
    });
  }

  /** Ends a halt of a port's endpoints, as drivers do to begin anew: the numbers of packets begin with DATA0 (9.4.5). */
  clear(name) {
    const port = this.port(name);
    if (!port) return;
    for (const [pipe, direction] of [[port.input, 0x80], [port.output, 0]]) {
      this.control.queue({
        setup: setup(2, REQUEST.clearFeature, 0, pipe.endpoint | direction, 0),
        done: (reply) => (reply ? (pipe.number = 0) : this.say(`refused to clear endpoint ${pipe.endpoint}`)),
      });
    }
  }

  /** Sends requests that make no sense, and says which of them the device refuses. */
  garbage() {
    for (const text of GARBAGE) {
      const [setup, data = ''] = text.split(' + ');
      const many = /^\*(\d+)$/.exec(data);
      this.control.queue({
        setup: bytesOf(setup),
        data: many ? new Uint8Array(Number(many[1])) : bytesOf(data),
        done: (reply) => this.say(`${setup}: ${reply ? `${reply.length} bytes` : 'refused'}`),
      });
    }
    this.hurry();
  }

  /** @private Forgets the device and everything that was under way. */
  forget() {
    this.flight?.end(false);
    this.flight = null;
    this.process = null;
    this.timer.cancel();
    this.isSuspended = false;
    this.isQuiet = true;
    this.device = null;
    this.address = 0;
    this.control = new Control(this);
    this.ports = {};
    this.pipes = [this.control];
  }

  /** @private Begins to configure a device; whatever was under way is forgotten. */
  start(device, process) {
    this.forget();
    this.device = device;
    this.process = process;
    this.advance();
    this.hurry();
  }

  /** @private Notices that a device has come or gone. */
  look() {
    const usb = this.board.chip?.usbCtrl;
    const seen = usb?.isAttached ? usb : null;
    if (this.device && seen !== this.device) {
      this.forget();
      this.say('gone');
    }
    if (!this.device && seen) this.start(seen, this.enumerate(DEBOUNCE));
  }

  /** @private Goes on with the process until it waits for a time or a control transfer. */
  advance(value) {
    const { process } = this;
    const { value: wanted, done } = process.next(value);
    if (done) {
      if (this.process === process) this.process = null;
      return;
    }
    if (wanted.wait !== undefined) {
      this.timer.schedule(wanted.wait);
      return;
    }
    this.control.queue({ ...wanted, done: (reply) => this.process === process && this.advance(reply) });
    this.hurry();
  }

  /** @private What Linux does with a new device. */
  *enumerate(debounce = 0) {
    if (debounce) yield { wait: debounce };
    for (let tries = 0; tries < TRIES; tries++) {
      this.isQuiet = true;
      this.address = 0;
      this.device.reset();
      yield { wait: RESET };
      this.isQuiet = false;
      yield { wait: RECOVERY };
      const problem = yield* this.configure();
      if (!problem) return;
      this.say(`failed ${problem}`);
      yield { wait: DEBOUNCE };
    }
    this.say('unusable');
  }

  /** @private Returns what went wrong, if anything did. */
  *configure() {
    const get = (type, index, length, language = 0) => ({
      setup: setup(0x80, REQUEST.getDescriptor, (type << 8) | index, language, length),
    });
    const set = (request, value) => ({ setup: setup(0, request, value, 0, 0) });

    const first = yield get(DESCRIPTOR.device, 0, 8);
    if (first?.length !== 8 || first[7] !== PACKET) return 'the first 8 bytes of the device descriptor';
    this.lastAddress = ((this.lastAddress ?? 0) % 127) + 1;
    if (!(yield set(REQUEST.setAddress, this.lastAddress))) return 'to set the address';
    this.address = this.lastAddress;
    yield { wait: SETTLE };
    const device = yield get(DESCRIPTOR.device, 0, 18);
    if (device?.length !== 18 || device[0] !== 18) return 'the device descriptor';
    const word = (bytes, at) => bytes[at] | (bytes[at + 1] << 8);
    if (word(device, 2) > 0x200) {
      const head = yield get(DESCRIPTOR.bos, 0, 5);
      const bos = head && (yield get(DESCRIPTOR.bos, 0, word(head, 2)));
      if (!bos || bos.length !== word(head, 2)) return 'the BOS descriptor';
    }
    if (yield get(DESCRIPTOR.qualifier, 0, 10)) return 'it says that it has a high speed';
    const head = yield get(DESCRIPTOR.configuration, 0, 9);
    const configuration = head?.length === 9 && (yield get(DESCRIPTOR.configuration, 0, word(head, 2)));
    if (!configuration || configuration.length !== word(head, 2)) return 'the configuration descriptor';
    const languages = yield get(DESCRIPTOR.string, 0, 255);
    if (!languages || word(languages, 2) !== ENGLISH) return 'the languages';
    const hex = (number) => number.toString(16).padStart(4, '0');
    this.say(`device ${hex(word(device, 8))}:${hex(word(device, 10))}`);
    for (const [what, at] of [['manufacturer', 14], ['product', 15], ['serial', 16]]) {
      const name = yield* this.text(get, device[at]);
      if (name === null) return `the string of the ${what}`;
      this.say(`${what} ${name}`);
    }
    if (!(yield set(REQUEST.setConfiguration, configuration[5]))) return 'to set the configuration';

    const functions = parse(configuration);
    if (typeof functions === 'string') return functions;
    for (const { control, index, input, output, interrupt } of functions) {
      const name = yield* this.text(get, index);
      if (!name) return 'the name of a function';
      this.say(`function ${name}`);
      const short = name.split(' ').at(-1);
      const port = { control, input: new Input(this, short, input), output: new Output(this, output) };
      const notifications = new Input(this, `notifications of ${short}`, interrupt);
      notifications.isWanted = true;
      notifications.pause = 128 * FRAME;
      this.ports[short] = port;
      this.pipes.push(port.input, port.output, notifications);
      for (const [request, value, data] of [[PORT.setState, 0], [PORT.setCoding, 0, coding(9600, '8N1')]]) {
        if (!(yield { setup: setup(0x21, request, value, control, data?.length ?? 0), data })) return `port ${short}`;
      }
    }
    this.say('configured');
    return null;
  }

  /** @private The string of an index; empty if there is none, `null` if it is wrong. */
  *text(get, index) {
    if (!index) return '';
    const bytes = yield get(DESCRIPTOR.string, index, 255, ENGLISH);
    if (!bytes || bytes[0] !== bytes.length || bytes[1] !== DESCRIPTOR.string) return null;
    return Buffer.from(bytes.subarray(2)).toString('utf16le');
  }

  /** @private A port of the configured device. */
  port(name) {
    const port = this.ports[name];
    if (!port) this.say('not configured');
    else this.hurry();
    return port;
  }

  /** @private A request to a port. */
  request(port, request, value, data, then = () => {}) {
    this.control.queue({
      setup: setup(0x21, request, value, port.control, data?.length ?? 0),
      data,
      done: (reply) => {
        if (!reply) this.say(`refused ${request.toString(16)}`);
        then();
      },
    });
    this.hurry();
  }

  /** @private There is something new to do: looks for it at the next possible instant. */
  hurry() {
    if (this.isPlugged && !this.flight && !this.isSuspended) this.alarm.schedule(0);
  }

  /** @private The bus is free, or a frame is over: does what comes next. */
  step() {
    const { clock, flight } = this;
    const now = clock.nanos;
    this.flight = null;
    flight?.end(true);
    if (!this.isPlugged || this.isSuspended) return;
    if (now >= this.begunAt + FRAME) {
      this.begunAt = now;
      this.frame = (this.frame + 1) & 0x7ff;
      this.look();
      if (!this.isQuiet) this.device.startOfFrame(this.frame);
    }
    let next = this.begunAt + FRAME;
    const turns = this.isQuiet ? 0 : this.pipes.length;
    for (let turn = 0; turn < turns; turn++) {
      const pipe = this.pipes[turn];
      const { bytes, at } = pipe.wish;
      if (at > now) {
        next = Math.min(next, at);
        continue;
      }
      if (now + (bytes + AROUND) * BYTE > this.begunAt + USABLE) continue;
      this.pipes.push(...this.pipes.splice(turn, 1));
      this.flight = pipe.begin();
      next = now + (this.flight.bytes + AROUND) * BYTE;
      break;
    }
    this.alarm.schedule(next - now);
  }
}

/** Control transfers, one after the other (8.5.3). */
class Control {
  constructor(host) {
    this.host = host;
    this.waiting = [];
    this.at = 0;
  }

  /** Adds `{setup, data, done}`; `done` is told the bytes of the answer, or `null` if the device refused or failed. */
  queue(transfer) {
    this.waiting.push({ data: new Uint8Array(0), ...transfer });
  }

  get wish() {
    const { at } = this;
    if (!this.waiting.length) return { bytes: 0, at: Infinity };
    return { bytes: PACKET, at };
  }

  begin() {
    const { host } = this;
    const transfer = (this.transfer = this.waiting[0]);
    transfer.until ??= host.clock.nanos + PATIENCE;
    const { setup: packet, data } = transfer;
    const isIn = Boolean(packet[0] & 0x80);
    const length = packet[6] | (packet[7] << 8);
    if (!transfer.stage) {
      const end = (whole) => {
        if (!whole) return;
        if (!host.device.setup(host.address, packet)) this.retry();
        else Object.assign(transfer, { stage: length ? 'data' : 'status', number: 1, sent: 0, answer: [] });
      };
      return { bytes: 8, end };
    }
    if (transfer.stage === 'data' && isIn) {
      return this.input((bytes) => {
        transfer.answer.push(...bytes);
        if (transfer.answer.length > length) this.complain('more bytes than were asked for');
        if (bytes.length < PACKET || transfer.answer.length >= length) transfer.stage = 'status';
      });
    }
    if (transfer.stage === 'data') {
      return this.output(data.subarray(transfer.sent, transfer.sent + PACKET), (bytes) => {
        transfer.sent += bytes.length;
        if (transfer.sent >= data.length) transfer.stage = 'status';
      });
    }
    transfer.number = 1;
    if (isIn && length) return this.output(new Uint8Array(0), () => this.finish(Uint8Array.from(transfer.answer)));
    return this.input((bytes) => {
      if (bytes.length) this.complain('a status with data');
      this.finish(new Uint8Array(0));
    });
  }

  /** @private A transaction that takes a packet. */
  input(take) {
    const { host, transfer } = this;
    const reply = host.device.input(host.address, 0);
    if (!reply?.end) return { bytes: 0, end: (whole) => whole && this.refused(reply) };
    const end = (whole) => {
      reply.end(whole);
      if (!whole) return;
      if (reply.data !== transfer.number) {
        this.complain(`DATA${reply.data} instead of DATA${transfer.number}`);
        return;
      }
      transfer.number ^= 1;
      take(reply.bytes);
    };
    return { bytes: reply.bytes.length, end };
  }

  /** @private A transaction that gives a packet. */
  output(bytes, gone) {
    const { host, transfer } = this;
    const reply = host.device.output(host.address, 0, transfer.number, bytes);
    if (!reply?.end) return { bytes: bytes.length, end: (whole) => whole && this.refused(reply) };
    const end = (whole) => {
      const answer = reply.end(whole);
      if (!whole) return;
      if (answer !== 'ack') this.retry();
      else {
        transfer.number ^= 1;
        gone(bytes);
      }
    };
    return { bytes: bytes.length, end };
  }

  /** @private */
  refused(reply) {
    const { transfer } = this;
    if (reply === 'stall') this.finish(null);
    else if (reply === null) this.retry();
    else if (this.host.clock.nanos > transfer.until) this.finish(null);
    else this.at = this.host.clock.nanos + PAUSE;
  }

  /** @private Nobody answered. */
  retry() {
    this.at = this.host.clock.nanos + PAUSE;
    this.transfer.tries = (this.transfer.tries ?? 0) + 1;
    if (this.transfer.tries >= TRIES) this.finish(null);
  }

  /** @private */
  finish(answer) {
    if (this.waiting[0] === this.transfer) this.waiting.shift();
    this.at = 0;
    this.transfer.done?.(answer);
  }

  /** @private */
  complain(what) {
    this.host.board.say(`error usb: endpoint 0: ${what}`);
  }
}

/** Packets from an endpoint. */
class Input {
  constructor(host, name, { endpoint, size }) {
    Object.assign(this, { host, name, endpoint, size });
    this.number = 0;
    this.at = 0;
    this.pause = PAUSE;
    /** Whether the host asks for packets. */
    this.isWanted = false;
  }

  get wish() {
    return { bytes: this.size, at: this.isWanted ? this.at : Infinity };
  }

  begin() {
    const { host } = this;
    const reply = host.device.input(host.address, this.endpoint);
    if (!reply?.end) {
      if (reply === null) host.board.say(`error usb: endpoint ${this.endpoint} does not answer`);
      this.at = host.clock.nanos + this.pause;
      return { bytes: 0, end: () => {} };
    }
    const end = (whole) => {
      reply.end(whole);
      if (!whole) return;
      const { bytes, data } = reply;
      if (bytes.length > this.size) host.board.say(`error usb: endpoint ${this.endpoint} sent ${bytes.length} bytes`);
      if (data !== this.number) host.board.say(`error usb: endpoint ${this.endpoint} sent DATA${data} twice`);
      else if (this.isWanted && bytes.length) host.received(this.name, bytes);
      this.number = data ^ 1;
    };
    return { bytes: reply.bytes.length, end };
  }
}

/** Packets to an endpoint. */
class Output {
  constructor(host, { endpoint, size }) {
    Object.assign(this, { host, endpoint, size });
    this.number = 0;
    this.at = 0;
    this.waiting = [];
    /** Whether the bytes wait until the port is open. */
    this.isHeld = false;
  }

  /** Adds bytes behind those that wait. */
  put(bytes) {
    this.waiting.push(...bytes);
  }

  get wish() {
    const count = this.isHeld ? 0 : Math.min(this.waiting.length, this.size);
    return { bytes: count, at: count ? this.at : Infinity };
  }

  begin() {
    const { host } = this;
    const bytes = Uint8Array.from(this.waiting.slice(0, this.size));
    const reply = host.device.output(host.address, this.endpoint, this.number, bytes);
    if (!reply?.end) {
      if (reply !== 'nak') host.board.say(`error usb: endpoint ${this.endpoint} answers ${reply}`);
      this.at = host.clock.nanos + PAUSE;
      return { bytes: bytes.length, end: () => {} };
    }
    const end = (whole) => {
      if (reply.end(whole) !== 'ack') return;
      this.number ^= 1;
      this.waiting.splice(0, bytes.length);
    };
    return { bytes: bytes.length, end };
  }
}

/** The bytes that hexadecimal digits mean. */
function bytesOf(text) {
  return Uint8Array.from(text.split(' ').filter(Boolean), (byte) => parseInt(byte, 16));
}

/** A setup packet (9.3). */
function setup(type, request, value, index, length) {
  const packet = new Uint8Array(8);
  packet.set([type, request]);
  const view = new DataView(packet.buffer);
  [value, index, length].forEach((word, place) => view.setUint16(2 + 2 * place, word, true));
  return packet;
}

/** The settings of a line (PSTN 6.3.11). */
export function coding(baud, format) {
  const [, data, parity, stop] = /^([5-8])([NOEMS])(1|1\.5|2)$/.exec(format) ?? [];
  if (!data) throw new Error(`\`${format}\` is no format like \`8E1\``);
  const bytes = new Uint8Array(7);
  new DataView(bytes.buffer).setUint32(0, baud, true);
  bytes.set([['1', '1.5', '2'].indexOf(stop), 'NOEMS'.indexOf(parity), Number(data)], 4);
  return bytes;
}

/** The settings in words. */
function text(bytes) {
  const baud = new DataView(bytes.buffer, bytes.byteOffset).getUint32(0, true);
  return `${baud} ${bytes[6]}${'NOEMS'[bytes[5]]}${['1', '1.5', '2'][bytes[4]]}`;
}

/** The serial ports in a configuration descriptor, or what is wrong with it. */
function parse(configuration) {
  const functions = [];
  let latest;
  let isData = false;
  for (let at = 0; at < configuration.length; at += configuration[at]) {
    const [length, type, ...rest] = configuration.subarray(at, at + configuration[at]);
    if (length < 2 || at + length > configuration.length) return `a descriptor of ${length} bytes at ${at}`;
    if (type === DESCRIPTOR.association) {
      const [control, interfaces, kind, subclass] = rest;
      if (interfaces !== 2 || kind !== 2 || subclass !== 2) return 'a function that is no serial port';
      functions.push((latest = { control, index: 0 }));
    } else if (type === DESCRIPTOR.interface) {
      if (!latest) return 'an interface of no function';
      const [number, , , kind] = rest;
      isData = kind === 10;
      if (number !== latest.control + (isData ? 1 : 0)) return `interface ${number}`;
      if (!isData) latest.index = rest[6];
    } else if (type === DESCRIPTOR.endpoint) {
      const [address, kind, low, high] = rest;
      const place = { endpoint: address & 0xf, size: low | (high << 8) };
      if (place.size > PACKET || (kind === 2) !== isData) return `endpoint ${address}`;
      if (!isData) latest.interrupt = place;
      else if (address & 0x80) latest.input = place;
      else latest.output = place;
    }
  }
  if (functions.some(({ input, output, interrupt }) => !(input && output && interrupt))) return 'a port without endpoints';
  return functions;
}
