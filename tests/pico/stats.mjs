// How many instructions and cycles an image spends where.

/** The instructions `mov r10, r10` and `mov r11, r11`, which do nothing: the begin and the end of what is measured. */
const MARKS = { begin: 0x46d2, end: 0x46db };

/** Counts per exception (0 is the thread); an exception's count is without those that interrupt it. */
export class Stats {
  /** Instructions executed since the first reset. */
  instructions = 0;
  /** Cycles of them and of entering exceptions. */
  cycles = 0;
  /** The lowest stack pointer since the stack was set; {@link Stats.lowest} is that of the whole run. */
  lowestSp = Infinity;

  constructor() {
    /** @private */
    this.perException = new Map();
    /** @private */
    this.lowestBefore = Infinity;
    /** @private Interrupted activities, the present one last. */
    this.active = [this.frame(0)];
    /** @private Stretches between marks. */
    this.marked = { times: 0, least: Infinity, worst: 0, total: 0 };
  }

  /**
   * Looks for a mark, of which the begin and the end belong to the same activity.
   *
   * @param {number} opcode of the instruction to be executed next
   */
  look(opcode) {
    if (opcode === MARKS.begin) {
      this.pause(0);
      const frame = this.active.at(-1);
      frame.begun = frame.instructions + 1;
    } else if (opcode === MARKS.end) {
      this.pause(0);
      const frame = this.active.at(-1);
      const count = frame.instructions - frame.begun;
      if (Number.isNaN(count)) return;
      frame.begun = NaN;
      const { marked } = this;
      marked.times += 1;
      marked.least = Math.min(marked.least, count);
      marked.worst = Math.max(marked.worst, count);
      marked.total += count;
    }
  }

  /** The chip starts anew: whatever it was in is over. */
  restart() {
    this.settle();
    this.active = [this.frame(0)];
    this.lowestBefore = this.lowest;
    this.lowestSp = Infinity;
  }

  /** The image sets its stack pointer: what was on a stack before, of the ROM, does not count. */
  stacked(sp) {
    this.lowestSp = sp;
  }

  /** The lowest stack pointer of the image, in all its runs. */
  get lowest() {
    return Math.min(this.lowestSp, this.lowestBefore);
  }

  /** An exception is entered. */
  entered(exception) {
    this.pause(0);
    this.active.push(this.frame(exception));
  }

  /** The present exception is left by an instruction that is not counted yet; its cycles go to what follows. */
  left() {
    this.pause(1);
    const done = this.active.pop();
    const sum = this.sumOf(done.exception);
    sum.times += 1;
    add(sum, done);
    sum.worstInstructions = Math.max(sum.worstInstructions, done.instructions);
    sum.worstCycles = Math.max(sum.worstCycles, done.cycles);
    const below = this.active.at(-1) ?? this.frame(0);
    if (!this.active.length) this.active.push(below);
    below.sinceInstructions = this.instructions + 1;
    below.sinceCycles = this.cycles;
  }

  /** What was counted, one line per exception, in order of their numbers. */
  lines() {
    this.settle();
    const numbers = [...this.perException.keys()].sort((a, b) => a - b);
    const lines = numbers.map((number) => {
      const sum = this.perException.get(number);
      const total = `total ${sum.instructions} cycles ${sum.cycles}`;
      if (number === 0) return `stat thread ${total}`;
      const worst = `worst ${sum.worstInstructions} cycles ${sum.worstCycles}`;
      return `stat exception ${number} times ${sum.times} ${worst} ${total}`;
    });
    const { times, least, worst, total } = this.marked;
    if (times) lines.push(`stat marked times ${times} least ${least} worst ${worst} total ${total}`);
    return lines;
  }

  /** @private Adds what is not over yet. */
  settle() {
    this.pause(0);
    for (const frame of this.active) {
      add(this.sumOf(frame.exception), frame);
      Object.assign(frame, { instructions: 0, cycles: 0 });
    }
  }

  /** @private */
  frame(exception) {
    const since = { sinceInstructions: this.instructions, sinceCycles: this.cycles };
    return { exception, instructions: 0, cycles: 0, begun: NaN, ...since };
  }

  /** @private */
  pause(more) {
    const frame = this.active.at(-1);
    frame.instructions += this.instructions + more - frame.sinceInstructions;
    frame.cycles += this.cycles - frame.sinceCycles;
    frame.sinceInstructions = this.instructions;
    frame.sinceCycles = this.cycles;
  }

  /** @private */
  sumOf(exception) {
    let sum = this.perException.get(exception);
    if (!sum) {
      sum = { times: 0, instructions: 0, cycles: 0, worstInstructions: 0, worstCycles: 0 };
      this.perException.set(exception, sum);
    }
    return sum;
  }
}

function add(sum, frame) {
  sum.instructions += frame.instructions;
  sum.cycles += frame.cycles;
}
