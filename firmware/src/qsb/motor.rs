//! The motor drive of a QSB-M: moves and jogs, with step pulses on DIO1 and their direction on DIO2 (COMMAND
//! 2 and 4 to 9, MD STEP RATE to MD STATUS).

use fixed::types::{I24F8, U24F8};

use super::reasons::Why;
use super::{AXIS, DIO1, DIO2};
use crate::device::{Context, Duration, Instant, Level, Output, Plan};
use crate::motion::{Limits, SETUP, StepIterator};

/// Orders of the motor's commands (COMMAND 4 to 9).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Order {
    /// Slow down, and end the motion.
    Stop,
    /// End the motion at once.
    Quit,
    /// Slow down, and keep the remaining steps.
    Pause,
    /// Continue the paused motion.
    Resume,
    /// Make MD MOVE STEPS.
    Move,
    /// Turn at MD JOG RATE until the next order.
    Jog,
}

/// Speeds in steps/s and accelerations in steps/s² are rounded to a multiple of this.
pub(super) const UNIT: i64 = 16;

/// The registers 0F to 12, as written. An order reads its parameters from them; a later write does not change
/// a running motion. A jog below 16 steps/s makes no steps, but counts as running.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Settings {
    /// MD STEP RATE in steps/s, used in multiples of 16.
    pub(super) step_rate: u16,
    /// MD ACCEL in steps/s², used in multiples of 16.
    pub(super) acceleration: u32,
    /// MD MOVE STEPS.
    pub(super) steps: i32,
    /// MD JOG RATE in steps/s, used in multiples of 16, rounded towards 0.
    pub(super) jog_rate: i32,
}

impl Settings {
    fn acceleration(&self) -> u32 {
        self.acceleration & !15
    }

    fn jog(&self) -> Motion {
        Motion::Jog { speed: I24F8::saturating_from_num(self.jog_rate / 16 * 16) }
    }
}

/// Bits of MD STATUS.
const READY: u8 = 1 << 0;
const MOVING: u8 = 1 << 1;
const PAUSED: u8 = 1 << 2;
const JOGGING: u8 = 1 << 3;
const ACTIVE: u8 = 1 << 4;

/// A motion that was ordered.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Motion {
    /// A move to the position `end`.
    Move { end: i32, speed: U24F8 },
    /// A jog without end. At speed 0 it makes no steps, but does not end.
    Jog { speed: I24F8 },
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// DIO1 and DIO2 do not belong to the motor drive.
    Inactive,
    Ready,
    Runs(Motion),
    /// The motor slows down; the motion ends at standstill.
    Stops(Motion),
    /// The motor slows down; at standstill the motion is paused. If an order to resume has arrived meanwhile,
    /// the motion instead continues at standstill, with that order's acceleration.
    Pauses(Motion, Option<u32>),
    Paused(Motion),
}

/// The motor drive.
#[derive(Clone, Debug)]
pub(super) struct Motor {
    state: State,
    plan: Plan,
    /// Steps that a board has made outside the plan since the plan was made.
    step_offset: i32,
    /// The level of DIO2 until `reversal_at`; from then on the opposite level.
    forward: bool,
    reversal_at: Instant,
}

impl Motor {
    /// An inactive motor drive at standstill at position 0.
    pub(super) fn new(at: Instant) -> Self {
        Self {
            state: State::Inactive,
            plan: Plan::at_rest(at, 0),
            step_offset: 0,
            forward: false,
            reversal_at: Instant::NEVER,
        }
    }

    /// Returns true if DIO1 and DIO2 belong to the motor drive.
    pub(super) fn is_active(&self) -> bool {
        self.state != State::Inactive
    }

    /// Takes DIO1 and DIO2, and sets them low until the first step (COMMAND 2).
    pub(super) fn activate(&mut self, at: Instant, out: &mut dyn Context) {
        if self.is_active() {
            return;
        }
        for pin in [DIO1, DIO2] {
            out.put(at, Output::Level { pin, level: Level::Low });
        }
        (self.state, self.forward, self.reversal_at) = (State::Ready, false, Instant::NEVER);
        self.halt(at, out);
    }

