// A batch run: plays a script to an image and prints what the board does. Two runs print the same.
//
//   npm ci                      once, in this folder; `cargo xtask pico` does it, too
//   node play.mjs <image.elf> [--flash <file>] [--stack <low> <high>] [--marks] < script
//   node play.mjs --many < jobs
//
// --flash   the flash is read from this file before, if it exists, and written to it after; the image is put over it
// --stack   prints how much of the stack between these addresses was used
// --marks   counts the instructions between `mov r10, r10` and `mov r11, r11`, without those of interrupts
// --many    plays several scripts; a process that plays the second one is warm, and twice as fast. Before each script is
//           a line with the image and the options, separated by tabs. Behind each output is a line with a full stop
//
// Script, one event a line, times in µs since the first power-on, ascending, `#` begins a comment:
//
//   1000.0 rx 01 03 00        characters; the stop bit of the first ends then, the others follow at the line's rate
//   1000.0 spoiled parity 55  a character received with an error: framing (if not said), parity or break
//   1000.0 pin 5 low          the world drives a pin low or high, or lets it float
//   1000.0 power off          and `on` again: a new reset with RAM lost and flash kept
//   1000.0 cut 3              power fails when the flash has erased or programmed 3 more bytes and begins the next
//   1000.0 peek 20001234      prints a word of the memory
//   1000.0 hang               the CPU loops for ever with interrupts off
//   1000.0 usb plug           connects the USB cable to a computer, or `unplug`
//   1000.0 usb reset          the computer resets the device and configures it again
//   1000.0 usb suspend        it sleeps; `resume`: it wakes
//   1000.0 usb bus 01 03 00   it sends bytes to the port `bus`, or to `control`
//   1000.0 usb line 9600 8E1  it sets the line of the port `bus`
//   1000.0 usb open bus       a program opens a port, or `close`s it
//   1000.0 usb clear bus      it ends a halt of the port's endpoints: the numbers of packets begin again
//   1000.0 usb garbage        the computer makes requests that make no sense
//   9000.0 end                the last line
//
// Prints `<ns> <what>`, ns since the first power-on:
//
//   tx 01                     a character; its start bit begins then
//   pin 3 high                the chip drives a pin high, or low, or lets go of it (float)
//   flash erase 0x1ff000      begins; `block` behind it if it is one of 64 KiB
//   flash program 0x1ff000 256
//   reset watchdog            or `request`, by software
//   boot loader 02000000      of the ROM, with the bit of the pin that it lights; it waits until power is off
//   unheard 55                a character came when UART0 was not listening
//   peek 20001234 0000000a    what is in that word
//   power off                 after `cut`, or by the script
//   usb product drivetwin     what the computer learns about the device: `device`, `manufacturer`, `product`, `serial`,
//                             and for each port `function`
//   usb configured            it can use the ports now
//   usb bus 01 03 02          a packet from the port `bus`, or from `control`; it has just ended
//   usb line 9600 8E1         what the device says about its line after it was set
//   usb gone                  the board has disconnected itself, for example by a reset
//   usb not configured        the script wants what needs a configured device; nothing happens
//   usb 80 06 …: refused      a senseless request, and how many bytes there were for it; or that it was refused
//   usb failed …              the computer could not use the device, and tries again
//   usb unusable              it has tried three times, and gives up
//   error …                   what the chip would not bear; the CPU stops, or takes its hard fault. `error usb …`: what no
//                             USB device may do
//   warning …                 what rp2040js does not know; said once
//
// and at the end, for the thread and for every exception that came, `stat …` in instructions and cycles. An exception's
// count is without those that interrupt it; its cycles are with its entry and without its last instruction.

import { existsSync, readFileSync, writeFileSync } from 'node:fs';
import { createInterface } from 'node:readline';
import { parseArgs } from 'node:util';

import { FLASH_SIZE } from './flash.mjs';
import { Pico } from './pico.mjs';
import { readScript } from './script.mjs';

/**
 * Runs an image against a script.
 *
 * @param {object} job
 * @param {(board: Pico) => void} job.load puts the image into flash
 * @param {string} job.script see above
 * @param {[number, number]} [job.stack] lowest address of the stack, and the one above its highest
 * @param {boolean} [job.marks] whether to count between marks
 * @returns {{output: string, board: Pico}} what is to be printed, and the board in its last state
 */
export function play({ load, script, stack, marks = false }) {
  const { events, end } = readScript(script);
  const lines = [];
  const say = (line) => lines.push(`${Math.round(board.clock.nanos)} ${line}`);
  const hex = (byte) => byte.toString(16).padStart(2, '0');
  const board = new Pico({
    say,
    sent: (byte) => say(`tx ${hex(byte)}`),
    received: (port, bytes) => say(`usb ${port} ${Array.from(bytes, hex).join(' ')}`),
  });
  board.looksForMarks = marks;
  load(board);
  // At one instant the script comes before the board.
  board.clock.scheduleAll(events.map(({ nanos, act }) => ({ nanos, callback: () => act(board, nanos) })));
  // What is said of the instant 0, a jumper for example, is there before power is.
  board.clock.advanceTo(0);
  board.powerOn();
  board.run(end);
  lines.push(...board.stats.lines());
  if (stack) {
    const low = Math.max(board.stats.lowest, stack[0]);
    lines.push(`stat stack ${stack[1] - Math.min(low, stack[1])} of ${stack[1] - stack[0]}`);
  }
  return { output: `${lines.join('\n')}\n`, board };
}

/** Runs one job with its arguments of the command line; returns what is to be printed. */
function run(args, script) {
  const { values, positionals } = parseArgs({
    args,
    allowPositionals: true,
    options: { flash: { type: 'string' }, stack: { type: 'boolean' }, marks: { type: 'boolean' } },
  });
  const [image, ...addresses] = positionals;
  const stack = values.stack ? addresses.map(Number) : undefined;
  if (!image || addresses.length !== (stack ? 2 : 0)) {
    throw new Error('usage: node play.mjs <image.elf> [--flash <file>] [--stack <low> <high>] [--marks] < script');
  }
  const load = (board) => {
    if (values.flash && existsSync(values.flash)) {
      const content = readFileSync(values.flash);
      if (content.length !== FLASH_SIZE) throw new Error(`${values.flash} must have ${FLASH_SIZE} bytes`);
      board.flash.bytes.set(content);
    }
    board.load(image);
  };
  const { output, board } = play({ load, stack, marks: values.marks, script });
  if (values.flash) writeFileSync(values.flash, board.flash.bytes);
  return output;
}

async function runMany() {
  let args;
  let script = [];
  for await (const line of createInterface({ input: process.stdin })) {
    if (!args) args = line.split('\t');
    else script.push(line);
    if (args && /^\S+ end\s*(#|$)/.test(line)) {
      process.stdout.write(`${run(args, script.join('\n'))}.\n`);
      [args, script] = [undefined, []];
    }
  }
  if (args) throw new Error('the last script has no end');
}

if (import.meta.filename === process.argv[1]) {
  const args = process.argv.slice(2);
  try {
    if (args[0] === '--many') await runMany();
    else process.stdout.write(run(args, readFileSync(0, 'utf8')));
  } catch (error) {
    console.error(`error: ${error.message}`);
    process.exitCode = 1;
  }
}
