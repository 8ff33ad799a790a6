// The USB controller, by what the RP2040 datasheet says in 4.1.2 and 4.1.4.

import assert from 'node:assert/strict';
import { test } from 'node:test';

import { Clock } from './clock.mjs';
import { UsbController } from './usbctrl.mjs';

const [ADDRESS, MAIN, SIE_CTRL, SIE_STATUS, BUFF_STATUS] = [0x00, 0x40, 0x4c, 0x50, 0x58];
const [EP_ABORT, EP_ABORT_DONE, EP_STALL_ARM, MUXING, POWER] = [0x60, 0x64, 0x68, 0x74, 0x78];
const [INTE, INTS] = [0x90, 0x98];
const [FULL, DATA1, STALL, AVAILABLE] = [1 << 15, 1 << 13, 1 << 11, 1 << 10];
const [SETUP_REC, SUSPENDED, RESUME, BUS_RESET] = [1 << 17, 1 << 4, 1 << 11, 1 << 19];
/** Control words of endpoint 2's buffers, and its own; 64 bytes at 0x180 and 0x1c0. */
const [IN_2, OUT_2] = [0x90, 0x94];
const [EP2_IN, EP2_OUT] = [0x10, 0x14];
const [IN_0, OUT_0] = [0x80, 0x84];
const MS = 1e6;

function controller() {
  const clock = new Clock();
  const bytes = new Uint8Array(4096);
  const complaints = [];
  const line = { irq: false };
  const chip = {
    clock,
    usbDPRAM: bytes,
    usbDPRAMView: new DataView(bytes.buffer),
    setInterrupt: (irq, high) => irq === 5 && (line.irq = high),
    clocks: { usbCtrl: 1 << 11, usbDiv: 0x100 },
    pllUsb: { frequency: 48e6 },
    logger: { warn: assert.fail },
  };
  const usb = new UsbController(chip, (what) => complaints.push(what));
  const write = (offset, value) => usb.writeUint32Atomic(offset, value, 0);
  const poke = (offset, value) => {
    chip.usbDPRAMView.setUint32(offset, value, true);
    usb.DPRAMUpdated(offset, value);
  };
  /** As software should: AVAILABLE comes later. */
  const offer = (offset, value) => {
    poke(offset, value);
    clock.advanceTo(clock.nanos + 50);
    poke(offset, value | AVAILABLE);
  };
  const peek = (offset) => chip.usbDPRAMView.getUint32(offset, true);
  for (let offset = 0; offset < 0x100; offset += 4) poke(offset, 0);
  write(MUXING, 1 | 8);
  write(POWER, 0b1100);
  write(MAIN, 1);
  write(SIE_CTRL, (1 << 29) | (1 << 16));
  poke(EP2_IN, (1 << 31) | (1 << 29) | (2 << 26) | 0x180);
  poke(EP2_OUT, (1 << 31) | (1 << 29) | (2 << 26) | 0x1c0);
  return { usb, chip, clock, line, complaints, bytes, write, read: (offset) => usb.readUint32(offset), poke, offer, peek };
}

test('a setup packet is always taken, raises its interrupt, and ends a stall of endpoint 0 (4.1.2.6.1)', () => {
  const { usb, bytes, line, write, read, poke } = controller();
  write(INTE, 1 << 16);
  poke(IN_0, STALL);
  assert.equal(usb.input(0, 0), 'nak', 'without its bit in EP_STALL_ARM it is no stall');
  write(EP_STALL_ARM, 3);
  assert.equal(usb.input(0, 0), 'stall');
  const packet = Uint8Array.of(0x80, 6, 0, 1, 0, 0, 18, 0);
  assert.equal(usb.setup(0, packet), 'ack');
  assert.deepEqual(bytes.slice(0, 8), packet);
  assert.equal(read(SIE_STATUS) & SETUP_REC, SETUP_REC);
  assert.equal(line.irq, true);
  assert.equal(usb.input(0, 0), 'nak');
  write(SIE_STATUS, SETUP_REC);
  assert.equal(line.irq, false);
});

test('a packet to the computer waits until it is FULL and AVAILABLE, and then is neither (4.1.2.6.2)', () => {
  const { usb, bytes, line, write, read, poke, offer, peek } = controller();
  write(INTE, 1 << 4);
  bytes.set([1, 2, 3], 0x180);
  assert.equal(usb.input(0, 2), 'nak');
  poke(IN_2, FULL | DATA1 | 3);
  assert.equal(usb.input(0, 2), 'nak');
  offer(IN_2, FULL | DATA1 | 3);
  const lost = usb.input(0, 2);
  lost.end(false);
  assert.equal(read(BUFF_STATUS), 0, 'one that the computer has not acknowledged is sent again');
  const packet = usb.input(0, 2);
  assert.deepEqual([packet.data, packet.bytes], [1, Uint8Array.of(1, 2, 3)]);
  packet.end(true);
  assert.equal(peek(IN_2) & (FULL | AVAILABLE), 0);
  assert.equal(read(BUFF_STATUS), 1 << 4);
  assert.equal(line.irq, true);
  write(BUFF_STATUS, 1 << 4);
  assert.equal(line.irq, false);
  assert.equal(usb.input(0, 2), 'nak');
});

