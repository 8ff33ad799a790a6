// The script of a batch run: what the world does, and when.

import { ERROR } from './uart.mjs';
import { coding } from './usb.mjs';

/** What a computer at the USB cable may do, and with what words. */
const USB = {
  plug: () => (usb) => usb.plug(),
  unplug: () => (usb) => usb.unplug(),
  reset: () => (usb) => usb.reset(),
  suspend: () => (usb) => usb.suspend(),
  resume: () => (usb) => usb.resume(),
  garbage: () => (usb) => usb.garbage(),
  bus: (words) => send('bus', words),
  control: (words) => send('control', words),
  open: ([port]) => {
    const name = check(port, PORT);
    return (usb) => usb.open(name);
  },
  clear: ([port]) => {
    const name = check(port, PORT);
    return (usb) => usb.clear(name);
  },
  close: ([port]) => {
    const name = check(port, PORT);
    return (usb) => usb.close(name);
  },
  line: ([rate, format]) => {
    const baud = parse(rate, /^\d+$/, 10);
    coding(baud, format);
    return (usb) => usb.line(baud, format);
  },
};
const PORT = /^(bus|control)$/;

/** What a line may say after its time, and how its words become an action. */
const ACTIONS = {
  rx: (words) => {
    const bytes = bytesOf(words);
    return (board, at) => characters(board, at, bytes);
  },
  spoiled: ([kind = 'framing', byte = 'ff']) => {
    if (!(kind in ERROR)) throw new Error(`unknown error \`${kind}\``);
    const data = parse(byte, /^[0-9a-f]{2}$/i, 16);
    return (board) => board.receive(data, ERROR[kind]);
  },
  pin: ([number, level]) => {
    const levels = { low: false, high: true, float: null };
    const pin = parse(number, /^[12]?\d$/, 10);
    if (!(level in levels)) throw new Error(`unknown level \`${level}\``);
    return (board) => board.drive(pin, levels[level]);
  },
  power: ([state]) => {
    if (state !== 'on' && state !== 'off') throw new Error('power is `on` or `off`');
    return (board) => (state === 'on' ? board.powerOn() : board.powerOff());
  },
  cut: ([count]) => {
    const bytes = parse(count, /^\d+$/, 10);
    return (board) => board.flash.cutAfter(bytes);
  },
  peek: ([address]) => {
    const place = parse(address, /^[0-9a-f]{8}$/i, 16);
    return (board) => board.peek(place);
  },
  hang: () => (board) => board.hang(),
  usb: ([what, ...words]) => {
    if (!Object.hasOwn(USB, what ?? '')) throw new Error(`unknown event \`usb ${what}\``);
    const act = USB[what](words);
    return (board) => act(board.usb);
  },
  end: () => () => {},
};

/**
 * Reads what an event is, without its time.
 *
 * @param {string[]} words
 * @returns {(board: object, nanos: number) => void} lets it happen
 */
export function readAction([what, ...words]) {
  if (!Object.hasOwn(ACTIONS, what)) throw new Error(`unknown event \`${what}\``);
  return ACTIONS[what](words);
}

/**
 * Reads a script.
 *
 * @param {string} text one event a line, `<µs> <what>`, in ascending order; `#` begins a comment
 * @returns {{events: {nanos: number, act: (board: object, nanos: number) => void}[], end: number}} the events, and the
 *   instant of the line `end`, in ns
 */
export function readScript(text) {
  const events = [];
  let end;
  text.split('\n').forEach((line, index) => {
    const [time, what, ...words] = line.replace(/#.*/, '').trim().split(/\s+/);
    if (!time) return;
    try {
      const nanos = Math.round(parse(time, /^\d+(\.\d+)?$/) * 1000);
      if (end !== undefined) throw new Error('nothing comes after `end`');
      if (nanos < (events.at(-1)?.nanos ?? 0)) throw new Error('times must ascend');
      events.push({ nanos, act: readAction([what, ...words]) });
      if (what === 'end') end = nanos;
    } catch (error) {
      throw new Error(`script, line ${index + 1}: ${error.message}`);
    }
  });
  if (end === undefined) throw new Error('script: the last line must be `<µs> end`');
  return { events, end };
}

/** Lets characters come one after the other at the line's rate; the stop bit of the first ends now. */
function characters(board, at, bytes) {
  if (!bytes.length) return;
  board.receive(bytes[0]);
  const next = at + board.characterNanos;
  const alarm = board.clock.createAlarm(() => characters(board, next, bytes.slice(1)));
  alarm.schedule(Math.max(next - board.clock.nanos, 0));
}

function send(port, words) {
  const bytes = bytesOf(words);
  return (usb) => usb.send(port, bytes);
}

function bytesOf(words) {
  return words.map((word) => parse(word, /^[0-9a-f]{2}$/i, 16));
}

function check(word, form) {
  if (!form.test(word ?? '')) throw new Error(`\`${word ?? ''}\` is not what belongs here`);
  return word;
}

function parse(word, form, base) {
  check(word, form);
  return base ? parseInt(word, base) : Number(word);
}
