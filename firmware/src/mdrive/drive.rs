//! The drive itself: its modules and the events between them.
//!
//! | file | content |
//! |---|---|
//! | `registers` | the table of variables |
//! | `variables` | reading and writing variables |
//! | `error` | errors by their numbers |
//! | `reasons` | reasons why an accepted request has no effect |
//! | `startup`, `saved` | start-up, saved values |
//! | `modbus` | port 502 |
//! | `mcode` | port 503, and programs |
//! | `motion` | the motor and its encoder |
//! | `hybrid` | additional functions of a Hybrid |
//! | `io` | the I/O points |
//!
//! Motion and I/O do not depend on the other modules. They queue events, and `dispatch_events` handles the
//! events after every input and timeout.

use drivetwin_protocol::modbus::pdu::Exception;
use drivetwin_protocol::registers::{Bank, Entries, Register, Space, characters};

use super::STALL;
use super::error::{Error, Errors};
use super::hybrid::{Hybrid, frequency};
use super::io::{self, Io};
use super::mcode::Mcode;
use super::mcode::statement::Place;
use super::motion::{self, Contact, Motion};
use super::registers::{HYBRID, PLUS, Reg, TABLE_HYBRID};
use super::saved::Saving;
use super::variables::{entry, is_number, words};
use crate::device::{Boot, Context, Fault, Instant, PresetError};
use crate::motor::stepper::StepperParameters;

/// The two products.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Model {
    /// MDrivePlus².
    Plus,
    /// MDrive Hybrid.
    Hybrid,
}

impl Model {
    /// Bit of this product in the `variants` of a row.
    pub(super) const fn variant(self) -> u8 {
        match self {
            Self::Plus => PLUS,
            Self::Hybrid => HYBRID,
        }
    }

    pub(super) fn entries(self) -> &'static Entries {
        match self {
            Self::Plus => Reg::ENTRIES,
            Self::Hybrid => TABLE_HYBRID.entries,
        }
    }
}

/// State of the drive, from power-on to ready.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum State {
    /// No power.
    Off,
    /// Starting: the drive does not receive messages yet.
    Booting {
        /// Time at which the start ends.
        due: Instant,
        /// True after power-on, when the Ethernet controller starts, too. False after a restart of the drive
        /// alone.
        whole: bool,
    },
    /// Receiving messages. A Hybrid calibrates before it signs on.
    Calibrating,
    /// The sign-on has been sent.
    Ready,
}

/// State of the drive with all its modules.
#[derive(Clone, Debug)]
pub(super) struct Drive {
    pub(super) model: Model,
    pub(super) boot: Boot,
    pub(super) state: State,
    pub(super) saving: Option<Saving>,
    pub(super) bank: Bank<Reg, { Reg::WORDS }>,
    pub(super) errors: Errors,
    pub(super) io: Io,
    pub(super) motion: Motion,
    pub(super) hybrid: Hybrid,
    pub(super) mcode: Mcode,
}

impl Drive {
    // Inlined to build the value in its final place: a copy would need room on a board's stack.
    #[inline(always)]
    pub(super) fn new(model: Model) -> Self {
        let bank = Bank::of(model.entries());
        let motion = Motion::new(motion_settings(&bank, None));
        Self {
            model,
            boot: Boot::default(),
            state: State::Off,
            saving: None,
            bank,
            errors: Errors::NONE,
            io: Io::OPEN,
            motion,
            hybrid: Hybrid::NONE,
            mcode: Mcode::new(),
        }
    }

