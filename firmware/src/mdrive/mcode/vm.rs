//! Execution of the program, line by line, 210 µs each. With this time the program of MC 8.2 ends as printed.

#[cfg(test)]
mod tests;

use heapless::Vec;

use super::super::error::Error;
use super::super::motion::Order;
use super::super::reasons::Why;
use super::super::registers::Reg;
use super::names::Name;
use super::operand::{Operand, Place, Trip};
use super::trip::Trips;
use crate::device::{Duration, Instant};

/// Execution time of a line, also of a label. The line takes effect at the end of this time (MDRIVE-13).
pub(in crate::mdrive) const LINE: Duration = Duration::micros(210);

/// Maximum depth of calls by CL and trips; neither manual specifies it. OE's handler has an entry of its own
/// (MDRIVE-15).
const DEPTH: usize = 16;

/// Phase of the program.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Phase {
    /// No program runs.
    Idle,
    /// Executing the line at [`Vm::address`], until this time.
    Line(Instant),
    /// H without a time: waiting for the end of motion.
    Motion,
    /// H with a time: waiting until this time.
    Until(Instant),
    /// Single step: waiting for a key.
    Key,
}

/// Mode of running (EX's second parameter).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Mode {
    Run,
    /// Each line is printed.
    Trace,
    /// Runs up to the break point, then in single steps.
    ToBreakPoint,
    /// Each line is printed and waits for a key.
    Step,
}

/// A subroutine call: the caller continues with this address and phase.
#[derive(Clone, Copy, Debug)]
struct Call {
    address: u16,
    phase: Phase,
    /// True if this is a call of OE's handler.
    handles: bool,
}

/// Break point (BP), from which the program runs in single steps.
#[derive(Clone, Copy, Debug)]
struct BreakPoint {
    address: u16,
    /// Number of times that the program passes this line before it breaks.
    count: u16,
    /// Number of these passes that are left.
    left: u16,
}

/// A pending call of a subroutine.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Interrupt {
    pub(super) place: Place,
    /// True if this is a call of OE's handler.
    pub(super) handles: bool,
}

/// The state of the program.
#[derive(Clone, Debug)]
pub(in crate::mdrive) struct Vm {
    phase: Phase,
    /// Address of the next line.
    address: u16,
    /// [`DEPTH`] calls, and one for OE's handler.
    calls: Vec<Call, { DEPTH + 1 }>,
    mode: Mode,
    break_point: Option<BreakPoint>,
    /// Handler of errors (OE).
    handler: Option<Place>,
    /// Calls that are made as soon as a line has ended: OE's handler, and the subroutines of trips, in the
    /// bits of TE.
    handler_is_due: bool,
    trips_due: u8,
    /// Time since which the program is paused (PS).
    paused: Option<Instant>,
    /// The variable that IV named last.
    awaited: Option<Operand>,
    /// True while a typed number is for `awaited` (IF).
    input_pending: bool,
    /// The last motion command: MA, MR or SL (MD).
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

    /// Returns true if a program runs or is paused (BY).
    pub(in crate::mdrive) fn is_running(&self) -> bool {
        self.phase != Phase::Idle
    }

    /// Address of the line that is executed next, if a program runs or is paused.
    pub(in crate::mdrive) fn next_line(&self) -> Option<u16> {
        self.is_running().then_some(self.address)
    }

    /// Returns true if PS has paused program and motion.
    pub(in crate::mdrive) fn is_paused(&self) -> bool {
        self.paused.is_some()
    }

    /// Returns true if the program waits for a key after a single step.
    pub(in crate::mdrive) fn is_stepping(&self) -> bool {
        self.phase == Phase::Key && !self.is_paused()
    }

    /// Returns true if a typed number goes to IV's variable (IF).
    pub(in crate::mdrive) fn awaits_input(&self) -> bool {
        self.input_pending
    }

    /// Sets IF: true while a typed number is for IV's variable.
    pub(in crate::mdrive) fn set_input_pending(&mut self, pending: bool) {
        self.input_pending = pending;
    }

    /// IV: begins to wait for a number for this variable.
    pub(in crate::mdrive) fn await_input(&mut self, variable: Operand) {
        (self.awaited, self.input_pending) = (Some(variable), true);
    }

