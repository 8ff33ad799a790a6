//! The program that runs: line by line, 210 µs each, with which MC 8.2 comes to its printed end.

mod run;
#[cfg(test)]
mod tests;

use heapless::Vec;

use super::super::error::Error;
use super::super::motion::Order;
use super::super::registers::Reg;
use super::statement::{Name, Operand, Place};
use crate::device::{Duration, Instant};

/// Time of a line, that of a label, too; it is carried out at the end (MDRIVE-13).
pub(in crate::mdrive) const LINE: Duration = Duration::micros(210);

/// Depth to which CL and trips may nest; neither manual specifies it. OE's handler has an entry of its own (MDRIVE-15).
const DEPTH: usize = 16;

/// Phase of the program.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Phase {
    /// There is none.
    Idle,
    /// The line at [`Vm::address`], until then.
    Line(Instant),
    /// H, until motion is over.
    Motion,
    /// H with a time.
    Until(Instant),
    /// A single step, until a key is hit.
    Key,
}

/// Mode of running (EX's second parameter).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Mode {
    Run,
    /// Each line is shown.
    Trace,
    /// Up to the break point; single steps from there on.
    ToBreakPoint,
    /// Each line is shown and waits for a key.
    Step,
}

/// A subroutine that has been called, and what its caller goes on with.
#[derive(Clone, Copy, Debug)]
struct Call {
    address: u16,
    phase: Phase,
    /// True if OE has called it.
    handles: bool,
}

/// From where on it steps (BP).
#[derive(Clone, Copy, Debug)]
struct BreakPoint {
    address: u16,
    /// Passes left before it breaks.
    count: u16,
    left: u16,
}

/// The state of the program.
#[derive(Clone, Debug)]
pub(in crate::mdrive) struct Vm {
    phase: Phase,
    /// The next line.
    address: u16,
    /// [`DEPTH`] and one more, for OE's handler.
    calls: Vec<Call, { DEPTH + 1 }>,
    mode: Mode,
    break_point: Option<BreakPoint>,
    /// Handler of errors (OE).
    handler: Option<Place>,
    /// Calls that are due as soon as a line has ended: OE's handler, and the subroutines of trips, in the bits of TE.
    handler_is_due: bool,
    trips_due: u8,
    /// Since when PS holds it.
    paused: Option<Instant>,
    /// The variable that IV named last.
    awaited: Option<Operand>,
    /// True while a number that is typed goes there (IF).
    input_pending: bool,
    /// MA, MR or SL, whichever was the last (MD).
    last_motion: Option<Reg>,
}

impl Vm {
    pub(in crate::mdrive) const fn new() -> Self {
        Self {
            phase: Phase::Idle,
            address: 0,
            calls: Vec::new(),
            mode: Mode::Run,
            break_point: None,
            handler: None,
            handler_is_due: false,
            trips_due: 0,
            paused: None,
            awaited: None,
            input_pending: false,
            last_motion: None,
        }
    }

    /// Returns whether a program runs, or is held by PS (BY).
    pub(in crate::mdrive) fn is_running(&self) -> bool {
        self.phase != Phase::Idle
    }

    /// Returns whether PS holds program and motion.
    pub(in crate::mdrive) fn is_paused(&self) -> bool {
        self.paused.is_some()
    }

    /// Returns whether it waits for a key, after a single step.
    pub(in crate::mdrive) fn is_stepping(&self) -> bool {
        self.phase == Phase::Key && !self.is_paused()
    }

    /// Returns whether a number that is typed goes to IV's variable (IF).
    pub(in crate::mdrive) fn awaits_input(&self) -> bool {
        self.input_pending
    }

    /// IF.
    pub(in crate::mdrive) fn set_input_pending(&mut self, pending: bool) {
        self.input_pending = pending;
    }

    /// IV.
    pub(super) fn await_input(&mut self, variable: Operand) {
        (self.awaited, self.input_pending) = (Some(variable), true);
    }

    /// The variable of IV, if there was one, now that a number has come for it.
    pub(super) fn take_input(&mut self) -> Option<Operand> {
        self.input_pending = false;
        self.awaited
    }

    /// The variables that `is_gone` says are no more: nothing is waited for on their behalf.
    fn forget_input_for(&mut self, is_gone: impl Fn(Name) -> bool) {
        if let Some(Operand::User(name)) = self.awaited
            && is_gone(name)
        {
            (self.awaited, self.input_pending) = (None, false);
        }
    }

    /// MD: what a number alone repeats.
    pub(in crate::mdrive) fn last_motion(&self) -> Option<Reg> {
        self.last_motion
    }

