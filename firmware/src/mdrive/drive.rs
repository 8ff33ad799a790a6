//! The drive itself: its modules and the events between them.
//!
//! | file | contents |
//! |---|---|
//! | `registers` | the table of variables |
//! | `variables` | stored values, writing variables |
//! | `reader` | reading variables, expressions and printed text; validating a write |
//! | `error` | errors by their numbers |
//! | `reasons` | reasons why an accepted request has no effect |
//! | `startup`, `saved` | the state of the start-up, saves |
//! | `drive::start` | power-on, restarts, loading |
//! | `modbus` | port 502 |
//! | `interpreter` | port 503, and the lines of programs |
//! | `mcode` | the state of MCode: connections, programs |
//! | `motion` | the motor and its encoder |
//! | `hybrid` | additional functions of a Hybrid |
//! | `io` | the I/O points |
//!
//! `registers`, `variables::stored`, `startup`, `saved`, `hybrid`, `motion`, `io`, and the parts of `mcode`
//! (consoles, program, vm, trips) own their state and do not know the drive. The drive wires them; its calls go
//! downwards: from this file to `start`, `variables` and `reader`. Above it are its two languages, which act on it
//! during a request or a line: `modbus` and `interpreter`.
//!
//! Motion, I/O and the Hybrid's circuitry queue events. `dispatch_events` handles those of motion and I/O after
//! every input and timeout, `run_hybrid` those of the circuitry at once.

mod start;

use drivetwin_protocol::modbus::pdu::Exception;
use drivetwin_protocol::registers::Space;

use super::STALL;
use super::error::Error;
use super::hybrid::{self, Environment, Hybrid};
use super::io::{self, Io};
use super::mcode::Mcode;
use super::mcode::operand::Place;
use super::mcode::trip::Made;
use super::motion::{self, Contact, Motion};
use super::registers::{Model, Reg};
use super::saved::Saving;
use super::startup::Startup;
use super::variables::{Registers, entry, is_number, words};
use crate::device::{Context, Fault, Instant, PresetError};

/// State of the drive with all its modules.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    pub(super) startup: Startup,
    pub(super) saving: Saving,
    pub(super) bank: Registers,
    pub(super) io: Io,
    pub(super) motion: Motion,
    pub(super) hybrid: Hybrid,
    pub(super) mcode: Mcode,
}

impl Drive {
    // Inlined to build the value in its final place: a copy would need room on a board's stack.
    #[inline(always)]
    pub(super) fn new(model: Model) -> Self {
        let bank = Registers::new(model);
        let motion = Motion::new(motion::Settings::of(&bank));
        Self {
            startup: Startup::OFF,
            saving: Saving::NONE,
            bank,
            io: Io::OPEN,
            motion,
            hybrid: Hybrid::NONE,
            mcode: Mcode::new(),
        }
    }

    pub(super) fn deadline(&self) -> Instant {
        let own = self.startup.deadline().min(self.saving.deadline());
        let machine = self.motion.deadline().min(self.io.deadline()).min(self.hybrid.deadline());
        own.min(machine).min(self.mcode.deadline())
    }

