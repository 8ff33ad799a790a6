//! The adapter between two resets: its state and its events.
//!
//! The other files add functions to it.

use drivetwin_protocol::registers::{Bank, Entry};

use super::clock::Clock;
use super::command;
use super::encoder::Pwm;
use super::motor::Motor;
use super::registers::{Reg, Variant, mdr1};
use super::serial::Serial;
use super::stream::{self, Streams};
use super::{A, B, I, Words};
use crate::counter::{Channel, Ls7366r, status};
use crate::device::{Boot, Context, Duration, Input, Instant, LOGIC_HIGH_MV};
use crate::memory::PendingSave;

/// Time from a reset to the banner; the list of commands does not specify it (QSB-6).
const STARTUP: Duration = Duration::millis(50);

/// State of the adapter, from power-on to ready.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// The adapter has no power.
    Off,
    /// Start-up: the banner is sent at this instant.
    Starting(Instant),
    Ready,
}

/// Levels of the inputs. They stay unchanged by a reset.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pins {
    pub(super) a: bool,
    b: bool,
    index: bool,
    /// Voltage at A, in mV.
    pub(super) mv: i32,
    /// Levels of DIO3 to DIO0, a bit each.
    pub(super) dio: u8,
}

impl Pins {
    /// Levels with no connection.
    const OPEN: Self = Self { a: true, b: true, index: false, mv: LOGIC_HIGH_MV, dio: 0xF };
}

/// A QSB without the receiving part of its port.
#[derive(Clone, Debug)]
pub(super) struct Adapter {
    pub(super) variant: Variant,
    state: State,
    /// True if there is no start-up delay.
    fast: bool,
    pub(super) pins: Pins,
    /// The registers; DIG I/O holds the value written last.
    pub(super) bank: Words,
    pub(super) clock: Clock,
    pub(super) serial: Serial,
    pub(super) counter: Ls7366r,
    pub(super) pwm: Pwm,
    /// Bits of the port's lines that the adapter pulls low, without those of the motor drive.
    pub(super) pulled: u8,
    /// End of a trigger's pulse; DIO0 is inverted during the pulse.
    pub(super) pulse: Option<Instant>,
    pub(super) streams: Streams,
    pub(super) motor: Motor,
    pub(super) save: PendingSave,
}

impl Adapter {
    pub(super) fn new(variant: Variant) -> Self {
        let at = Instant::ZERO;
        Self {
            variant,
            state: State::Off,
            fast: false,
            pins: Pins::OPEN,
            bank: Bank::factory(),
            clock: Clock::new(at),
            serial: Serial::new(at, false),
            counter: Ls7366r::new(true, true, true),
            pwm: Pwm::default(),
            pulled: 0,
            pulse: None,
            streams: Streams::new(),
            motor: Motor::new(at),
            save: PendingSave::NONE,
        }
    }

