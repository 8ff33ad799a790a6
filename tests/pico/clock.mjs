// Virtual time.

/** The time of the world, in ns since the first power-on, and what is to happen at its instants. */
export class Clock {
  /** Now, in ns. */
  nanos = 0;
  /** The instant of the next alarm, in ns; infinite if there is none. */
  next = Infinity;
  /** @private Scheduled alarms, the next one last. */
  alarms = [];

  /**
   * Makes an alarm, which does nothing until it is scheduled.
   *
   * @param {() => void} callback called at its instant
   */
  createAlarm(callback) {
    return new Alarm(this, callback);
  }

  /** Lets time go on to an instant in ns, calling the alarms on the way at theirs. */
  advanceTo(nanos) {
    while (this.next <= nanos) {
      const alarm = this.alarms.pop();
      this.next = this.alarms.at(-1)?.nanos ?? Infinity;
      alarm.scheduled = false;
      this.nanos = Math.max(this.nanos, alarm.nanos);
      alarm.callback();
    }
    this.nanos = Math.max(this.nanos, nanos);
  }

  /**
   * Schedules alarms that come in the order of their instants, before any other is scheduled. One by one they would
   * each pass all of the others: a script of ten minutes has a million.
   *
   * @param {{nanos: number, callback: () => void}[]} events
   */
  scheduleAll(events) {
    if (this.alarms.length > 0) throw new Error('alarms are scheduled already');
    this.alarms = events.map(({ nanos, callback }) => {
      const alarm = new Alarm(this, callback);
      return Object.assign(alarm, { nanos, scheduled: true });
    });
    this.alarms.reverse();
    this.next = this.alarms.at(-1)?.nanos ?? Infinity;
  }

  /** @private */
  insert(alarm) {
    let index = this.alarms.length;
    // Of two alarms for one instant the one scheduled first comes first.
    while (index > 0 && this.alarms[index - 1].nanos <= alarm.nanos) index--;
    this.alarms.splice(index, 0, alarm);
    this.next = this.alarms.at(-1).nanos;
  }

  /** @private */
  remove(alarm) {
    this.alarms.splice(this.alarms.lastIndexOf(alarm), 1);
    this.next = this.alarms.at(-1)?.nanos ?? Infinity;
  }
}

class Alarm {
  nanos = 0;
  scheduled = false;

  constructor(clock, callback) {
    this.clock = clock;
    this.callback = callback;
  }

  /** Calls back in so many ns, and not at the instant scheduled before. */
  schedule(delta) {
    this.cancel();
    this.nanos = this.clock.nanos + delta;
    this.scheduled = true;
    this.clock.insert(this);
  }

  /** Forgets the instant scheduled, if there is one. */
  cancel() {
    if (this.scheduled) this.clock.remove(this);
    this.scheduled = false;
  }
}

/** The time of the world as one chip sees it: once the chip is off, its alarms call nobody. */
export class ChipClock {
  /** @param {Clock} world */
  constructor(world) {
    this.world = world;
    this.isOn = true;
  }

  /** Now, in ns. */
  get nanos() {
    return this.world.nanos;
  }

  /** See {@link Clock.createAlarm}. */
  createAlarm(callback) {
    return this.world.createAlarm(() => {
      if (this.isOn) callback();
    });
  }
}
