//! Execution of the program: start, pauses, interrupts and end, and its lines.

use heapless::Vec;

use super::{LINE, Mode, Phase};
use crate::device::{Context, Instant};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::mcode::names::Meaning;
use crate::mdrive::mcode::program::LINE_BYTES;
use crate::mdrive::mcode::statement::{Place, Statement, Trip};
use crate::mdrive::reasons::Why;

impl Drive {
    /// Address of a line that exists.
    ///
    /// # Errors
    /// Error 30 for a name that is not a label, 42 if there is no line.
    pub(in crate::mdrive) fn find_line(&self, place: Place) -> Result<u16, Error> {
        let address = self.address(place)?;
        let found = self.mcode.program.next(address) == Some(address);
        if found { Ok(address) } else { Err(Error::IllegalAddress) }
    }

    /// EX: runs the program at a place, in mode 0, 1 (trace) or 2 (single step). A program that runs already
    /// ends.
    ///
    /// # Errors
    /// Error 21, 30 or 42; nothing has happened then.
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
        // EF "is automatically cleared when a new program is executed", local variables are "erased and
        // declared again each time" (MC 5-21, 3.2.2).
        self.errors.clear();
        self.mcode.names.retain(|_, meaning| !matches!(meaning, Meaning::Local(_)));
        self.mcode.vm.forget_input_for(|name| self.mcode.names.find(name).is_none());
        Ok(())
    }

    /// E: ends the program. Motion continues. But if the program is paused, the interrupted motion and the
    /// waiting task are dropped: RS has nothing to resume.
    pub(in crate::mdrive) fn end_program(&mut self) {
        if self.mcode.vm.is_paused() {
            self.motion.clear_waiting();
        }
        self.mcode.vm.end();
    }

    /// E, as a command: ends the program.
    ///
    /// # Errors
    /// The reason why motion continues.
    pub(in crate::mdrive) fn end_by_command(&mut self) -> Result<(), Why> {
        self.end_program();
        if self.motion.is_moving() { Err(Why::EndsProgram) } else { Ok(()) }
    }

    /// PS: pauses the program, and stops motion with its ramp.
    ///
    /// # Errors
    /// There is nothing to pause.
    pub(in crate::mdrive) fn pause_program(&mut self, at: Instant, out: &mut dyn Context) -> Result<(), Why> {
        let vm = &mut self.mcode.vm;
        if vm.is_paused() || !vm.is_running() && !self.motion.is_moving() {
            return Err(Why::NothingRuns);
        }
        vm.paused = Some(at);
        self.motion.pause(at, out);
        Ok(())
    }

    /// RS: resumes program and motion.
    ///
    /// # Errors
    /// Nothing is paused.
    pub(in crate::mdrive) fn resume_program(
        &mut self,
        at: Instant,
        out: &mut dyn Context,
    ) -> Result<(), Why> {
        let since = self.mcode.vm.paused.take().ok_or(Why::NotPaused)?;
        self.mcode.vm.shift(at.since(since));
        self.motion.resume(at, out);
        self.interrupt_program(at, out);
        Ok(())
    }

    /// Calls the handler of OE after an error, if there is one. Without a program the handler is called, too,
    /// but not while a program is being typed (MC 5-52).
    pub(in crate::mdrive) fn call_error_handler(&mut self, at: Instant, out: &mut dyn Context) {
        if self.calls_error_handler() {
            self.mcode.vm.handler_is_due = true;
            self.interrupt_program(at, out);
        }
    }

    fn calls_error_handler(&self) -> bool {
        let vm = &self.mcode.vm;
        vm.handler.is_some() && !vm.handles() && !self.mcode.consoles.is_programming()
    }

    /// Calls the subroutine of a trip.
    pub(in crate::mdrive) fn call_trip(&mut self, at: Instant, trip: Trip, out: &mut dyn Context) {
        self.mcode.vm.trips_due |= trip.bit();
        self.interrupt_program(at, out);
    }

    /// Handles the deadline of the program: a line has been executed, or the time of H has passed.
    pub(in crate::mdrive) fn program_timeout(&mut self, at: Instant, out: &mut dyn Context) {
        match self.mcode.vm.phase {
            Phase::Until(_) => self.mcode.vm.begin(at),
            Phase::Line(_) => self.carry_out_line(at, out),
            Phase::Idle | Phase::Motion | Phase::Key => {}
        }
    }

    /// Ends an H that waits for the end of motion, once motion has ended.
    pub(in crate::mdrive) fn check_standstill(&mut self, at: Instant) {
        if self.mcode.vm.waits_for_motion() && !self.motion.is_moving() {
            self.mcode.vm.begin(at);
        }
    }

    fn carry_out_line(&mut self, at: Instant, out: &mut dyn Context) {
        let address = self.mcode.vm.address;
        let mut line = Vec::<u8, LINE_BYTES>::new();
        match self.mcode.program.line(out.memory(), address) {
            // No stored line is longer than the buffer.
            Some(text) => line.extend_from_slice(text).unwrap_or_default(),
            // There are no more lines: a program without E ends here, as in MC 7.2.5.
            None => return self.end_program(),
        }
        let vm = &mut self.mcode.vm;
        vm.address = address.saturating_add(1);
        // Phase after an executed line, unless the line sets another one.
        vm.phase = Phase::Line(at);
        if matches!(vm.mode, Mode::Trace | Mode::Step) {
            self.send_to_all(at, &line, out);
            self.send_to_all(at, b"\r\n", out);
        }
        let done = self.parse(&line).and_then(|statement| match statement {
            Statement::Print(items) => self.print_on(at, self.mcode.consoles.links(), items, out),
            Statement::ListProgram(place) => self.list_program(at, self.mcode.consoles.links(), place, out),
            _ => self.execute(at, &statement, true, out),
        });
        if let Err(error) = done {
            self.fail_program(at, error, out);
        }
        let vm = &mut self.mcode.vm;
        if vm.is_interrupted() {
            self.call_next_interrupt(at, out);
        } else if vm.phase == Phase::Line(at) {
            vm.begin(at);
        }
    }

    /// Calls a pending subroutine at once, unless a line is being executed or the program is paused.
    fn interrupt_program(&mut self, at: Instant, out: &mut dyn Context) {
        let vm = &self.mcode.vm;
        if vm.is_interrupted() && !vm.is_paused() && !matches!(vm.phase, Phase::Line(_)) {
            self.call_next_interrupt(at, out);
        }
    }

    /// Calls one of the pending subroutines: OE's handler first, then trips in the order of TE.
    fn call_next_interrupt(&mut self, at: Instant, out: &mut dyn Context) {
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
        let found = self.find_line(place);
        if handles && found.is_err() {
            // The handler does not exist any more. If it stayed set, the error of this call would call it.
            self.mcode.vm.handler = None;
        }
        let address_state = found.and_then(|address| self.mcode.vm.call(at, address, handles));
        if let Err(error) = address_state {
            self.fail_program(at, error, out);
        }
    }

    /// Handles an error of a line or a call of the program. Some errors end the program. They do not if OE's
    /// handler is called: "program execution continues with the instruction after the one that caused the
    /// error" (MC 5-52).
    fn fail_program(&mut self, at: Instant, error: Error, out: &mut dyn Context) {
        let handles = self.mcode.vm.handles();
        if error.ends_program() && !self.calls_error_handler() {
            self.end_program();
        }
        // Errors of the handler do not call the handler, even if they have ended it.
        if handles {
            self.errors.set(error);
        } else {
            self.fail(at, error, out);
        }
    }
}
