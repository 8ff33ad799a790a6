// The computer at the USB cable, by what USB 2.0 says, with a device that is right and one that is not.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { Clock } from './clock.mjs';
import { UsbHost, coding } from './usb.mjs';

const MS = 1e6;
const u16 = (word) => [word & 0xff, word >> 8];
const association = (first, name) => [8, 11, first, 2, 2, 2, 0, name];
const interfaceOf = (number, endpoints, kind, name) => [9, 4, number, 0, endpoints, kind, kind === 2 ? 2 : 0, 0, name];
const endpoint = (address, kind, size) => [7, 5, address, kind, ...u16(size), 1];
const port = (first, name, notify, data) => [
  ...association(first, name), ...interfaceOf(first, 1, 2, name), ...endpoint(0x80 | notify, 3, 8),
  ...interfaceOf(first + 1, 2, 10, 0), ...endpoint(0x80 | data, 2, 64), ...endpoint(data, 2, 64),
];
const PORTS = [...port(0, 4, 1, 2), ...port(2, 5, 3, 4)];
const DESCRIPTORS = {
  0x100: [18, 1, ...u16(0x200), 0xef, 2, 1, 64, ...u16(0x1209), ...u16(1), ...u16(0x10), 1, 2, 3, 1],
  0x200: [9, 2, ...u16(9 + PORTS.length), 4, 1, 0, 0x80, 50, ...PORTS],
  0x300: [4, 3, 9, 4],
};
['maker', 'thing', '0123', 'drivetwin bus', 'drivetwin control'].forEach((name, index) => {
  const text = [...Buffer.from(name, 'utf16le')];
  DESCRIPTORS[0x301 + index] = [2 + text.length, 3, ...text];
});

/** A device that answers at once. */
class Device {
  constructor() {
    Object.assign(this, { isAttached: true, address: 0, requests: [], numbers: {}, frames: [], resets: 0, wakes: 0 });
    /** Packets for the computer, by endpoint, and those from it. */
    this.waiting = {};
    this.got = {};
    this.pulls = 0;
  }

  setup(address, packet) {
    if (address !== this.address) return null;
    const [type, request, value, , , , length] = packet;
    this.requests.push(Buffer.from(packet).toString('hex'));
    this.numbers = { ...this.numbers, in0: 1, out0: 1 };
    const word = value | (packet[3] << 8);
    this.next = () => {};
    this.answer = type & 0x80 ? (DESCRIPTORS[word] ?? (type === 0xa1 ? [...this.line] : null)) : [];
    if (type & 0x80 && this.answer) this.answer = this.answer.slice(0, length | (packet[7] << 8));
    if (request === 5) this.next = () => (this.address = word);
    this.isStalled = this.answer === null;
    return 'ack';
  }

  input(address, number) {
    if (address !== this.address) return null;
    if (!number) {
      if (this.isStalled) return 'stall';
      const bytes = Uint8Array.from(this.answer.splice(0, 64));
      return this.packet('in0', bytes, () => !this.answer.length && this.next());
    }
    this.pulls++;
    const waiting = this.waiting[number];
    if (!waiting?.length) return 'nak';
    return this.packet(`in${number}`, Uint8Array.from(waiting[0]), () => waiting.shift());
  }

  packet(key, bytes, done) {
    const data = this.numbers[key] ?? 0;
    const end = (whole) => {
      if (!whole) return;
      this.numbers[key] = data ^ 1;
      done();
    };
    return { data, bytes, end };
  }

  output(address, number, data, bytes) {
    if (address !== this.address) return null;
    const key = `out${number}`;
    const end = (whole) => {
      if (!whole) return null;
      assert.equal(data, this.numbers[key] ?? 0);
      this.numbers[key] = data ^ 1;
      if (number) (this.got[number] ??= []).push([...bytes]);
      else if (bytes.length) this.line = bytes;
      return 'ack';
    };
    return { end };
  }

  startOfFrame(number) {
    this.frames.push(number);
  }

  reset() {
    this.resets++;
    this.address = 0;
    this.numbers = {};
  }

  resume() {
    this.wakes++;
  }
}

function plugged() {
  const clock = new Clock();
  const [said, errors, heard] = [[], [], []];
  const device = new Device();
  const board = { clock, chip: { usbCtrl: device }, say: (line) => errors.push(line) };
  const received = (name, bytes) => heard.push([clock.nanos, name, [...bytes]]);
  const host = new UsbHost(board, { say: (line) => said.push(line), received });
  host.plug();
  clock.advanceTo(300 * MS);
  const run = (nanos) => clock.advanceTo(clock.nanos + nanos);
  return { host, device, board, clock, said, errors, heard, run };
}

test('a new device is configured as Linux does it', () => {
  const { device, said, errors } = plugged();
  assert.deepEqual(said, [
    'device 1209:0001', 'manufacturer maker', 'product thing', 'serial 0123', 'function drivetwin bus',
    'function drivetwin control', 'configured',
  ]);
  assert.deepEqual(errors, []);
  assert.deepEqual(device.requests.slice(0, 6), [
    '8006000100000800', // 8 bytes of the device descriptor
    '0005010000000000', // the address
    '8006000100001200', // all 18 bytes of it
    '8006000600000a00', // the qualifier, which a device of full speed refuses
    '8006000200000900', // 9 bytes of the configuration
    '800600020000' + Buffer.from(u16(DESCRIPTORS[0x200].length)).toString('hex'),
  ]);
  const last = device.requests.slice(-6);
  assert.deepEqual(last, [
    '800604030904ff00', '2122000000000000', '2120000000000700', '800605030904ff00',
    '2122000002000000', '2120000002000700',
  ]);
  assert.deepEqual([...device.line], [...coding(9600, '8N1')]);
});

