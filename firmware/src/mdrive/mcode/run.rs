//! The program that runs: start, pauses, interrupts and end; errors.

use super::Mcode;
use super::vm::{Interrupt, Vm};
use crate::device::{Context, Instant};
use crate::mdrive::error::{Error, Errors};
use crate::mdrive::mcode::names::Meaning;
use crate::mdrive::mcode::operand::{Place, Trip};
use crate::mdrive::mcode::trip::Trips;
use crate::mdrive::motion::Motion;
use crate::mdrive::reasons::Why;

impl Mcode {
    /// EX: runs the program at a place, in mode 0, 1 (trace) or 2 (single step). A program that runs already
    /// ends.
    ///
    /// # Errors
    /// Error 21, 30 or 42; nothing has happened then.
    pub(in crate::mdrive) fn start(
        &mut self,
        at: Instant,
        place: Place,
        mode: u8,
        motion: &mut Motion,
    ) -> Result<(), Error> {
        let address = self.find_line(place)?;
        let mode = self.vm.mode(mode)?;
        self.end(motion);
        self.vm.start(at, address, mode);
        // EF "is automatically cleared when a new program is executed", local variables are "erased and
        // declared again each time" (MC 5-21, 3.2.2).
        self.errors.clear();
        self.names.retain(|_, meaning| !matches!(meaning, Meaning::Local(_)));
        self.vm.forget_input_for(|name| self.names.find(name).is_none());
        Ok(())
    }

    /// E: ends the program. Motion continues. But if the program is paused, the interrupted motion and the
    /// waiting task are dropped: RS has nothing to resume.
    pub(in crate::mdrive) fn end(&mut self, motion: &mut Motion) {
        if self.vm.is_paused() {
            motion.clear_waiting();
        }
        self.vm.end();
    }

    /// E, as a command: ends the program.
    ///
    /// # Errors
    /// The reason why motion continues.
    pub(in crate::mdrive) fn end_by_command(&mut self, motion: &mut Motion) -> Result<(), Why> {
        self.end(motion);
        if motion.is_moving() { Err(Why::EndsProgram) } else { Ok(()) }
    }

    /// PS: pauses the program, and stops motion with its ramp.
    ///
    /// # Errors
    /// There is nothing to pause.
    pub(in crate::mdrive) fn pause(
        &mut self,
        at: Instant,
        motion: &mut Motion,
        out: &mut dyn Context,
    ) -> Result<(), Why> {
        let vm = &mut self.vm;
        if vm.is_paused() || !vm.is_running() && !motion.is_moving() {
            return Err(Why::NothingRuns);
        }
        vm.pause(at);
        motion.pause(at, out);
        Ok(())
    }

    /// RS: resumes program and motion.
    ///
    /// # Errors
    /// Nothing is paused.
    pub(in crate::mdrive) fn resume(
        &mut self,
        at: Instant,
        motion: &mut Motion,
        out: &mut dyn Context,
    ) -> Result<(), Why> {
        self.vm.resume(at)?;
        motion.resume(at, out);
        self.interrupt_program(at, motion);
        Ok(())
    }

    /// Handles an error: sets EF and ER, and with them the fault output, and calls OE's handler.
    pub(in crate::mdrive) fn fail(&mut self, at: Instant, error: Error, motion: &mut Motion) {
        self.errors.set(error);
        self.call_error_handler(at, motion);
    }

    /// Ends all activity: clears errors, ends the program that runs, and removes all trips.
    pub(in crate::mdrive) fn clear(&mut self, motion: &mut Motion) {
        self.errors = Errors::NONE;
        self.end(motion);
        self.vm = Vm::new();
        self.trips = Trips::NONE;
    }

    /// Calls the handler of OE after an error, if there is one. Without a program the handler is called, too,
    /// but not while a program is being typed (MC 5-52).
    fn call_error_handler(&mut self, at: Instant, motion: &mut Motion) {
        if self.calls_error_handler() {
            self.vm.request_handler();
            self.interrupt_program(at, motion);
        }
    }

    fn calls_error_handler(&self) -> bool {
        self.vm.has_free_handler() && !self.consoles.is_programming()
    }

    /// Calls the subroutine of a trip.
    pub(in crate::mdrive) fn call_trip(&mut self, at: Instant, trip: Trip, motion: &mut Motion) {
        self.vm.request_trip(trip);
        self.interrupt_program(at, motion);
    }

    /// Calls a pending subroutine at once, unless a line is being executed or the program is paused.
    fn interrupt_program(&mut self, at: Instant, motion: &mut Motion) {
        if self.vm.takes_interrupt() {
            self.call_next_interrupt(at, motion);
        }
    }

    /// Calls one of the pending subroutines: OE's handler first, then trips in the order of TE.
    pub(in crate::mdrive) fn call_next_interrupt(&mut self, at: Instant, motion: &mut Motion) {
        let Self { vm, trips, .. } = self;
        let Some(Interrupt { place, handles }) = vm.next_interrupt(trips) else { return };
        let found = self.find_line(place);
        if handles && found.is_err() {
            // The handler does not exist any more. If it stayed set, the error of this call would call it.
            self.vm.set_handler(None);
        }
        let called = found.and_then(|address| self.vm.call(at, address, handles));
        if let Err(error) = called {
            self.fail_program(at, error, motion);
        }
    }

    /// Handles an error of a line or a call of the program. Some errors end the program. They do not if OE's
    /// handler is called: "program execution continues with the instruction after the one that caused the
    /// error" (MC 5-52).
    pub(in crate::mdrive) fn fail_program(&mut self, at: Instant, error: Error, motion: &mut Motion) {
        let handles = self.vm.handles();
        if error.ends_program() && !self.calls_error_handler() {
            self.end(motion);
        }
        // Errors of the handler do not call the handler, even if they have ended it.
        if handles {
            self.errors.set(error);
        } else {
            self.fail(at, error, motion);
        }
    }
}
