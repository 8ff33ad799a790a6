// Says when the bench's time is not the person's: after a hidden tab, or when the bench is too slow.

const OVER = 3000; // milliseconds over which the speed is measured
const SLOW = 0.7; // part of the time that a bench in time runs at least

let app = null, done = 0, passed = 0, slow = 0;

export const notes = {
  begin(frame) {
    app = frame;
  },
  /** The bench has run for `ran` of `elapsed` milliseconds; `wasHidden` if nobody could see it in between. */
  ran(ran, elapsed, wasHidden) {
    if (wasHidden) {
      done = passed = 0;
      if (elapsed > 1000) app?.say(`The bench stood still for ${Math.round(elapsed / 1000)} s, while this page was hidden.`);
      return;
    }
    done += ran;
    passed += elapsed;
    if (passed < OVER) return;
    slow = done < SLOW * passed ? slow + 1 : 0;
    if (slow === 2) app?.say(`This browser does not run the bench that fast: its time goes at ${Math.round(done / passed * 100)} % of the chosen speed.`);
    done = passed = 0;
  },
};
