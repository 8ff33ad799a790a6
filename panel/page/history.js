// Positions and speeds of the last minutes, kept also while another drive is shown.

const KEPT = 20_000; // samples: more than ten minutes of 30 each second
const MOST = 12; // drives
const UPDATE = 0.034; // seconds between two updates while something moves

/** Samples of time, position and speed, the latest `KEPT` of them. */
export class Samples {
  at = new Float64Array(KEPT);
  position = new Float64Array(KEPT);
  speed = new Float64Array(KEPT);
  first = 0;
  count = 0;

  clear() {
    this.first = this.count = 0;
  }

  index(i) {
    return (this.first + i) % KEPT;
  }

  /** Takes a sample in; a time before the last one begins anew. */
  push(at, position, speed) {
    if (this.count) {
      // While nothing moves no sample comes: the old values held until now.
      const i = this.index(this.count - 1);
      const stood = this.speed[i] === 0 && (speed !== 0 || position !== this.position[i]);
      if (stood && at - this.at[i] > 2 * UPDATE) this.add(at - UPDATE, this.position[i], 0);
    }
    this.add(at, position, speed);
  }

  add(at, position, speed) {
    if (this.count) {
      const last = this.index(this.count - 1);
      if (at < this.at[last]) this.clear();
      else if (at === this.at[last] && position === this.position[last] && speed === this.speed[last]) return;
      else if (this.count > 1) {
        // Of a pause only its two ends are kept.
        const before = this.index(this.count - 2);
        const same = i => this.position[i] === position && this.speed[i] === speed;
        if (same(last) && same(before)) {
          this.at[last] = at;
          return;
        }
      }
    }
    if (this.count === KEPT) this.first = (this.first + 1) % KEPT;
    else this.count++;
    const i = this.index(this.count - 1);
    this.at[i] = at;
    this.position[i] = position;
    this.speed[i] = speed;
  }

  get start() {
    return this.count ? this.at[this.index(0)] : 0;
  }

  get end() {
    return this.count ? this.at[this.index(this.count - 1)] : 0;
  }

  /** Number of the last sample at or before a time, -1 if there is none. */
  before(time) {
    let low = -1, high = this.count - 1;
    while (low < high) {
      const middle = Math.ceil((low + high) / 2);
      if (this.at[this.index(middle)] <= time) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** Position and speed at a time, between two samples on the line from one to the other. */
  value(time) {
    const i = this.before(time);
    if (i < 0) return null;
    const a = this.index(i);
    if (i === this.count - 1) return { position: this.position[a], speed: this.speed[a] };
    const b = this.index(i + 1);
    const part = (time - this.at[a]) / (this.at[b] - this.at[a] || 1);
    return { position: this.position[a] + part * (this.position[b] - this.position[a]), speed: this.speed[a] + part * (this.speed[b] - this.speed[a]) };
  }
}

/** The samples of the drives that were shown, and on a small bench of all. */
export class Histories {
  kept = new Map();

  /** The samples of a drive; those of the drive that was asked for longest ago make room. */
  of(name) {
    const samples = this.kept.get(name) ?? new Samples();
    this.kept.delete(name);
    this.kept.set(name, samples);
    if (this.kept.size > MOST) this.kept.delete(this.kept.keys().next().value);
    return samples;
  }

  /** Takes a sample of each drive. */
  take({ time, drives = {} }, whole) {
    if (!time) return;
    if (whole && Object.keys(drives).length <= MOST) Object.keys(drives).forEach(name => this.of(name));
    for (const [name, samples] of this.kept) {
      const drive = drives[name];
      if (drive?.position !== undefined) samples.push(time.seconds, drive.position, drive.speed);
    }
  }
}