    /// Handles the deadlines, except those of MCode's lines.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.startup.timeout(at) {
            self.ready(at, out);
        }
        self.saving.timeout(at, out);
        self.io.timeout(at, out);
        self.motion.timeout(at, out);
        self.run_hybrid(at, out, Hybrid::timeout);
        self.dispatch_events(at, out);
    }

    pub(super) fn set_fault(&mut self, at: Instant, fault: Fault, on: bool, out: &mut dyn Context) {
        match fault {
            STALL => {
                self.motion.block_shaft(at, on, out);
                self.run_hybrid(at, out, Hybrid::follow_rotor);
            }
            _ => self.run_hybrid(at, out, |hybrid, env| hybrid.set_fault(env, fault, on)),
        }
    }

    /// Present value of a variable. If it has several values, they are packed into one number, the first one
    /// highest.
    pub(super) fn peek(&self, at: Instant, reg: Reg) -> i64 {
        if is_number(reg) { self.reader(at).read(reg).into() } else { self.bank.get(reg) }
    }

    /// Switches the power off. Only presets follow until the next power-on.
    pub(super) fn power_off(&mut self) {
        self.startup = Startup::OFF;
    }

    /// Presets a register. Before power-on the value counts as saved, later as written by the bus.
    ///
    /// # Errors
    /// The reason for the refusal; nothing has changed then.
    pub(super) fn poke(
        &mut self,
        at: Instant,
        reg: Reg,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let row = entry(reg);
        if !self.bank.has(reg) {
            return Err(PresetError::NoSuchRegister);
        }
        if self.startup.is_off() {
            return if row.saved == 0 {
                Err(PresetError::ReadOnly)
            } else {
                self.preset(at, reg, value, out)
            };
        }
        if row.space == Space::Setting && row.accepts(value) {
            self.bank.set(reg, value);
            self.set_motion(at, out);
            self.run_hybrid(at, out, Hybrid::follow_rotor);
            self.dispatch_events(at, out);
            return Ok(());
        }
        let outcome = match i32::try_from(value) {
            Ok(value) if is_number(reg) => self.write(at, reg, value, out),
            Err(_) if is_number(reg) => Err(Error::IllegalValue),
            _ => self.set_up(at, reg, words(reg, value), out),
        };
        self.dispatch_events(at, out);
        outcome.map_err(|error| match error {
            Error::Unknown => PresetError::NoSuchRegister,
            Error::ReadOnly => PresetError::ReadOnly,
            _ if error.exception() == Exception::ServerDeviceFailure => PresetError::Busy,
            _ => PresetError::OutOfRange,
        })
    }

    /// Handles all queued events of motion and I/O, and updates the outputs.
    pub(super) fn dispatch_events(&mut self, at: Instant, out: &mut dyn Context) {
        loop {
            if let Some(event) = self.io.next_event() {
                self.on_io_event(at, event, out);
            } else if let Some(event) = self.motion.next_event() {
                self.on_motion_event(at, event, out);
            } else {
                break;
            }
        }
        self.update_hybrid(at, out);
        // Any of the events may have changed PY.
        self.mcode.consoles.set_party(self.bank.is_party());
        let plan_changed = self.motion.shaft_mut().has_changed();
        if plan_changed || self.io.wants_plan() {
            self.io.plan(at, self.motion.shaft().plan(), out);
        }
        if plan_changed || self.hybrid.deadline() <= at {
            self.run_hybrid(at, out, Hybrid::watch_position);
        }
        if plan_changed
            || self.mcode.trips.deadline() <= at
            || self.mcode.trips.is_on_counts(self.motion.shaft())
        {
            let made = self.mcode.trips.check(at, self.motion.shaft());
            self.carry_out_trips(at, made, out);
        }
        if !self.motion.is_moving() {
            self.mcode.vm.on_standstill(at);
        }
        self.sign_on(at, out);
        let flags = io::StateFlags {
            moving: self.motion.is_moving(),
            fault: self.mcode.errors.is_set(),
            stall: self.motion.has_stalled(),
            changing: self.motion.is_changing(at),
            locked_rotor: self.hybrid.is_locked(),
            positioning: self.motion.is_positioning(),
            hybrid: self.hybrid.corrects_rotor(&self.motion),
            is_making_up: self.hybrid.is_making_up(),
        };
        self.io.update_outputs(at, flags, out);
    }

    fn on_io_event(&mut self, at: Instant, event: io::Event, out: &mut dyn Context) {
        match event {
            // During start-up, active inputs have no effect, except limits and the home switch.
            io::Event::Contact(Contact::JogPlus | Contact::JogMinus, true) if !self.startup.is_started() => {}
            io::Event::Channel(channel, level) => self.motion.channel(at, channel, level, out),
            io::Event::Contact(contact, active) => self.motion.contact(at, contact, active, out),
            _ if !self.startup.is_started() => {}
            io::Event::Clock(steps) => {
                let from = self.motion.shaft().steps(at);
                self.motion.follow(at, steps, out);
                let made = self.mcode.trips.on_steps(at, from, self.motion.shaft());
                self.carry_out_trips(at, made, out);
            }
            io::Event::Active(_) | io::Event::Capture => {
                let made = self.mcode.trips.on_io_event(at, event, self.motion.shaft());
                self.carry_out_trips(at, made, out);
            }
            io::Event::Go => {
                if let Err(error) = self.mcode.start(at, Place::Address(1), 0, &mut self.motion) {
                    self.fail(at, error);
                }
            }
            io::Event::SoftStop => self.soft_stop(at, out),
            io::Event::Pause => {
                // An input reports no reason.
                let _ = if self.mcode.vm.is_paused() {
                    self.mcode.resume(at, &mut self.motion, out)
                } else {
                    self.mcode.pause(at, &mut self.motion, out)
                };
            }
            io::Event::Reset => self.restart(at, out),
        }
    }

    /// Stops motion and program because of a soft stop input. While the program is paused the input has no
    /// effect (MC 5-63).
    fn soft_stop(&mut self, at: Instant, out: &mut dyn Context) {
        if self.mcode.vm.is_paused() {
            return;
        }
        let (runs, moves) = (self.mcode.vm.is_running(), self.motion.is_moving());
        self.mcode.end(&mut self.motion);
        self.motion.stop(at, out);
        if runs {
            self.fail(at, Error::StoppedProgram);
        }
        if moves {
            self.fail(at, Error::StoppedMotion);
        }
    }

    /// Trips TA if one of these conditions of the Hybrid is selected.
    pub(super) fn trip_on_status(&mut self, at: Instant, flags: u8, out: &mut dyn Context) {
        let made = self.mcode.trips.on_status(at, flags, self.motion.shaft());
        self.carry_out_trips(at, made, out);
    }

    /// Makes the pulses of trips, and calls their subroutines.
    fn carry_out_trips(&mut self, at: Instant, made: Made, out: &mut dyn Context) {
        for trip in made.trips() {
            if trip.pulses() {
                self.io.pulse(at, out);
            }
            if self.mcode.trips.subroutine(trip).is_some() {
                self.mcode.call_trip(at, trip, &mut self.motion);
            }
        }
    }

    /// Checks rotor and temperature. This runs after every event.
    fn update_hybrid(&mut self, at: Instant, out: &mut dyn Context) {
        if self.startup.is_started() {
            self.run_hybrid(at, out, Hybrid::watch);
            // The warning is printed before the bridge is switched off.
            self.run_hybrid(at, out, Hybrid::watch_heat);
        }
    }

    /// Runs a part of the Hybrid's circuitry, then handles its events.
    fn run_hybrid<T>(
        &mut self,
        at: Instant,
        out: &mut dyn Context,
        run: impl FnOnce(&mut Hybrid, &mut Environment<'_>) -> T,
    ) -> T {
        let (registers, io, motion) = (&mut self.bank, &self.io, &mut self.motion);
        let result = run(&mut self.hybrid, &mut Environment { at, registers, io, motion, out });
        self.take_hybrid_events(at, out);
        result
    }

    fn take_hybrid_events(&mut self, at: Instant, out: &mut dyn Context) {
        while let Some(event) = self.hybrid.next_event() {
            match event {
                hybrid::Event::Failed(error) => self.fail(at, error),
                // MC 5-9 calls this "a locked rotor response".
                hybrid::Event::CalibrationFailed => {
                    let starts = self.startup.is_calibrating();
                    let error = if starts { Error::StartupCalibration } else { Error::CalibrationFailed };
                    self.fail(at, error);
                }
                // "The device will print an error 71 to the terminal screen" (MC 5-81).
                hybrid::Event::IsWarm => {
                    self.mcode.consoles.send_to_all(at, hybrid::WARNING, out);
                    self.fail(at, Error::TemperatureWarning);
                }
                hybrid::Event::Reached(condition) => self.trip_on_status(at, condition as u8, out),
                hybrid::Event::Limit(error, condition) => {
                    // If TA is enabled for this condition, the trip replaces the error: "There is no error
                    // generation when enabling trip" (MC 5-71).
                    if !self.mcode.trips.is_on_status(condition as u8) {
                        self.fail(at, error);
                    }
                    self.trip_on_status(at, condition as u8, out);
                }
            }
        }
    }

    /// Handles an error: sets EF and ER, and with them the fault output, and calls OE's handler.
    // Not inlined: many places report errors.
    #[inline(never)]
    pub(super) fn fail(&mut self, at: Instant, error: Error) {
        self.mcode.fail(at, error, &mut self.motion);
    }

    fn on_motion_event(&mut self, at: Instant, event: motion::Event, out: &mut dyn Context) {
        match event {
            motion::Event::Failed(error) => self.fail(at, error),
            motion::Event::StopsProgram => self.mcode.end(&mut self.motion),
            motion::Event::Announce => self.mcode.consoles.send_name(at, self.bank.word(Reg::DN), out),
        }
    }
}