test('a packet from the computer needs an AVAILABLE buffer that is not FULL, and fills it (4.1.2.6.3)', () => {
  const { usb, bytes, read, offer, peek } = controller();
  assert.equal(usb.output(0, 2, 0, Uint8Array.of(9)), 'nak');
  offer(OUT_2, 64);
  assert.equal(usb.output(0, 2, 0, Uint8Array.of(7, 8)).end(true), 'ack');
  assert.equal(peek(OUT_2), FULL | 2);
  assert.deepEqual(bytes.slice(0x1c0, 0x1c2), Uint8Array.of(7, 8));
  assert.equal(read(BUFF_STATUS), 1 << 5);
  assert.equal(usb.output(0, 2, 1, Uint8Array.of(9)), 'nak');
});

test('a packet with the number of the one before is acknowledged and dropped; one that is too long is not (USB 8.6.4)', () => {
  const { usb, read, offer, peek } = controller();
  offer(OUT_2, DATA1 | 8);
  assert.equal(usb.output(0, 2, 0, Uint8Array.of(7)).end(true), 'ack');
  assert.equal(peek(OUT_2), DATA1 | AVAILABLE | 8);
  assert.equal(read(SIE_STATUS) >>> 31, 1);
  assert.equal(usb.output(0, 2, 1, new Uint8Array(9)).end(true), null);
  assert.equal(read(BUFF_STATUS), 0);
});

test('AVAILABLE with other bits, or before the controller has seen them, is a mistake (4.1.2.5.1)', () => {
  const { clock, complaints, poke } = controller();
  poke(IN_2, FULL | AVAILABLE | 3);
  assert.equal(complaints.length, 1);
  poke(IN_2, FULL | 4);
  clock.advanceTo(clock.nanos + 16);
  poke(IN_2, FULL | AVAILABLE | 4);
  assert.equal(complaints.length, 2);
  poke(IN_2, FULL | 5);
  clock.advanceTo(clock.nanos + 24);
  poke(IN_2, FULL | AVAILABLE | 5);
  assert.equal(complaints.length, 2);
});

test('an aborted endpoint refuses, and may be changed when its transaction is over (4.1.4, EP_ABORT)', () => {
  const { usb, write, read, offer } = controller();
  offer(IN_2, FULL | 3);
  const packet = usb.input(0, 2);
  write(EP_ABORT, 1 << 4);
  assert.equal(read(EP_ABORT_DONE), 0);
  packet.end(true);
  assert.equal(read(EP_ABORT_DONE), 1 << 4);
  write(EP_ABORT_DONE, 1 << 4);
  write(EP_ABORT, 0);
  offer(IN_2, FULL | DATA1 | 3);
  write(EP_ABORT, 1 << 4);
  assert.equal(read(EP_ABORT_DONE), 1 << 4);
  assert.equal(usb.input(0, 2), 'nak');
});

test('a device without frames is suspended after 3 ms, and resumes or is reset (4.1.2.6.4)', () => {
  const { usb, clock, line, write, read } = controller();
  write(INTE, (1 << 12) | (1 << 14) | (1 << 15));
  for (let frame = 1; frame < 5; frame++) {
    usb.startOfFrame(frame);
    clock.advanceTo(clock.nanos + MS);
  }
  assert.equal(read(SIE_STATUS) & SUSPENDED, 0);
  clock.advanceTo(clock.nanos + 2 * MS);
  assert.equal(read(SIE_STATUS) & SUSPENDED, SUSPENDED);
  assert.equal(read(INTS), 1 << 14);
  write(SIE_STATUS, SUSPENDED);
  usb.resume();
  assert.equal(read(INTS), 1 << 15);
  write(SIE_STATUS, RESUME);
  usb.reset();
  assert.equal(read(SIE_STATUS) & BUS_RESET, BUS_RESET);
  assert.equal(line.irq, true);
});

test('only its own address and its endpoints are answered', () => {
  const { usb, write, offer } = controller();
  offer(OUT_0, 64);
  write(ADDRESS, 5);
  assert.equal(usb.setup(0, new Uint8Array(8)), null);
  assert.equal(usb.input(0, 0), null);
  assert.equal(usb.setup(5, new Uint8Array(8)), 'ack');
  assert.equal(usb.input(5, 7), null, 'an endpoint without its enable bit');
  assert.equal(usb.output(5, 0, 0, new Uint8Array(0)).end(true), 'ack');
});

test('a device shows itself with its pull-up, and needs its clock', () => {
  const { usb, chip, complaints, write } = controller();
  assert.equal(usb.isAttached, true);
  write(SIE_CTRL, 0);
  assert.equal(usb.isAttached, false);
  assert.equal(complaints.length, 0);
  chip.pllUsb.frequency = 40e6;
  write(MAIN, 1);
  assert.equal(complaints.length, 1);
});