    pub(super) fn deadline(&self) -> Instant {
        let own = self.startup_due().min(self.save_due());
        let machine = self.motion.deadline().min(self.io.deadline()).min(self.hybrid.deadline());
        let mcode = &self.mcode;
        let lines = mcode.consoles.deadline().min(mcode.vm.deadline()).min(mcode.trips.deadline());
        own.min(machine).min(lines)
    }

    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.startup_due() <= at {
            self.ready(at, out);
        }
        if self.save_due() <= at {
            self.finish_save(at, out);
        }
        if self.io.deadline() <= at {
            self.io.timeout(at, out);
        }
        if self.motion.deadline() <= at {
            self.motion.timeout(at, out);
        }
        if self.hybrid.deadline() <= at {
            self.hybrid_timeout(at, out);
        }
        self.dispatch_events(at, out);
        if self.mcode.consoles.deadline() <= at {
            self.console_timeout(at, out);
        }
        if self.mcode.vm.deadline() <= at {
            self.program_timeout(at, out);
            self.dispatch_events(at, out);
        }
    }

    pub(super) fn set_fault(&mut self, at: Instant, fault: Fault, on: bool, out: &mut dyn Context) {
        match fault {
            STALL => self.block_shaft(at, on, out),
            _ => self.set_hybrid_fault(at, fault, on, out),
        }
    }

    /// Present value of a variable. If it has several values, they are packed into one number, the first one
    /// highest.
    pub(super) fn peek(&self, at: Instant, reg: Reg) -> i64 {
        if is_number(reg) { self.read(at, reg).into() } else { self.bank.get(reg) }
    }

    /// Identification text, joined from the registers of its halves, such as
    /// [`PART_NUMBER`](super::registers::PART_NUMBER).
    pub(super) fn text(&self, halves: &[Reg]) -> heapless::Vec<u8, 16> {
        let mut text = heapless::Vec::new();
        for character in halves.iter().flat_map(|&half| characters(self.bank.get(half))) {
            // The text has room for two halves.
            let _ = text.push(character);
        }
        text
    }

    /// Switches the power off. Only presets follow until the next power-on.
    pub(super) fn power_off(&mut self) {
        self.state = State::Off;
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
        if !self.has(reg) {
            return Err(PresetError::NoSuchRegister);
        }
        if self.state == State::Off {
            return if row.saved == 0 {
                Err(PresetError::ReadOnly)
            } else {
                self.preset(at, reg, value, out)
            };
        }
        if row.space == Space::Setting && row.accepts(value) {
            self.bank.set(reg, value);
            self.set_motion(at, out);
            self.apply_rotor_settings(at, out);
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

    /// Handles an error: sets EF and ER, and with them the fault output, and calls OE's handler.
    pub(super) fn fail(&mut self, at: Instant, error: Error, out: &mut dyn Context) {
        self.errors.set(error);
        self.call_error_handler(at, out);
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
        self.update_party();
        let plan_changed = self.motion.has_changed();
        if plan_changed || self.io.wants_plan() {
            self.io.plan(at, self.motion.plan(), out);
        }
        if plan_changed || self.hybrid.deadline() <= at {
            self.watch_position(at, out);
        }
        if plan_changed || self.mcode.trips.deadline() <= at || self.trips_on_counts() {
            self.check_trips(at, out);
        }
        self.check_standstill(at);
        self.sign_on(at, out);
        let flags = io::StateFlags {
            moving: self.motion.is_moving(),
            fault: self.errors.is_set(),
            stall: self.motion.has_stalled(),
            changing: self.motion.is_changing(at),
            locked_rotor: self.hybrid.is_locked(),
            positioning: self.motion.is_positioning(),
            hybrid: self.corrects_rotor(),
            is_making_up: self.hybrid.is_making_up(),
        };
        self.io.update_outputs(at, flags, out);
    }

    fn on_io_event(&mut self, at: Instant, event: io::Event, out: &mut dyn Context) {
        match event {
            // During start-up, active inputs have no effect, except limits and the home switch.
            io::Event::Contact(Contact::JogPlus | Contact::JogMinus, true) if !self.is_started() => {}
            io::Event::Channel(channel, level) => self.motion.channel(at, channel, level, out),
            io::Event::Contact(contact, active) => self.motion.contact(at, contact, active, out),
            _ if !self.is_started() => {}
            io::Event::Clock(steps) => {
                let from = self.motion.steps(at);
                self.motion.follow(at, steps, out);
                self.trip_on_steps(at, from, out);
            }
            io::Event::Active(_) | io::Event::Capture => self.trip_on(at, event, out),
            io::Event::Go => {
                if let Err(error) = self.start_program(at, Place::Address(1), 0) {
                    self.fail(at, error, out);
                }
            }
            io::Event::SoftStop => self.soft_stop(at, out),
            io::Event::Pause => {
                // An input reports no reason.
                let _ = if self.mcode.vm.is_paused() {
                    self.resume_program(at, out)
                } else {
                    self.pause_program(at, out)
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
        self.end_program();
        self.motion.stop(at, out);
        if runs {
            self.fail(at, Error::StoppedProgram, out);
        }
        if moves {
            self.fail(at, Error::StoppedMotion, out);
        }
    }

    fn on_motion_event(&mut self, at: Instant, event: motion::Event, out: &mut dyn Context) {
        match event {
            motion::Event::Failed(error) => self.fail(at, error, out),
            motion::Event::StopsProgram => self.end_program(),
            motion::Event::Announce => self.send_name(at, out),
        }
    }
}

/// Settings of the motion. Without `io` the motion follows no clock and has no home switch.
pub(super) fn motion_settings(bank: &Bank<Reg, { Reg::WORDS }>, io: Option<&Io>) -> motion::Settings {
    let long = |reg| u32::try_from(bank.get(reg)).unwrap_or(0);
    let byte = |reg| (bank.word(reg) & 0xFF) as u8;
    let flag = |reg| bank.word(reg) != 0;
    motion::Settings {
        start: long(Reg::VI),
        speed: long(Reg::VM),
        up: long(Reg::A),
        down: long(Reg::D),
        microsteps: bank.word(Reg::MS),
        settle_ms: bank.word(Reg::MT),
        hold_delay_ms: bank.word(Reg::HT),
        run_percent: byte(Reg::RC),
        hold_percent: byte(Reg::HC),
        enabled: flag(Reg::DE),
        response: response(bank),
        keeps_field: bank.word(Reg::AS) != 0,
        limit_mode: byte(Reg::LM),
        jogs: flag(Reg::JE),
        home_debounce_ms: io.map_or(0, Io::home_debounce_ms),
        follows_clock: io.is_some_and(Io::follows_clock),
        ratio: bank.word(Reg::CR),
        closed: flag(Reg::EE),
        lines: bank.word(Reg::EL),
        deadband: bank.word(Reg::DB),
        stall_factor: bank.word(Reg::SF),
        goes_on_stalled: flag(Reg::SM),
        maintains: flag(Reg::PM),
        machine: machine(bank),
    }
}

/// Highest speed that the rotor can follow, in steps/s. SS limits it with AS 1 and 2 only (FB 5.1); an
/// MDrivePlus has no AS.
fn response(bank: &Bank<Reg, { Reg::WORDS }>) -> u32 {
    match bank.word(Reg::AS) {
        1 | 2 => frequency(bank.word(Reg::SS).into()).unsigned_abs(),
        _ => u32::MAX,
    }
}

/// Parameters of the motor and its load.
fn machine(bank: &Bank<Reg, { Reg::WORDS }>) -> StepperParameters {
    let long = |reg| u32::try_from(bank.get(reg)).unwrap_or(0);
    StepperParameters {
        steps_per_rev: bank.word(Reg::FullSteps),
        holding_unm: long(Reg::HoldingTorque) * 1_000,
        pull_out_rpm: long(Reg::PullOutSpeed),
        inertia_gcm2: long(Reg::Inertia),
        friction_unm: long(Reg::Friction) * 1_000,
        load_unm: i32::try_from(bank.get(Reg::Load)).unwrap_or(0) * 1_000,
        ..StepperParameters::NOMINAL
    }
}

/// Settings of filters and pulses of the I/O.
pub(super) fn filters(bank: &Bank<Reg, { Reg::WORDS }>) -> io::Filters {
    let byte = |reg| (bank.word(reg) & 0xFF) as u8;
    io::Filters {
        debounce_ms: [Reg::D1, Reg::D2, Reg::D3, Reg::D4].map(byte),
        average: byte(Reg::D5),
        capture: byte(Reg::FC),
        clock: byte(Reg::FM),
        pulse: byte(Reg::CW),
        clocked: bank.word(Reg::CM) != 0,
        ratio: bank.word(Reg::CR),
    }
}
