//! The contacts IN1, IN2 and HARD_STOP, and their functions in the five modes of MODE_EXT_IN (6.1, 6.5).

use super::motion::Heading;
use super::{IN1, IN2};
use crate::debounce::Debounce;
use crate::device::{Duration, Instant, Pin};

/// A contact, which is debounced (6.1, Fig. 5).
#[derive(Clone, Copy, Debug)]
struct Contact {
    /// Present state: true while the contact is closed.
    closed: bool,
    /// Debounced state. It becomes true after the contact was closed for long enough, and false after it was
    /// open for long enough.
    debounced: Debounce,
}

impl Contact {
    const OPEN: Self = Self { closed: false, debounced: Debounce::new(false) };

    /// Makes the present state the debounced state.
    fn accept(&mut self) {
        self.debounced = Debounce::new(self.closed);
    }

    /// Handles a change. A closed contact must stay closed for `pressed`, an open one open for `waited`.
    fn change(&mut self, at: Instant, closed: bool, [pressed, waited]: [Duration; 2]) {
        if closed != self.closed {
            self.closed = closed;
            self.debounced.note(at, closed, if closed { pressed } else { waited });
        }
    }

    /// Returns true in the debounced state "closed".
    fn is_on(&self) -> bool {
        self.debounced.level()
    }
}

/// Orders of the contacts. The direction comes first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Orders {
    pub(super) direction: Option<Direction>,
    pub(super) run: Option<Run>,
}

/// New value of DIRECTION.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Direction {
    Forward,
    Backward,
    /// The other direction.
    Reversed,
}

/// Start or stop.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Run {
    Stop,
    Start(Heading),
    /// Starts a motor at standstill, stops one that moves.
    Toggle,
}

/// Present states of the drive's contacts and of its Hall sensors.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inputs {
    in1: Contact,
    in2: Contact,
    /// True while the emergency stop is closed: the motor may move.
    hard_stop: bool,
    /// True for each of the Hall sensors A and B that is high; `None` before its first event.
    halls: [Option<bool>; 2],
}

impl Inputs {
    /// States of inputs without any wire.
    pub(super) const OPEN: Self =
        Self { in1: Contact::OPEN, in2: Contact::OPEN, hard_stop: true, halls: [None; 2] };

    /// Handles a change of IN1, IN2 or HARD_STOP. A closed contact must stay closed for the first of `times`, an open one
    /// open for the second.
    pub(super) fn contact(&mut self, at: Instant, pin: Pin, closed: bool, times: [Duration; 2]) {
        match pin {
            IN1 => self.in1.change(at, closed, times),
            IN2 => self.in2.change(at, closed, times),
            _ => self.hard_stop = closed,
        }
    }

    /// Handles a change of Hall sensor A (`a`) or B.
    pub(super) fn hall(&mut self, a: bool, high: bool) {
        let [of_a, of_b] = &mut self.halls;
        *if a { of_a } else { of_b } = Some(high);
    }

    /// Levels of the Hall sensors, as far as known; true stands before that of sensor A.
    pub(super) fn halls(&self) -> impl Iterator<Item = (bool, bool)> + use<> {
        let [a, b] = self.halls;
        [(true, a), (false, b)].into_iter().filter_map(|(is_a, high)| Some((is_a, high?)))
    }

    /// Present state of a contact, not debounced.
    pub(super) fn is_closed(&self, pin: Pin) -> bool {
        match pin {
            IN1 => self.in1.closed,
            IN2 => self.in2.closed,
            _ => self.hard_stop,
        }
    }

    /// Stops waiting for contacts. A drive that becomes ready uses the states at that time.
    pub(super) fn cancel_debounce(&mut self) {
        self.in1.debounced.cancel();
        self.in2.debounced.cancel();
    }

    /// Makes the present states of the contacts the debounced ones.
    pub(super) fn accept(&mut self) {
        self.in1.accept();
        self.in2.accept();
    }

    pub(super) fn deadline(&self) -> Instant {
        self.in1.debounced.due().min(self.in2.debounced.due())
    }

    /// Orders of the contacts whose state has lasted long enough. `mode` is MODE_EXT_IN, or 0 if the bus controls the
    /// motor.
    pub(super) fn timeout(&mut self, at: Instant, mode: u16) -> Option<Orders> {
        let (first, second) = (self.in1.debounced.timeout(at), self.in2.debounced.timeout(at));
        if !first && !second {
            return None;
        }
        let levels = self.levels(mode);
        // A pulse ends when its contact opens (RS434-21).
        let pulse_1 = first && !self.in1.is_on();
        let pulse_2 = second && !self.in2.is_on();
        Some(Orders {
            direction: match mode {
                1 | 3 => pulse_2.then_some(Direction::Reversed),
                _ => levels.direction.filter(|_| second),
            },
            run: match mode {
                1 | 2 => pulse_1.then_some(Run::Toggle),
                3 | 4 => levels.run.filter(|_| first),
                _ => levels.run,
            },
        })
    }

    /// Orders of the present levels (RS434-22), with `mode` as for [`timeout`](Self::timeout).
    pub(super) fn levels(&self, mode: u16) -> Orders {
        let (first, second) = (self.in1.is_on(), self.in2.is_on());
        Orders {
            // Closed means backward.
            direction: matches!(mode, 2 | 4).then_some(if second {
                Direction::Backward
            } else {
                Direction::Forward
            }),
            run: match mode {
                3 | 4 => Some(if first { Run::Start(Heading::Registers) } else { Run::Stop }),
                // With both closed the motor stops. For a move to a position either input will do.
                5 => Some(match (first, second) {
                    (true, false) => Run::Start(Heading::Forward),
                    (false, true) => Run::Start(Heading::Backward),
                    _ => Run::Stop,
                }),
                _ => None,
            },
        }
    }
}