    /// Handles power-on.
    pub(super) fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        let serial = Serial::new(Instant::ZERO, boot.fast_line);
        *self = Self { motor: Motor::new(at), fast: boot.fast, serial, ..Self::new(self.variant) };
        self.start(at, out);
    }

    /// Switches the power off. Only presets follow until the next power-on.
    pub(super) fn power_off(&mut self) {
        self.state = State::Off;
    }

    /// Handles a reset by the host. A running save is finished first.
    pub(super) fn reset(&mut self, at: Instant, out: &mut dyn Context) {
        if !self.has_run() {
            return;
        }
        self.save.finish(at, out);
        self.motor.deactivate(at, out);
        let motor = self.motor.clone();
        self.serial.clear();
        let Self { variant, fast, pins, serial, .. } = *self;
        *self = Self { fast, pins, serial, motor, ..Self::new(variant) };
        self.start(at, out);
    }

    fn start(&mut self, at: Instant, out: &mut dyn Context) {
        self.bank = self.stored(out);
        self.clock = Clock::new(at);
        self.serial.set_rate(at, self.rate(), out);
        self.release_port(at, out);
        self.state = State::Starting(if self.fast { at } else { at + STARTUP });
    }

    /// Ends the start-up if it is due.
    pub(super) fn ready_if_due(&mut self, at: Instant, out: &mut dyn Context) {
        if let State::Starting(ready) = self.state
            && ready <= at
        {
            self.ready(at, out);
        }
    }

    /// Returns true if the adapter has power.
    pub(super) fn has_run(&self) -> bool {
        self.state != State::Off
    }

    /// Returns true if the start-up has ended.
    pub(super) fn is_ready(&self) -> bool {
        self.state == State::Ready
    }

    /// Time from which the adapter receives commands.
    pub(super) fn receives_from(&self) -> Instant {
        match self.state {
            State::Off => Instant::NEVER,
            State::Starting(ready) => ready,
            State::Ready => Instant::ZERO,
        }
    }

    /// Ends the start-up.
    fn ready(&mut self, at: Instant, out: &mut dyn Context) {
        self.state = State::Ready;
        self.counter = Ls7366r::new(self.pins.a, self.pins.b, self.index_level());
        for reg in [Reg::Mdr0, Reg::Mdr1, Reg::Dtr] {
            self.configure_counter(at, reg);
        }
        self.counter.clear_status();
        self.update_port(at, out);
        if self.variant.motor && self.bank.word(Reg::MotorDrive) != 0 {
            self.motor.activate(at, out);
        }
        self.serial.send(at, &command::banner(self.variant.letter, self.firmware()), out);
        self.resume_streams(at);
    }

    pub(super) fn deadline(&self) -> Instant {
        let starting = match self.state {
            State::Starting(ready) => ready,
            State::Off | State::Ready => Instant::NEVER,
        };
        let counter = if self.watches_counter() { self.counter.deadline() } else { Instant::NEVER };
        starting
            .min(counter)
            .min(self.save.due())
            .min(self.pulse_due())
            .min(self.motor.deadline())
            .min(self.stream_due())
    }

    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        self.catch_up(at, out);
        self.save.timeout(at, out);
        if self.pulse_due() <= at {
            self.end_pulse(at, out);
        }
        if self.motor.deadline() <= at {
            self.motor.timeout(at, out);
        }
        if self.stream_due() <= at {
            self.stream(at, out);
        }
        self.ready_if_due(at, out);
        self.note_changes(at);
    }

    /// Handles an input of a pin, or the counts of a board's hardware counter.
    pub(super) fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        match input {
            Input::Edge { pin: A, high } => self.level(at, high),
            Input::Edge { pin: B, high } => {
                self.pins.b = high;
                self.count(at, Channel::B, high);
            }
            Input::Edge { pin: I, high } => {
                self.pins.index = high;
                self.count(at, Channel::Index, self.index_level());
            }
            Input::Edge { pin, high } => self.line_edge(at, pin, high, out),
            Input::Millivolts { pin: A, mv } => self.voltage(at, mv),
            Input::Count { steps, a, b, .. } => {
                (self.pins.a, self.pins.b) = (a, b);
                if self.is_ready() {
                    self.counter.take_steps(steps, a, b);
                }
            }
            Input::StepsCorrection { steps, .. } => self.motor.correct_steps(steps),
            _ => {}
        }
        if self.watches_counter() {
            self.catch_up(at, out);
        }
        self.note_changes(at);
    }

    /// Passes a level at an input to the counter.
    pub(super) fn count(&mut self, at: Instant, channel: Channel, high: bool) {
        if self.is_ready() {
            self.counter.edge(at, channel, high);
        }
    }

    /// The level of INDEX/, with the polarity of MDR1.
    pub(super) fn index_level(&self) -> bool {
        self.pins.index == (self.bank.word(Reg::Mdr1) & mdr1::INVERT_INDEX != 0)
    }

    /// Returns true if events of the counter have an effect.
    fn watches_counter(&self) -> bool {
        let triggers = self.bank.word(Reg::Mdr1) & mdr1::TRIGGERS != 0;
        self.is_ready() && (triggers || self.streams.running() & stream::STATUS != 0)
    }

    /// Updates the counter, and executes the triggers of MDR1 (QSB-22).
    pub(super) fn catch_up(&mut self, at: Instant, out: &mut dyn Context) {
        flush_filter(&mut self.counter, at);
        let events = u16::from(self.counter.take_events()) & self.bank.word(Reg::Mdr1) & mdr1::TRIGGERS;
        if events & u16::from(status::IDX) != 0 {
            self.bank.set(Reg::Capture, i64::from(self.counter.at_index()));
        }
        if events != 0 {
            self.trigger(at, out);
        }
    }

    /// Returns true if this variant has a row.
    pub(super) fn has(&self, row: &Entry) -> bool {
        row.variants & self.variant.bit != 0
    }
}

/// Applies the edges that have passed the counter's filter by `at`. Never inlined, because each copy takes a
/// kilobyte of a board's flash.
#[inline(never)]
pub(super) fn flush_filter(counter: &mut Ls7366r, at: Instant) {
    counter.timeout(at);
}