test('a frame begins every ms, and has room for 19 packets of 64 bytes', () => {
  const { host, device, run } = plugged();
  const before = device.frames.length;
  host.send('bus', new Uint8Array(64 * 200));
  run(10 * MS);
  const count = device.frames.length - before;
  assert.equal(count, 10);
  const packets = device.got[2].length;
  assert.ok(packets > 180 && packets <= 19 * 11, `${packets} packets`);
});

test('packets of a port come while a program has it open, and DTR says so', () => {
  const { host, device, heard, run } = plugged();
  device.waiting[4] = [[1], [2, 3]];
  run(5 * MS);
  assert.deepEqual(heard, []);
  host.open('control');
  run(5 * MS);
  assert.deepEqual(heard.map(([, name, bytes]) => [name, bytes]), [['control', [1]], ['control', [2, 3]]]);
  assert.equal(device.requests.at(-1), '2122030002000000');
  host.close('control');
  run(5 * MS);
  assert.equal(device.requests.at(-1), '2122000002000000');
});

test('the line is set and read back', () => {
  const { host, device, said, run } = plugged();
  host.line(57600, '7O2');
  run(5 * MS);
  assert.deepEqual([...device.line], [0x00, 0xe1, 0, 0, 2, 1, 7]);
  assert.equal(said.at(-1), 'line 57600 7O2');
});

test('a packet with the number of the one before is an error, and so is one that is too long', () => {
  const { host, device, errors, heard, run } = plugged();
  device.waiting[2] = [[1], [2]];
  host.open('bus');
  run(1 * MS);
  device.numbers.in2 = 1;
  device.waiting[2].push([3]);
  run(2 * MS);
  assert.deepEqual(errors, ['error usb: endpoint 2 sent DATA1 twice']);
  assert.deepEqual(heard.map(([, , bytes]) => bytes), [[1], [2]]);
  device.waiting[2].push(new Array(65).fill(0));
  run(2 * MS);
  assert.equal(errors.at(-1), 'error usb: endpoint 2 sent 65 bytes');
});

test('an endpoint that has nothing is asked again, and a transaction that is not answered is an error', () => {
  const { host, device, errors, run } = plugged();
  host.open('bus');
  const before = device.pulls;
  run(10 * MS);
  assert.ok(device.pulls - before > 50, `${device.pulls - before} times`);
  device.address = 99;
  run(1 * MS);
  assert.equal(errors[0], 'error usb: endpoint 2 does not answer');
});

test('a computer that sleeps makes no frames, and wakes the device before the next one', () => {
  const { host, device, run } = plugged();
  host.suspend();
  run(1 * MS);
  const { length } = device.frames;
  run(20 * MS);
  assert.equal(device.frames.length, length);
  host.send('bus', [1]);
  host.resume();
  assert.equal(device.wakes, 1);
  run(19 * MS);
  assert.equal(device.frames.length, length);
  run(5 * MS);
  assert.deepEqual(device.got[2], [[1]]);
});

test('a device that is unplugged, reset or gone is configured again', () => {
  const { host, device, board, said, run } = plugged();
  host.unplug();
  run(5 * MS);
  host.open('bus');
  assert.equal(said.at(-1), 'not configured');
  host.plug();
  run(300 * MS);
  assert.equal(said.filter((line) => line === 'configured').length, 2);
  host.reset();
  run(300 * MS);
  assert.equal(said.filter((line) => line === 'configured').length, 3);
  assert.equal(device.resets, 3);
  board.chip.usbCtrl = new Device();
  run(300 * MS);
  assert.ok(said.includes('gone'));
  assert.equal(said.filter((line) => line === 'configured').length, 4);
});

test('a device that cannot be configured is tried three times', () => {
  const { host, device, said, run } = plugged();
  const descriptor = DESCRIPTORS[0x200];
  try {
    DESCRIPTORS[0x200] = descriptor.slice(0, -7);
    host.reset();
    run(1000 * MS);
  } finally {
    DESCRIPTORS[0x200] = descriptor;
  }
  const failures = said.filter((line) => line === 'failed the configuration descriptor');
  assert.equal(failures.length, 3);
  assert.equal(said.at(-1), 'unusable');
  assert.equal(device.resets, 4);
});

test('the numbers of packets begin again when a halt is ended', () => {
  const { host, device, errors, heard, run } = plugged();
  device.waiting[2] = [[1]];
  host.open('bus');
  host.send('bus', [2]);
  run(2 * MS);
  device.numbers = {};
  host.clear('bus');
  run(2 * MS);
  assert.deepEqual(device.requests.slice(-2), ['0201000082000000', '0201000002000000']);
  device.waiting[2].push([3]);
  host.send('bus', [4]);
  run(2 * MS);
  assert.deepEqual(heard.map(([, , bytes]) => bytes), [[1], [3]]);
  assert.deepEqual(device.got[2], [[2], [4]]);
  assert.deepEqual(errors, []);
});
