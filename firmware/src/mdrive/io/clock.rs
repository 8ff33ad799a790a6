//! Clock points I/O 7 and 8: inputs for pulses that the motor follows, or outputs for its own steps (MC 5-13
//! to 5-15, 5-66).

use super::super::error::Error;
use super::super::{IO7, IO8};
use super::point::flag;
use crate::counter::a_leads;
use crate::debounce::Debounce;
use crate::device::{Context, Duration, Instant, Level, Output, Pin, Plan};
use crate::motion::{SETUP, Step, StepIterator};

/// Coding of steps as pulses.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Code {
    /// A pulse at I/O 7 for each step; I/O 8 is active for backward steps.
    StepDirection,
    /// An edge for each step; I/O 7 leads I/O 8 in forward motion.
    Quadrature,
    /// A pulse for each step, at I/O 7 forward, at I/O 8 backward.
    UpDown,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Kind {
    ClockInput(Code),
    ClockOutput(Code),
}

impl Kind {
    fn of(code: u16) -> Option<Self> {
        Some(match code {
            33 => Self::ClockInput(Code::StepDirection),
            34 => Self::ClockInput(Code::Quadrature),
            35 => Self::ClockInput(Code::UpDown),
            49 => Self::ClockOutput(Code::StepDirection),
            50 => Self::ClockOutput(Code::Quadrature),
            51 => Self::ClockOutput(Code::UpDown),
            _ => return None,
        })
    }
}

/// A clock point.
#[derive(Clone, Copy, Debug)]
struct Point {
    active_high: bool,
    debounced: Debounce,
    driven: Level,
}

impl Point {
    const OPEN: Self = Self { active_high: false, debounced: Debounce::new(true), driven: Level::Float };

    fn is_active(&self) -> bool {
        self.debounced.level() == self.active_high
    }

    fn put(&mut self, at: Instant, pin: Pin, level: Level, out: &mut dyn Context) {
        if level != self.driven {
            self.driven = level;
            out.put(at, Output::Level { pin, level });
        }
    }

    fn drive_pins(&mut self, at: Instant, pin: Pin, active: bool, out: &mut dyn Context) {
        let level = if active == self.active_high { Level::High } else { Level::Low };
        self.put(at, pin, level, out);
    }
}

/// I/O 7 and 8.
#[derive(Clone, Debug)]
pub(super) struct Clock {
    /// Function of both points, which always have the same type (MC 5-66; MDRIVE-32).
    kind: Kind,
    seven: Point,
    eight: Point,
    /// CM: true in clock mode.
    enabled: bool,
    /// Clock ratio CR, in thousandths.
    ratio: i32,
    /// Steps of the clock inputs that are not handled yet, and thousandths of a further step.
    steps: i32,
    remainder: i32,
    /// True if clock outputs need a plan.
    is_new: bool,
    train: PulseTrain,
}

/// Output pulses of the motor's steps.
#[derive(Clone, Debug)]
struct PulseTrain {
    steps: StepIterator,
    next: Option<Step>,
    /// Time of the last step, or of the last change of the plan.
    last: Instant,
    /// Direction that the outputs show.
    backward: bool,
    /// Number of edges of the quadrature.
    phase: i32,
    /// End of the pulse; [`Instant::NEVER`] between pulses.
    ends: Instant,
}

impl PulseTrain {
    const NONE: Self = Self {
        steps: StepIterator::done(),
        next: None,
        last: Instant::ZERO,
        backward: false,
        phase: 0,
        ends: Instant::NEVER,
    };

    /// Time at which the direction output changes for the next step, if that step reverses the direction:
    /// [`SETUP`] before the step, or in the middle between the steps if they are too close.
    fn turns(&self) -> Option<Instant> {
        let Step { at, forward } = self.next?;
        let half = Duration::from_ticks(at.since(self.last).ticks() / 2);
        (forward == self.backward).then(|| at - SETUP.min(half))
    }

    fn due(&self) -> Instant {
        let step = self.next.map_or(Instant::NEVER, |next| next.at);
        self.turns().unwrap_or(step).min(self.ends)
    }
}

impl Clock {
    /// Step and direction inputs, active low, that nothing drives.
    pub(super) const OPEN: Self = Self {
        kind: Kind::ClockInput(Code::StepDirection),
        seven: Point::OPEN,
        eight: Point::OPEN,
        enabled: false,
        ratio: 1_000,
        steps: 0,
        remainder: 0,
        is_new: false,
        train: PulseTrain::NONE,
    };

    /// Restarts with the factory's settings. The levels stay as they are.
    pub(super) fn restart(&mut self, at: Instant, out: &mut dyn Context) {
        for (point, pin) in [(&mut self.seven, IO7), (&mut self.eight, IO8)] {
            point.put(at, pin, Level::Float, out);
            *point = Point { debounced: point.debounced, ..Point::OPEN };
        }
        *self = Self { seven: self.seven, eight: self.eight, ..Self::OPEN };
    }

    /// S7 or S8: sets the type of both points, and the active state of this one.
    ///
    /// # Errors
    /// Error 11 for the type, 21 for the state.
    pub(super) fn set_up(
        &mut self,
        at: Instant,
        pin: Pin,
        [kind, active_high]: [u16; 2],
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let kind = Kind::of(kind).ok_or(Error::IllegalClockType)?;
        let active_high = flag(active_high)?;
        self.kind = kind;
        if let Some(point) = self.point(pin) {
            point.active_high = active_high;
        }
        self.begin(at, out);
        Ok(())
    }

    /// Sets CM, and CR in thousandths.
    pub(super) fn set(&mut self, at: Instant, enabled: bool, ratio: u16, out: &mut dyn Context) {
        self.ratio = ratio.into();
        if enabled != self.enabled {
            self.enabled = enabled;
            self.begin(at, out);
        }
    }