    /// Stops at once, and releases DIO1 and DIO2. The caller then sets their levels (COMMAND 0).
    pub(super) fn deactivate(&mut self, at: Instant, out: &mut dyn Context) {
        if self.is_active() {
            self.halt(at, out);
            self.state = State::Inactive;
        }
    }

    /// Executes an order. Returns true if the order is allowed. Stop, quit, pause and resume are always
    /// allowed; without a motion they do nothing. A move and a jog need an active motor drive. A move is
    /// allowed only while no motion runs or is paused. A jog may also replace another jog, even one that is
    /// paused or slows down (QSB-27).
    pub(super) fn order(
        &mut self,
        at: Instant,
        order: Order,
        with: &Settings,
        out: &mut dyn Context,
    ) -> bool {
        self.timeout(at, out);
        match (order, self.state) {
            (Order::Move, State::Ready) => {
                if with.steps == 0 {
                    Why::NoSteps.put(at, out);
                }
                let end = self.position(at).wrapping_add(with.steps);
                let speed = U24F8::from(with.step_rate & !15);
                self.run(at, Motion::Move { end, speed }, with.acceleration(), out);
            }
            (Order::Move, _) | (Order::Jog, State::Inactive) => return false,
            (Order::Jog, _) => {
                if let Some(Motion::Move { .. }) = self.motion() {
                    return false;
                }
                let jog = with.jog();
                let rests = matches!(jog, Motion::Jog { speed } if speed == I24F8::ZERO);
                if rests && matches!(self.state, State::Ready) {
                    Why::NoJogRate.put(at, out);
                }
                self.run(at, jog, with.acceleration(), out);
            }
            (_, State::Inactive) => Why::NotActive.put(at, out),
            (_, State::Ready) => Why::NothingMoves.put(at, out),
            (Order::Quit, _) => {
                self.state = State::Ready;
                self.halt(at, out);
            }
            (Order::Stop, State::Paused(_)) => self.state = State::Ready,
            (Order::Stop, State::Runs(motion) | State::Stops(motion) | State::Pauses(motion, _)) => {
                self.slow_down(at, State::Stops(motion), with.acceleration(), out);
            }
            (Order::Pause, State::Runs(motion)) => {
                self.slow_down(at, State::Pauses(motion, None), with.acceleration(), out);
            }
            (Order::Pause, State::Pauses(motion, _)) => self.state = State::Pauses(motion, None),
            // A profile begins at standstill, so a resumed move waits until the motor stands still.
            (Order::Resume, State::Pauses(motion @ Motion::Move { .. }, _)) => {
                self.state = State::Pauses(motion, Some(with.acceleration()));
            }
            (Order::Resume, State::Pauses(motion, _) | State::Paused(motion)) => {
                self.run(at, motion, with.acceleration(), out);
            }
            (Order::Pause, _) => {}
            (Order::Resume, _) => Why::NotPaused.put(at, out),
        }
        true
    }

    /// Value of MD STATUS (QSB-28).
    pub(super) fn status(&self, at: Instant) -> u8 {
        let bits = match if self.over() <= at { self.next() } else { self.state } {
            State::Inactive => return READY,
            State::Ready => READY,
            State::Paused(_) => PAUSED,
            State::Runs(motion) | State::Stops(motion) | State::Pauses(motion, _) => match motion {
                Motion::Move { .. } => MOVING,
                Motion::Jog { .. } => JOGGING,
            },
        };
        ACTIVE | bits
    }

    /// The level of DIO2: high from [`SETUP`] before a step forward until [`SETUP`] before a step back.
    pub(super) fn is_forward(&self, at: Instant) -> bool {
        self.forward != (at >= self.reversal_at)
    }

    /// Time at which the motion ends, or DIO2 changes.
    pub(super) fn deadline(&self) -> Instant {
        self.reversal_at.min(self.over())
    }

