// A little assembler for ARMv6-M, enough for the boot ROM and for the images of the tests.

const CONDITIONS = {
  beq: 0, bne: 1, bhs: 2, blo: 3, bmi: 4, bpl: 5, bhi: 8, bls: 9, bge: 10, blt: 11, bgt: 12, ble: 13,
};
const SPECIAL = { msp: 8, primask: 16 };
const FIXED = { nop: 0xbf00, wfi: 0xbf30, wfe: 0xbf20, 'cpsid i': 0xb672, 'cpsie i': 0xb662 };
const ALU = { ands: 0, eors: 1, adcs: 5, sbcs: 6, tst: 8, orrs: 12, muls: 13, bics: 14 };
/** Opcode and size in bytes of the loads and stores with an immediate offset. */
const MEMORY = {
  str: [0x6000, 4], ldr: [0x6800, 4], strb: [0x7000, 1], ldrb: [0x7800, 1], strh: [0x8000, 2], ldrh: [0x8800, 2],
};

/**
 * Assembles a program.
 *
 * One statement a line: `label:`, an instruction, `.word`, `.hword` or `.align 4`; `;` begins a comment.
 * `ldr rN, =value` takes the value from a pool behind the program.
 *
 * @param {string} text the program
 * @param {number} origin the address of its first byte, a multiple of 4
 * @returns {{bytes: Uint8Array, labels: Record<string, number>}} the code, and the address of every label
 */
export function assemble(text, origin) {
  const labels = {};
  const parts = [];
  const pool = [];
  let here = origin;
  const place = (size, encode) => {
    parts.push({ at: here, encode });
    here += size;
  };
  const align = () => {
    if (here % 4) place(2, () => [FIXED.nop]);
  };
  const value = (word) => {
    const [, name, plus] = /^(\S+?)(\+\d+)?$/.exec(word);
    const base = name in labels ? labels[name] : Number(name);
    if (Number.isNaN(base)) throw new Error(`there is no label \`${name}\``);
    return base + Number(plus ?? 0);
  };

  for (const line of text.split('\n')) {
    let statement = line.replace(/;.*/, '').trim();
    const label = /^(\w+):\s*/.exec(statement);
    if (label) {
      labels[label[1]] = here;
      statement = statement.slice(label[0].length);
    }
    if (!statement) continue;
    const [mnemonic, rest = ''] = statement.split(/\s+(.*)/s);
    const list = rest.split(',').map((word) => word.trim());
    if (mnemonic === '.align') align();
    else if (mnemonic === '.hword') for (const word of list) place(2, () => [value(word)]);
    else if (mnemonic === '.word') for (const word of list) place(4, () => halves(value(word)));
    else if (list[1]?.startsWith('=')) {
      const entry = { word: list[1].slice(1), at: 0 };
      pool.push(entry);
      place(2, (at) => [0x4800 | (register(list[0]) << 8) | within(255, (entry.at - ((at + 4) & ~3)) >> 2, statement)]);
    } else {
      const wide = ['bl', 'msr', 'mrs', 'dsb'].includes(mnemonic);
      place(wide ? 4 : 2, (at) => encode(statement, mnemonic, rest, list, at, value));
    }
  }
  align();
  for (const entry of pool) {
    entry.at = here;
    place(4, () => halves(value(entry.word)));
  }

  const bytes = new Uint8Array(here - origin);
  const view = new DataView(bytes.buffer);
  for (const { at, encode } of parts) {
    encode(at).forEach((half, index) => view.setUint16(at - origin + 2 * index, half, true));
  }
  return { bytes, labels };
}

function encode(statement, mnemonic, rest, list, at, value) {
  if (statement in FIXED) return [FIXED[statement]];
  const distance = (word) => value(word) - (at + 4);
  const immediate = (word) => value(word.slice(1));
  const [a, b, c] = list;
  switch (mnemonic) {
    case 'b':
      return [0xe000 | ((distance(a) >> 1) & 0x7ff)];
    case 'bl': {
      const to = distance(a);
      return [0xf000 | ((to >> 12) & 0x7ff), 0xf800 | ((to >> 1) & 0x7ff)];
    }
    case 'bx':
      return [0x4700 | (register(a) << 3)];
    case 'blx':
      return [0x4780 | (register(a) << 3)];
    case 'bkpt':
      return [0xbe00 | immediate(a)];
    case 'udf':
      return [0xde00 | immediate(a)];
    case 'dsb':
      return [0xf3bf, 0x8f4f];
    case 'msr':
      return [0xf380 | register(b), 0x8800 | SPECIAL[a]];
    case 'mrs':
      return [0xf3ef, 0x8000 | (register(a) << 8) | SPECIAL[b]];
    case 'mov':
      return [0x4600 | ((register(a) & 8) << 4) | (register(b) << 3) | (register(a) & 7)];
    case 'movs':
      return [0x2000 | (register(a) << 8) | within(255, immediate(b), statement)];
    case 'cmp':
      if (b.startsWith('#')) return [0x2800 | (register(a) << 8) | within(255, immediate(b), statement)];
      return [0x4280 | (register(b) << 3) | register(a)];
    case 'adds':
    case 'subs': {
      const minus = mnemonic === 'subs';
      if (c) return [(minus ? 0x1a00 : 0x1800) | (register(c) << 6) | (register(b) << 3) | register(a)];
      return [(minus ? 0x3800 : 0x3000) | (register(a) << 8) | within(255, immediate(b), statement)];
    }
    case 'lsls':
      return [(immediate(c) << 6) | (register(b) << 3) | register(a)];
    case 'ldmia':
    case 'stmia':
      return [(mnemonic === 'ldmia' ? 0xc800 : 0xc000) | (register(a.replace('!', '')) << 8) | registers(rest)];
    case 'push':
      return [0xb400 | registers(rest.replace('lr', 'r8'))];
    case 'pop':
      return [0xbc00 | registers(rest.replace('pc', 'r8'))];
  }
  if (mnemonic in CONDITIONS) {
    const halfwords = within(255, (distance(a) >> 1) + 128, statement) - 128;
    return [0xd000 | (CONDITIONS[mnemonic] << 8) | (halfwords & 0xff)];
  }
  if (mnemonic in ALU) return [0x4000 | (ALU[mnemonic] << 6) | (register(b) << 3) | register(a)];
  if (mnemonic in MEMORY) {
    const [opcode, size] = MEMORY[mnemonic];
    const [, base, offset = '#0'] = /\[(\w+)(?:,\s*(#\w+))?\]/.exec(rest);
    return [opcode | (within(31, immediate(offset) / size, statement) << 6) | (register(base) << 3) | register(a)];
  }
  throw new Error(`cannot assemble \`${statement}\``);
}

function within(most, number, statement) {
  if (number < 0 || number > most) throw new Error(`out of reach: \`${statement}\``);
  return number;
}

function register(name) {
  const number = { sp: 13, lr: 14, pc: 15 }[name] ?? Number(/^r(\d+)$/.exec(name)?.[1]);
  if (Number.isNaN(number)) throw new Error(`\`${name}\` is no register`);
  return number;
}

function registers(list) {
  const names = /\{(.*)\}/.exec(list)[1].split(',');
  return names.reduce((mask, name) => mask | (1 << register(name.trim())), 0);
}

function halves(word) {
  return [word & 0xffff, (word >>> 16) & 0xffff];
}
