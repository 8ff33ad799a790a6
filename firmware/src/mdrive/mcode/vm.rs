//! The program that runs: line by line, 210 µs each, with which MC 8.2 comes to its printed end.

#[cfg(test)]
mod tests;

use heapless::Vec;

use super::super::drive::Drive;
use super::super::error::Error;
use super::super::motion::Order;
use super::names::Meaning;
use super::program::LINE_BYTES;
use super::statement::{Name, Operand, Place, Statement, Trip};
use crate::device::{Duration, Instant, Sink};

/// How long a line takes, that of a label, too; it is carried out at the end.
pub(in crate::mdrive) const LINE: Duration = Duration::micros(210);

/// How deep CL, trips and OE's handler may nest. Neither manual says it.
const DEPTH: usize = 16;

/// What the program is at.
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

/// How it runs (EX's second parameter).
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
    /// Whether OE has called it.
    handles: bool,
}

/// From where on it steps (BP).
#[derive(Clone, Copy, Debug)]
struct BreakPoint {
    address: u16,
    /// How often it is passed before.
    count: u16,
    left: u16,
}

/// The state of the program.
#[derive(Clone, Debug)]
pub(in crate::mdrive) struct Vm {
    phase: Phase,
    /// The next line.
    address: u16,
    calls: Vec<Call, DEPTH>,
    mode: Mode,
    break_point: Option<BreakPoint>,
    /// What is called when an error comes (OE).
    handler: Option<Place>,
    /// What is to be called as soon as a line has ended: OE's handler, and the subroutines of trips, in the bits of TE.
    handler_is_due: bool,
    trips_due: u8,
    /// Since when PS holds it.
    paused: Option<Instant>,
    /// The variable that IV waits for.
    pub(super) awaited: Option<Operand>,
    /// MA, MR or SL, whichever was the last (MD).
    last_motion: Option<Name>,
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
            last_motion: None,
        }
    }

    /// Whether there is a program that runs, or that PS holds (BY).
    pub(in crate::mdrive) fn is_running(&self) -> bool {
        self.phase != Phase::Idle
    }

    /// Whether PS holds program and motion.
    pub(in crate::mdrive) fn is_paused(&self) -> bool {
        self.paused.is_some()
    }

    /// Whether it waits for a key, after a single step.
    pub(in crate::mdrive) fn is_stepping(&self) -> bool {
        self.phase == Phase::Key && !self.is_paused()
    }

    /// Whether a number that is typed goes to IV's variable (IF).
    pub(in crate::mdrive) fn awaits_input(&self) -> bool {
        self.awaited.is_some()
    }

    /// A number that is typed goes nowhere else any more (IF = 0).
    pub(in crate::mdrive) fn forget_input(&mut self) {
        self.awaited = None;
    }

    /// MD: what a number alone repeats.
    pub(in crate::mdrive) fn last_motion(&self) -> Option<Name> {
        self.last_motion
    }

    /// Something was commanded, by whomever.
    pub(in crate::mdrive) fn remember(&mut self, order: Order) {
        match order {
            Order::To { .. } => self.last_motion = Some(*b"MA"),
            Order::By { .. } => self.last_motion = Some(*b"MR"),
            Order::Slew(_) => self.last_motion = Some(*b"SL"),
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

    /// What is called when an error comes (OE).
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
    /// 41: nobody has called.
    pub(super) fn come_back(&mut self, at: Instant) -> Result<(), Error> {
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
    pub(super) fn hold(&mut self, until: Option<Instant>) {
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

    /// Whether it comes to its break point for the last time.
    fn breaks(&mut self) -> bool {
        let Some(point) = &mut self.break_point else { return false };
        if !matches!(self.mode, Mode::Trace | Mode::ToBreakPoint) || point.address != self.address {
            return false;
        }
        let breaks = point.left == 0;
        point.left = point.left.saturating_sub(1);
        breaks
    }

    /// Whether motion's end is what the next line waits for.
    fn waits_for_motion(&self) -> bool {
        self.phase == Phase::Motion && !self.is_paused()
    }

    /// Whether something is to be called.
    fn is_interrupted(&self) -> bool {
        self.handler_is_due || self.trips_due != 0
    }

    /// Whether an error's handler runs: errors of its own do not call it again.
    fn handles(&self) -> bool {
        self.calls.iter().any(|call| call.handles)
    }

    /// The program was held since then: what has a time comes that much later.
    fn shift(&mut self, span: Duration) {
        let phases = self.calls.iter_mut().map(|call| &mut call.phase);
        for phase in phases.chain([&mut self.phase]) {
            if let Phase::Line(due) | Phase::Until(due) = phase {
                *due += span;
            }
        }
    }
}

impl Drive {
    /// The address of a line.
    ///
    /// # Errors
    /// 30 for a name that is no label, 42 where there is no line.
    pub(super) fn find_line(&self, place: Place) -> Result<u16, Error> {
        let address = self.address(place)?;
        let found = self.mcode.program.next(address) == Some(address);
        if found { Ok(address) } else { Err(Error::IllegalAddress) }
    }

    /// EX: runs the program at a place, in mode 0, 1 (trace) or 2 (single step), instead of one that runs.
    ///
    /// # Errors
    /// 21, 30, 42; nothing has happened then.
    pub(in crate::mdrive) fn start_program(
        &mut self,
        at: Instant,
        place: Place,
        mode: u8,
    ) -> Result<(), Error> {
        let address = self.find_line(place)?;
        let vm = &mut self.mcode.vm;
        let mode = match mode {
            0 => Mode::Run,
            1 => Mode::Trace,
            2 if vm.break_point.is_some() => Mode::ToBreakPoint,
            2 => Mode::Step,
            _ => return Err(Error::IllegalValue),
        };
        self.end_program();
        let vm = &mut self.mcode.vm;
        (vm.address, vm.mode) = (address, mode);
        if let Some(point) = &mut vm.break_point {
            point.left = point.count;
        }
        vm.begin(at);
        // The first single step needs no key (MC 6.1.9).
        if mode == Mode::Step {
            vm.phase = Phase::Line(at + LINE);
        }
        // EF "is automatically cleared when a new program is executed", local variables are "erased and declared
        // again each time" (MC 5-21, 3.2.2).
        self.errors.clear();
        self.mcode.names.retain(|_, meaning| !matches!(meaning, Meaning::Local(_)));
        if let Some(Operand::User(name)) = self.mcode.vm.awaited
            && self.mcode.names.find(name).is_none()
        {
            self.mcode.vm.forget_input();
        }
        Ok(())
    }

    /// E: the program ends; motion goes on, but for what PS has interrupted, and what waits behind that: nothing is left
    /// that RS could resume.
    pub(in crate::mdrive) fn end_program(&mut self) {
        if self.mcode.vm.is_paused() {
            self.motion.forget_pause();
        }
        self.mcode.vm.end();
    }

    /// PS: the program stands still, and motion stops with its ramp.
    pub(in crate::mdrive) fn pause_program(&mut self, at: Instant, out: &mut dyn Sink) {
        let vm = &mut self.mcode.vm;
        if !vm.is_paused() && (vm.is_running() || self.motion.is_moving()) {
            vm.paused = Some(at);
            self.motion.pause(at, out);
        }
    }

    /// RS: both go on.
    pub(in crate::mdrive) fn resume_program(&mut self, at: Instant, out: &mut dyn Sink) {
        if let Some(since) = self.mcode.vm.paused.take() {
            self.mcode.vm.shift(at.since(since));
            self.motion.resume(at, out);
            self.interrupt_program(at, out);
        }
    }

    /// An error has come: the handler of OE is called, if there is one, also without a program, but not while one is
    /// typed (MC 5-52).
    pub(in crate::mdrive) fn call_error_handler(&mut self, at: Instant, out: &mut dyn Sink) {
        let programming = self.mcode.consoles.is_programming();
        let vm = &mut self.mcode.vm;
        if vm.handler.is_some() && !vm.handles() && !programming {
            vm.handler_is_due = true;
            self.interrupt_program(at, out);
        }
    }

    /// A trip calls its subroutine.
    pub(super) fn call_trip(&mut self, at: Instant, trip: Trip, out: &mut dyn Sink) {
        self.mcode.vm.trips_due |= trip.bit();
        self.interrupt_program(at, out);
    }

    /// The next line is due, or what it waits for has come.
    pub(in crate::mdrive) fn program_timeout(&mut self, at: Instant, out: &mut dyn Sink) {
        match self.mcode.vm.phase {
            Phase::Until(_) => self.mcode.vm.begin(at),
            Phase::Line(_) => self.carry_out_line(at, out),
            Phase::Idle | Phase::Motion | Phase::Key => {}
        }
    }

    /// Something has happened: H goes on with the next line once motion is over.
    pub(in crate::mdrive) fn look_for_standstill(&mut self, at: Instant) {
        if self.mcode.vm.waits_for_motion() && !self.motion.is_moving() {
            self.mcode.vm.begin(at);
        }
    }

    fn carry_out_line(&mut self, at: Instant, out: &mut dyn Sink) {
        let address = self.mcode.vm.address;
        let mut line = Vec::<u8, LINE_BYTES>::new();
        match self.mcode.program.line(out.memory(), address) {
            // None is longer.
            Some(text) => line.extend_from_slice(text).unwrap_or_default(),
            // Behind the last line: a program without E, as in MC 7.2.5.
            None => return self.end_program(),
        }
        let vm = &mut self.mcode.vm;
        vm.address = address.saturating_add(1);
        // Between two lines, unless this one says otherwise.
        vm.phase = Phase::Line(at);
        if matches!(vm.mode, Mode::Trace | Mode::Step) {
            self.say_to_all(at, &line, out);
            self.say_to_all(at, b"\r\n", out);
        }
        let done = self.parse(&line).and_then(|statement| match statement {
            Statement::Print(items) => self.print_to_all(at, items, out),
            _ => self.execute(at, &statement, true, out),
        });
        if let Err(error) = done {
            if error.ends_program() {
                self.end_program();
            }
            self.fail(at, error, out);
        }
        let vm = &mut self.mcode.vm;
        if vm.is_interrupted() {
            self.call_next_interrupt(at, out);
        } else if vm.phase == Phase::Line(at) {
            vm.begin(at);
        }
    }

    /// What interrupts is called at once, but for a line that is being carried out, or a pause.
    fn interrupt_program(&mut self, at: Instant, out: &mut dyn Sink) {
        let vm = &self.mcode.vm;
        if vm.is_interrupted() && !vm.is_paused() && !matches!(vm.phase, Phase::Line(_)) {
            self.call_next_interrupt(at, out);
        }
    }

    /// Calls one of the subroutines that are to be called: OE's handler first, then trips in the order of TE.
    fn call_next_interrupt(&mut self, at: Instant, out: &mut dyn Sink) {
        let vm = &mut self.mcode.vm;
        let handles = core::mem::take(&mut vm.handler_is_due);
        let place = if handles {
            vm.handler
        } else {
            let first = vm.trips_due & vm.trips_due.wrapping_neg();
            vm.trips_due &= !first;
            self.mcode.trips.subroutine(first)
        };
        let Some(place) = place else { return };
        let called = self.find_line(place).and_then(|address| self.mcode.vm.call(at, address, handles));
        if let Err(error) = called {
            if handles {
                // It is not there any more, and would be called by its own failure.
                self.mcode.vm.handler = None;
            }
            self.end_program();
            self.fail(at, error, out);
        }
    }
}