    /// Handles the deadline.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        self.reverse(at);
        if self.over() <= at {
            match self.state {
                State::Pauses(motion, Some(acceleration)) => self.run(at, motion, acceleration, out),
                _ => self.state = self.next(),
            }
        }
    }

    /// A board has made `steps` more steps than the plan has.
    pub(super) fn correct_steps(&mut self, steps: i32) {
        self.step_offset = self.step_offset.wrapping_add(steps);
    }

    /// Returns true if a motion runs or is paused.
    pub(super) fn has_motion(&self) -> bool {
        self.motion().is_some()
    }

    /// The motion that runs or is paused.
    fn motion(&self) -> Option<Motion> {
        match self.state {
            State::Inactive | State::Ready => None,
            State::Runs(motion) | State::Stops(motion) | State::Pauses(motion, _) | State::Paused(motion) => {
                Some(motion)
            }
        }
    }

    /// End of the present motion; [`Instant::NEVER`] if it does not end by itself.
    fn over(&self) -> Instant {
        match self.state {
            State::Runs(Motion::Move { .. }) | State::Stops(_) | State::Pauses(..) => self.plan.end(),
            // The ramp of a jog also ends at speed 0, but the jog continues.
            State::Runs(Motion::Jog { .. }) | State::Inactive | State::Ready | State::Paused(_) => {
                Instant::NEVER
            }
        }
    }

    /// State after [`Motor::over`].
    fn next(&self) -> State {
        match self.state {
            State::Pauses(motion, Some(_)) => State::Runs(motion),
            State::Pauses(motion, None) => State::Paused(motion),
            _ => State::Ready,
        }
    }

    /// Starts or continues a motion. Before a move the motor stands still.
    fn run(&mut self, at: Instant, motion: Motion, acceleration: u32, out: &mut dyn Context) {
        let from = self.position(at);
        let plan = match motion {
            Motion::Move { end, speed } => {
                Plan::profile(at, from, end.wrapping_sub(from), Limits::even(speed, acceleration))
            }
            Motion::Jog { speed } => self.plan.continued_from(at, from).ramp_to(at, speed, acceleration),
        };
        self.state = State::Runs(motion);
        self.start_plan(at, plan, out);
    }

    /// Ramps to standstill as `state`, one of the slowing states. A move never makes more than its last step:
    /// if the new acceleration is too small for that, the old ramp is kept (QSB-29).
    fn slow_down(&mut self, at: Instant, state: State, acceleration: u32, out: &mut dyn Context) {
        self.state = state;
        let from = self.position(at);
        let plan = self.plan.continued_from(at, from).ramp_to(at, I24F8::ZERO, acceleration);
        if let Some(Motion::Move { end, .. }) = self.motion() {
            let left = |position: i32| end.wrapping_sub(position).signum();
            if left(from) * left(plan.position_at(Instant::NEVER)) < 0 {
                return;
            }
        }
        self.start_plan(at, plan, out);
    }

    /// Stops at once.
    fn halt(&mut self, at: Instant, out: &mut dyn Context) {
        let position = self.position(at);
        self.start_plan(at, Plan::at_rest(at, position), out);
    }

    /// Starts `plan`. If the plan has no duration, its end is handled now.
    fn start_plan(&mut self, at: Instant, plan: Plan, out: &mut dyn Context) {
        self.reverse(at);
        (self.plan, self.step_offset) = (plan, 0);
        out.put(at, Output::Plan { axis: AXIS, plan: &self.plan });
        self.reversal_at = self.next_turn(at);
        if self.over() <= at {
            self.state = self.next();
        }
    }

    /// Changes DIO2 if that is due.
    fn reverse(&mut self, at: Instant) {
        if self.reversal_at <= at {
            self.forward = !self.forward;
            self.reversal_at = self.next_turn(at);
        }
    }

    /// Time of the next change of DIO2 after `at`: [`SETUP`] before a step in the other direction, or at once
    /// (QSB-30).
    fn next_turn(&self, at: Instant) -> Instant {
        let same = self.plan.segments().iter().take_while(|segment| segment.reverse != self.forward);
        let end = same.fold(self.plan.start(), |at, segment| at + Duration::from_ticks(segment.ticks));
        match StepIterator::new(&self.plan, at.max(end)).next() {
            Some(step) if step.forward != self.forward => (step.at - SETUP).max(at),
            _ => Instant::NEVER,
        }
    }

    fn position(&self, at: Instant) -> i32 {
        self.plan.position_at(at).wrapping_add(self.step_offset)
    }
}

#[cfg(test)]
mod tests;