    /// Returns true if the motor follows pulses.
    pub(super) fn follows(&self) -> bool {
        matches!(self.kind(), Some(Kind::ClockInput(_)))
    }

    /// Returns true if clock outputs are new and still need the motion's plan.
    pub(super) fn wants_plan(&self) -> bool {
        self.is_new
    }

    /// Makes clock outputs follow a new plan.
    pub(super) fn plan(&mut self, at: Instant, plan: &Plan, width: Duration, out: &mut dyn Context) {
        self.is_new = false;
        if let Some(Kind::ClockOutput(_)) = self.kind() {
            // A step of the old plan that is due at this instant is still put out.
            while self.train.due() <= at {
                self.timeout(at, width, out);
            }
            let train = &mut self.train;
            train.steps.restart(plan, at);
            train.next = train.steps.next();
            // The next step was unknown before now, so its direction does not change earlier.
            train.last = train.last.max(at);
        }
    }

    /// Sets the level of a point, which takes effect once it has lasted for `min_time`.
    pub(super) fn sample(&mut self, at: Instant, pin: Pin, high: bool, min_time: Duration) {
        let changed = self.point(pin).is_some_and(|point| point.debounced.sample(at, high, min_time));
        if changed {
            self.count_edge(pin);
        }
    }

    /// Takes the steps that the motor is to follow, signed.
    pub(super) fn take_clock_steps(&mut self) -> Option<i32> {
        let steps = core::mem::take(&mut self.steps);
        (steps != 0).then_some(steps)
    }

    pub(super) fn deadline(&self) -> Instant {
        self.seven.debounced.due().min(self.eight.debounced.due()).min(self.train.due())
    }

    pub(super) fn timeout(&mut self, at: Instant, width: Duration, out: &mut dyn Context) {
        // If both are due at once, the direction (I/O 8) changes before the pulse.
        for pin in [IO8, IO7] {
            if self.point(pin).is_some_and(|point| point.debounced.timeout(at)) {
                self.count_edge(pin);
            }
        }
        if self.train.ends <= at {
            self.train.ends = Instant::NEVER;
            self.drive_pins(at, None, out);
        }
        if self.train.turns().is_some_and(|turns| turns <= at) {
            self.train.backward = !self.train.backward;
            self.drive_pins(at, None, out);
        } else if let Some(step) = self.train.next.filter(|step| step.at <= at) {
            self.put_step(step, width, out);
        }
    }

    /// Function of both points; `None` while CM is 0.
    fn kind(&self) -> Option<Kind> {
        self.enabled.then_some(self.kind)
    }

    fn point(&mut self, pin: Pin) -> Option<&mut Point> {
        match pin {
            IO7 => Some(&mut self.seven),
            IO8 => Some(&mut self.eight),
            _ => None,
        }
    }

    /// Applies CM and the set-ups.
    fn begin(&mut self, at: Instant, out: &mut dyn Context) {
        (self.steps, self.remainder, self.train) = (0, 0, PulseTrain::NONE);
        self.is_new = matches!(self.kind(), Some(Kind::ClockOutput(_)));
        if self.is_new {
            self.drive_pins(at, None, out);
        } else {
            self.seven.put(at, IO7, Level::Float, out);
            self.eight.put(at, IO8, Level::Float, out);
        }
    }

    /// Counts the step of a point's new level, if there is one.
    fn count_edge(&mut self, pin: Pin) {
        let Some(Kind::ClockInput(code)) = self.kind() else { return };
        let (seven, eight) = (self.seven.is_active(), self.eight.is_active());
        let step = match (code, pin) {
            (Code::StepDirection, IO7) if seven => {
                if eight {
                    -1
                } else {
                    1
                }
            }
            (Code::UpDown, IO7) if seven => 1,
            (Code::UpDown, IO8) if eight => -1,
            (Code::Quadrature, IO7 | IO8) => {
                if a_leads(pin == IO7, seven, eight) {
                    1
                } else {
                    -1
                }
            }
            _ => return,
        };
        self.remainder += step * self.ratio;
        self.steps = self.steps.saturating_add(self.remainder.div_euclid(1_000));
        self.remainder = self.remainder.rem_euclid(1_000);
    }

    /// Puts out the pulse or edge of a step.
    fn put_step(&mut self, step: Step, width: Duration, out: &mut dyn Context) {
        if self.train.ends != Instant::NEVER {
            // The previous pulse has not ended, because a new plan has brought this step closer.
            self.drive_pins(step.at, None, out);
        }
        let train = &mut self.train;
        train.next = train.steps.next();
        train.last = step.at;
        train.phase = train.phase.wrapping_add(if step.forward { 1 } else { -1 });
        // A pulse ends half-way to the next step at the latest.
        let gap = train.next.map_or(Duration::FOREVER, |next| next.at.since(step.at));
        train.ends = step.at + width.min(Duration::from_ticks(gap.ticks() / 2)).max(Duration::TICK);
        self.drive_pins(step.at, Some(step.forward), out);
    }

    /// Drives the pins. `pulse` is the direction of the present pulse, true for forward.
    fn drive_pins(&mut self, at: Instant, pulse: Option<bool>, out: &mut dyn Context) {
        let Some(Kind::ClockOutput(code)) = self.kind() else { return };
        let (seven, eight) = match code {
            Code::StepDirection => (pulse.is_some(), self.train.backward),
            Code::UpDown => (pulse == Some(true), pulse == Some(false)),
            Code::Quadrature => (matches!(self.train.phase & 3, 1 | 2), self.train.phase & 2 != 0),
        };
        // The direction changes before its pulse.
        self.eight.drive_pins(at, IO8, eight, out);
        self.seven.drive_pins(at, IO7, seven, out);
    }
}