    /// Takes the variable that IV named, if any, because a number for it has been typed.
    pub(in crate::mdrive) fn take_input(&mut self) -> Option<Operand> {
        self.input_pending = false;
        self.awaited
    }

    /// Ends the wait of IV if its variable does not exist any more, according to `is_gone`.
    pub(super) fn forget_input_for(&mut self, is_gone: impl Fn(Name) -> bool) {
        if let Some(Operand::User(name)) = self.awaited
            && is_gone(name)
        {
            (self.awaited, self.input_pending) = (None, false);
        }
    }

    /// MD: the motion command that a number alone repeats.
    pub(in crate::mdrive) fn last_motion(&self) -> Option<Reg> {
        self.last_motion
    }

    /// Stores a command as the last motion command, from any source.
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

    /// Mode of EX: 0, 1 (trace) or 2 (single step).
    ///
    /// # Errors
    /// Error 21: there is no such mode.
    pub(super) fn mode(&self, mode: u8) -> Result<Mode, Error> {
        match mode {
            0 => Ok(Mode::Run),
            1 => Ok(Mode::Trace),
            2 if self.break_point.is_some() => Ok(Mode::ToBreakPoint),
            2 => Ok(Mode::Step),
            _ => Err(Error::IllegalValue),
        }
    }

    /// Runs the program at an address. It must have [ended](Self::end).
    pub(super) fn start(&mut self, at: Instant, address: u16, mode: Mode) {
        (self.address, self.mode) = (address, mode);
        if let Some(point) = &mut self.break_point {
            point.left = point.count;
        }
        self.begin(at);
        // The first single step needs no key (MC 6.1.9).
        if mode == Mode::Step {
            self.phase = Phase::Line(at + LINE);
        }
    }

    /// PS: pauses the program.
    pub(super) fn pause(&mut self, at: Instant) {
        self.paused = Some(at);
    }

    /// RS: resumes the program.
    ///
    /// # Errors
    /// The program is not paused.
    pub(super) fn resume(&mut self, at: Instant) -> Result<(), Why> {
        let since = self.paused.take().ok_or(Why::NotPaused)?;
        self.shift(at.since(since));
        Ok(())
    }

    /// Handles the deadline. Returns true if a line is to be carried out; otherwise the time of H has passed.
    pub(in crate::mdrive) fn timeout(&mut self, at: Instant) -> bool {
        if let Phase::Until(_) = self.phase {
            self.begin(at);
            return false;
        }
        matches!(self.phase, Phase::Line(_))
    }

    /// Address of the line that is to be carried out.
    pub(in crate::mdrive) fn address(&self) -> u16 {
        self.address
    }

    /// Begins to carry out the line at the address. Returns true if the line is to be printed.
    pub(in crate::mdrive) fn begin_line(&mut self, at: Instant) -> bool {
        self.address = self.address.saturating_add(1);
        // Phase after an executed line, unless the line sets another one.
        self.phase = Phase::Line(at);
        matches!(self.mode, Mode::Trace | Mode::Step)
    }

    /// Handles the end of a line: the next one begins. Returns true if a pending call comes first.
    pub(in crate::mdrive) fn end_line(&mut self, at: Instant) -> bool {
        if self.is_interrupted() {
            return true;
        }
        if self.phase == Phase::Line(at) {
            self.begin(at);
        }
        false
    }

    /// Ends an H that waits for the end of motion, because nothing moves.
    pub(in crate::mdrive) fn on_standstill(&mut self, at: Instant) {
        if self.phase == Phase::Motion && !self.is_paused() {
            self.begin(at);
        }
    }

    /// Returns true if there is a handler of errors that does not run already.
    pub(super) fn has_free_handler(&self) -> bool {
        self.handler.is_some() && !self.handles()
    }

    /// Requests a call of OE's handler.
    pub(super) fn request_handler(&mut self) {
        self.handler_is_due = true;
    }

    /// Requests a call of a trip's subroutine.
    pub(super) fn request_trip(&mut self, trip: Trip) {
        self.trips_due |= trip.bit();
    }

    /// Returns true if a pending call can be made at once: no line is being executed, and the program is not
    /// paused.
    pub(super) fn takes_interrupt(&self) -> bool {
        self.is_interrupted() && !self.is_paused() && !matches!(self.phase, Phase::Line(_))
    }

