//! The program that runs: start, pauses, interrupts and end; errors.

use super::Mcode;
use super::vm::{Interrupt, Vm};
use crate::device::{Context, Instant};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::{Error, Errors};
use crate::mdrive::mcode::names::Meaning;
use crate::mdrive::mcode::statement::{Place, Trip};
use crate::mdrive::mcode::trip::Trips;
use crate::mdrive::reasons::Why;

impl Drive {
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
        let address = self.mcode.find_line(place)?;
        let mode = self.mcode.vm.mode(mode)?;
        self.end_program();
        self.mcode.vm.start(at, address, mode);
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
        vm.pause(at);
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
        self.mcode.vm.resume(at)?;
        self.motion.resume(at, out);
        self.interrupt_program(at, out);
        Ok(())
    }

    /// Handles an error: sets EF and ER, and with them the fault output, and calls OE's handler.
    pub(in crate::mdrive) fn fail(&mut self, at: Instant, error: Error, out: &mut dyn Context) {
        self.errors.set(error);
        self.call_error_handler(at, out);
    }

    /// Ends all activity: clears errors, ends the program that runs, and removes all trips.
    pub(in crate::mdrive) fn clear_activity(&mut self) {
        self.errors = Errors::NONE;
        self.end_program();
        self.mcode.vm = Vm::new();
        self.mcode.trips = Trips::NONE;
    }

    /// Calls the handler of OE after an error, if there is one. Without a program the handler is called, too,
    /// but not while a program is being typed (MC 5-52).
    fn call_error_handler(&mut self, at: Instant, out: &mut dyn Context) {
        if self.calls_error_handler() {
            self.mcode.vm.request_handler();
            self.interrupt_program(at, out);
        }
    }

    fn calls_error_handler(&self) -> bool {
        self.mcode.vm.has_free_handler() && !self.mcode.consoles.is_programming()
    }

    /// Calls the subroutine of a trip.
    pub(in crate::mdrive) fn call_trip(&mut self, at: Instant, trip: Trip, out: &mut dyn Context) {
        self.mcode.vm.request_trip(trip);
        self.interrupt_program(at, out);
    }

    /// Calls a pending subroutine at once, unless a line is being executed or the program is paused.
    fn interrupt_program(&mut self, at: Instant, out: &mut dyn Context) {
        if self.mcode.vm.takes_interrupt() {
            self.call_next_interrupt(at, out);
        }
    }

    /// Calls one of the pending subroutines: OE's handler first, then trips in the order of TE.
    pub(super) fn call_next_interrupt(&mut self, at: Instant, out: &mut dyn Context) {
        let Mcode { vm, trips, .. } = &mut self.mcode;
        let Some(Interrupt { place, handles }) = vm.next_interrupt(trips) else { return };
        let found = self.mcode.find_line(place);
        if handles && found.is_err() {
            // The handler does not exist any more. If it stayed set, the error of this call would call it.
            self.mcode.vm.set_handler(None);
        }
        let address_state = found.and_then(|address| self.mcode.vm.call(at, address, handles));
        if let Err(error) = address_state {
            self.fail_program(at, error, out);
        }
    }

    /// Handles an error of a line or a call of the program. Some errors end the program. They do not if OE's
    /// handler is called: "program execution continues with the instruction after the one that caused the
    /// error" (MC 5-52).
    pub(super) fn fail_program(&mut self, at: Instant, error: Error, out: &mut dyn Context) {
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