    /// Notes a command, from any source.
    pub(in crate::mdrive) fn note_order(&mut self, order: Order) {
        match order {
            Order::To { .. } => self.last_motion = Some(Reg::MA),
            Order::By { .. } => self.last_motion = Some(Reg::MR),
            Order::Slew(_) => self.last_motion = Some(Reg::SL),
            Order::Home(_) | Order::HomeToIndex(_) => {}
        }
    }

    pub(in crate::mdrive) fn deadline(&self) -> Instant {
        match self.phase {
            Phase::Line(due) | Phase::Until(due) if !self.is_paused() => due,
            _ => Instant::NEVER,
        }
    }

    /// A key while it [is stepping](Self::is_stepping): the next line or, if not, all the others at full speed
    /// (MC 5-24, 6.1.9).
    pub(in crate::mdrive) fn step(&mut self, at: Instant, one: bool) {
        if self.is_stepping() {
            self.phase = Phase::Line(at + LINE);
            if !one {
                self.mode = Mode::Run;
            }
        }
    }

    /// BP: steps from there on, once `count` more have passed; `None` for never.
    pub(super) fn set_break_point(&mut self, address: Option<u16>, count: u16) {
        self.break_point = address.map(|address| BreakPoint { address, count, left: count });
    }

    /// Sets the handler of errors (OE).
    pub(super) fn set_handler(&mut self, handler: Option<Place>) {
        self.handler = handler;
    }

    /// The next line is another one (BR).
    pub(super) fn jump(&mut self, address: u16) {
        self.address = address;
    }

    /// CL, a trip, or OE's handler (`handles`): goes on with the line at `address`, and then with what it is at.
    ///
    /// # Errors
    /// 43: too many have not returned.
    pub(super) fn call(&mut self, at: Instant, address: u16, handles: bool) -> Result<(), Error> {
        let callers = self.calls.iter().filter(|call| !call.handles).count();
        if !handles && callers == DEPTH {
            return Err(Error::TooManyCalls);
        }
        let call = Call { address: self.address, phase: self.phase, handles };
        self.calls.push(call).map_err(|_| Error::TooManyCalls)?;
        if self.phase == Phase::Idle {
            self.mode = Mode::Run;
        }
        self.address = address;
        self.begin(at);
        Ok(())
    }

    /// RT: the caller goes on. An H with a time has gone on meanwhile.
    ///
    /// # Errors
    /// 41: there is no call to return from.
    pub(super) fn ret(&mut self, at: Instant) -> Result<(), Error> {
        let call = self.calls.pop().ok_or(Error::StackOverflow)?;
        (self.address, self.phase) = (call.address, call.phase);
        match self.phase {
            Phase::Line(_) => self.begin(at),
            Phase::Until(due) if due <= at => self.begin(at),
            Phase::Until(_) | Phase::Motion | Phase::Key | Phase::Idle => {}
        }
        Ok(())
    }

    /// H: until then, or until motion is over.
    pub(super) fn set_hold(&mut self, until: Option<Instant>) {
        self.phase = until.map_or(Phase::Motion, Phase::Until);
    }

    fn end(&mut self) {
        self.phase = Phase::Idle;
        self.calls.clear();
        (self.handler_is_due, self.trips_due) = (false, 0);
        self.paused = None;
    }

    /// The line at the address begins; a single step waits for a key before that.
    fn begin(&mut self, at: Instant) {
        if self.breaks() {
            self.mode = Mode::Step;
        }
        self.phase = if self.mode == Mode::Step { Phase::Key } else { Phase::Line(at + LINE) };
    }

    /// Returns whether it comes to its break point for the last time.
    fn breaks(&mut self) -> bool {
        let Some(point) = &mut self.break_point else { return false };
        if !matches!(self.mode, Mode::Trace | Mode::ToBreakPoint) || point.address != self.address {
            return false;
        }
        let breaks = point.left == 0;
        point.left = point.left.saturating_sub(1);
        breaks
    }

    /// Returns whether the next line waits for the end of motion.
    fn waits_for_motion(&self) -> bool {
        self.phase == Phase::Motion && !self.is_paused()
    }

    /// Returns whether a call is due.
    fn is_interrupted(&self) -> bool {
        self.handler_is_due || self.trips_due != 0
    }

    /// Returns whether an error's handler runs: errors of its own do not call it again.
    fn handles(&self) -> bool {
        self.calls.iter().any(|call| call.handles)
    }

    /// The program was held for `span`: all its times are later by as much.
    fn shift(&mut self, span: Duration) {
        let phases = self.calls.iter_mut().map(|call| &mut call.phase);
        for phase in phases.chain([&mut self.phase]) {
            if let Phase::Line(due) | Phase::Until(due) = phase {
                *due += span;
            }
        }
    }
}