    /// Takes one of the pending calls: OE's handler first, then trips in the order of TE.
    pub(super) fn next_interrupt(&mut self, trips: &Trips) -> Option<Interrupt> {
        let handles = core::mem::take(&mut self.handler_is_due);
        let place = if handles {
            self.handler
        } else {
            let trip = Trip::first(self.trips_due)?;
            self.trips_due &= !trip.bit();
            trips.subroutine(trip)
        };
        Some(Interrupt { place: place?, handles })
    }

    /// Handles a key while the program [is stepping](Self::is_stepping): it executes one line, or continues
    /// at full speed if `one` is false (MC 5-24, 6.1.9).
    pub(in crate::mdrive) fn step(&mut self, at: Instant, one: bool) {
        if self.is_stepping() {
            self.phase = Phase::Line(at + LINE);
            if !one {
                self.mode = Mode::Run;
            }
        }
    }

    /// BP: single steps begin at this address after `count` further passes; `None` removes the break point.
    pub(in crate::mdrive) fn set_break_point(&mut self, address: Option<u16>, count: u16) {
        self.break_point = address.map(|address| BreakPoint { address, count, left: count });
    }

    /// Sets the handler of errors (OE).
    pub(in crate::mdrive) fn set_handler(&mut self, handler: Option<Place>) {
        self.handler = handler;
    }

    /// Continues with another line (BR).
    pub(in crate::mdrive) fn jump(&mut self, address: u16) {
        self.address = address;
    }

    /// Calls the subroutine at `address`, for CL, a trip or OE's handler (`handles`). The caller's address
    /// and phase are stored.
    ///
    /// # Errors
    /// Error 43: too many nested calls.
    pub(in crate::mdrive) fn call(&mut self, at: Instant, address: u16, handles: bool) -> Result<(), Error> {
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

    /// RT: returns to the caller. The time of an H has continued during the call.
    ///
    /// # Errors
    /// Error 41: there is no call to return from.
    pub(in crate::mdrive) fn ret(&mut self, at: Instant) -> Result<(), Error> {
        let call = self.calls.pop().ok_or(Error::StackOverflow)?;
        (self.address, self.phase) = (call.address, call.phase);
        match self.phase {
            Phase::Line(_) => self.begin(at),
            Phase::Until(due) if due <= at => self.begin(at),
            Phase::Until(_) | Phase::Motion | Phase::Key | Phase::Idle => {}
        }
        Ok(())
    }

    /// H: waits until this time, or for the end of motion if `None`.
    pub(in crate::mdrive) fn set_hold(&mut self, until: Option<Instant>) {
        self.phase = until.map_or(Phase::Motion, Phase::Until);
    }

    pub(super) fn end(&mut self) {
        self.phase = Phase::Idle;
        self.calls.clear();
        (self.handler_is_due, self.trips_due) = (false, 0);
        self.paused = None;
    }

    /// Begins the line at the address. In single steps the program waits for a key first.
    fn begin(&mut self, at: Instant) {
        if self.breaks() {
            self.mode = Mode::Step;
        }
        self.phase = if self.mode == Mode::Step { Phase::Key } else { Phase::Line(at + LINE) };
    }

    /// Returns true if the program has reached its break point and no passes are left. Counts the pass.
    fn breaks(&mut self) -> bool {
        let Some(point) = &mut self.break_point else { return false };
        if !matches!(self.mode, Mode::Trace | Mode::ToBreakPoint) || point.address != self.address {
            return false;
        }
        let breaks = point.left == 0;
        point.left = point.left.saturating_sub(1);
        breaks
    }

    /// Returns true if a call is pending.
    fn is_interrupted(&self) -> bool {
        self.handler_is_due || self.trips_due != 0
    }

    /// Returns true while OE's handler runs. Errors of the handler do not call it again.
    pub(super) fn handles(&self) -> bool {
        self.calls.iter().any(|call| call.handles)
    }

    /// Delays all times of the program by `span`, because it was paused for that long.
    fn shift(&mut self, span: Duration) {
        let phases = self.calls.iter_mut().map(|call| &mut call.phase);
        for phase in phases.chain([&mut self.phase]) {
            if let Phase::Line(due) | Phase::Until(due) = phase {
                *due += span;
            }
        }
    }
}
