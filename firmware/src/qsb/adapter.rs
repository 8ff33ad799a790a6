//! The adapter: its registers, and what happens when a command comes.
//!
//! | file | what of the adapter |
//! |---|---|
//! | `clock` | the clock of 512 Hz, and TIME STAMP |
//! | `command` | commands and responses as text |
//! | `encoder` | MODE: what READ ENCODER brings |
//! | `motor` | the motor drive |
//! | `port` | the digital port, captures, the pulse of a trigger |
//! | `saved` | what outlasts a reset |
//! | `serial` | texts that leave, one behind the other |
//! | `stream` | what is sent without being asked for |

use standin_protocol::registers::{Bank, Entry, Register, Shape, Space};
use standin_protocol::text::Line;

use super::clock::Clock;
use super::command::{self, Command, LINE_CHARACTERS, Response, Verb};
use super::encoder::{Mode, Pwm};
use super::motor::{Motor, Order, Settings};
use super::registers::{Reg, mdr1, variant};
use super::saved::Save;
use super::serial::Serial;
use super::stream::{self, Streams};
use super::{A, ANALOG, B, I, PWM, USB, Words};
use crate::counter::{Channel, Ls7366r, status};
use crate::device::{Duration, Input, Instant, Note, Output, Refused, Sink, Spec};

/// From a reset to the banner; the list does not say.
const STARTUP: Duration = Duration::millis(50);
/// Firmware, the two last digits of VERSION.
const FIRMWARE: i64 = 0x0E;

/// Whether the adapter listens.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// It never had power.
    Off,
    /// Until the banner, which comes at that instant.
    Starting(Instant),
    Ready,
}

/// What comes from outside, which outlasts a reset.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pins {
    pub(super) a: bool,
    b: bool,
    index: bool,
    /// Voltage at A.
    pub(super) mv: i32,
    /// DIO3 to DIO0.
    pub(super) dio: u8,
}

impl Pins {
    /// Nothing is connected.
    const OPEN: Self = Self { a: true, b: true, index: false, mv: 0, dio: 0xF };
}

/// A QSB without the receiving half of its port.
#[derive(Clone, Debug)]
pub(super) struct Adapter {
    pub(super) spec: &'static Spec,
    state: State,
    /// No start-up delay.
    fast: bool,
    pub(super) pins: Pins,
    /// The registers; DIG I/O is what was written to it.
    pub(super) bank: Words,
    pub(super) clock: Clock,
    pub(super) serial: Serial,
    pub(super) counter: Ls7366r,
    pub(super) pwm: Pwm,
    /// Lines of the port that it pulls low, a bit each; those of the motor drive are not among them.
    pub(super) pulled: u8,
    /// When the pulse of a trigger ends, which inverts DIO0.
    pub(super) pulse: Option<Instant>,
    pub(super) streams: Streams,
    pub(super) motor: Motor,
    pub(super) save: Option<Save>,
}

impl Adapter {
    pub(super) fn new(spec: &'static Spec) -> Self {
        let at = Instant::ZERO;
        Self {
            spec,
            state: State::Off,
            fast: false,
            pins: Pins::OPEN,
            bank: Bank::factory(),
            clock: Clock::new(at),
            serial: Serial::new(at),
            counter: Ls7366r::new(true, true, true),
            pwm: Pwm::default(),
            pulled: 0,
            pulse: None,
            streams: Streams::new(),
            motor: Motor::new(at),
            save: None,
        }
    }

    /// Power comes.
    pub(super) fn power_on(&mut self, at: Instant, fast: bool, out: &mut dyn Sink) {
        *self = Self { motor: Motor::new(at), fast, ..Self::new(self.spec) };
        self.start(at, out);
    }

    /// A reset by the host, which cuts no save.
    pub(super) fn reset(&mut self, at: Instant, out: &mut dyn Sink) {
        if self.state == State::Off {
            return;
        }
        self.finish_save(at, out);
        self.motor.deactivate(at, out);
        let motor = self.motor.clone();
        *self = Self { pins: self.pins, serial: self.serial, motor, fast: self.fast, ..Self::new(self.spec) };
        self.start(at, out);
    }

    fn start(&mut self, at: Instant, out: &mut dyn Sink) {
        self.bank = self.stored(out);
        self.clock = Clock::new(at);
        self.serial.set_rate(at, self.rate(), out);
        self.release_port(at, out);
        self.state = State::Starting(if self.fast { at } else { at + STARTUP });
    }

    /// Whether a character that ends now is heard.
    pub(super) fn listens(&mut self, at: Instant, out: &mut dyn Sink) -> bool {
        if let State::Starting(ready) = self.state
            && ready <= at
        {
            self.ready(at, out);
        }
        self.is_ready()
    }

    pub(super) fn is_ready(&self) -> bool {
        self.state == State::Ready
    }

    /// The start is over.
    fn ready(&mut self, at: Instant, out: &mut dyn Sink) {
        self.state = State::Ready;
        self.counter = Ls7366r::new(self.pins.a, self.pins.b, self.index_level());
        for reg in [Reg::Mdr0, Reg::Mdr1, Reg::Dtr] {
            self.configure_counter(at, reg);
        }
        self.counter.clear_status();
        self.show_port(at, out);
        if self.has_motor() && self.bank.word(Reg::MotorDrive) != 0 {
            self.motor.activate(at, out);
        }
        let product = match self.spec.variant {
            variant::D => b'D',
            variant::S => b'S',
            _ => b'M',
        };
        let [tens, ones] = *b"0E";
        self.serial.send(
            at,
            &[b'Q', b'S', b'B', b'-', product, b' ', b' ', tens, ones, b'!', b'\r', b'\n'],
            out,
        );
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
            .min(self.save_due())
            .min(self.pulse_due())
            .min(self.motor.deadline())
            .min(self.stream_due())
    }

    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Sink) {
        self.look(at, out);
        if self.save_due() <= at {
            self.finish_save(at, out);
        }
        if self.pulse_due() <= at {
            self.end_pulse(at, out);
        }
        if self.motor.deadline() <= at {
            self.motor.timeout(at, out);
        }
        if self.stream_due() <= at {
            self.stream(at, out);
        }
        self.listens(at, out);
        self.look_for_changes(at);
    }

    /// A pin, or what a board has counted.
    pub(super) fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Sink) {
        match input {
            Input::Edge { pin: A | PWM, high } => self.level(at, high),
            Input::Edge { pin: B, high } => {
                self.pins.b = high;
                self.count(at, Channel::B, high);
            }
            Input::Edge { pin: I, high } => {
                self.pins.index = high;
                self.count(at, Channel::Index, self.index_level());
            }
            Input::Edge { pin, high } => self.line_edge(at, pin, high, out),
            Input::Millivolts { pin: A | ANALOG, mv } => self.voltage(at, mv),
            Input::Count { steps, a, b, .. } => {
                (self.pins.a, self.pins.b) = (a, b);
                if self.is_ready() {
                    self.counter.take_steps(steps, a, b);
                }
            }
            Input::Slipped { steps, .. } => self.motor.slipped(steps),
            _ => {}
        }
        if self.watches_counter() {
            self.look(at, out);
        }
        self.look_for_changes(at);
    }

    /// A level at an input of the counter.
    pub(super) fn count(&mut self, at: Instant, channel: Channel, high: bool) {
        if self.is_ready() {
            self.counter.edge(at, channel, high);
        }
    }

    /// The level of INDEX/.
    fn index_level(&self) -> bool {
        self.pins.index == (self.bank.word(Reg::Mdr1) & mdr1::INVERT_INDEX != 0)
    }

    /// Whether something is to happen when the counter does.
    fn watches_counter(&self) -> bool {
        let triggers = self.bank.word(Reg::Mdr1) & mdr1::TRIGGERS != 0;
        self.is_ready() && (triggers || self.streams.running() & stream::STATUS != 0)
    }

    /// Brings the counter up to date, and does what MDR1 wants of what has happened there.
    pub(super) fn look(&mut self, at: Instant, out: &mut dyn Sink) {
        self.counter.timeout(at);
        let events = u16::from(self.counter.take_events()) & self.bank.word(Reg::Mdr1) & mdr1::TRIGGERS;
        if events & u16::from(status::IDX) != 0 {
            self.bank.set(Reg::Capture, i64::from(self.counter.at_index()));
        }
        if events != 0 {
            self.trigger(at, out);
        }
    }

    /// A line has come: carries out its command, and answers.
    pub(super) fn execute(&mut self, at: Instant, line: &Line<LINE_CHARACTERS>, out: &mut dyn Sink) {
        self.look(at, out);
        let rate = self.rate();
        let response = match command::parse(line) {
            Ok(command) => self.answer(at, command, out),
            Err(register) => unsupported(register),
        };
        let function = line.text.first().copied().unwrap_or(0);
        out.put(
            at,
            Output::Note(match response.letter {
                code @ (b'e' | b'x') => Note::Refused { port: USB, function, code },
                _ => Note::Request { port: USB, unit: 0, function },
            }),
        );
        self.respond(at, response, out);
        self.follow_rate(at, rate, out);
        self.look_for_changes(at);
    }

    fn answer(&mut self, at: Instant, command: Command, out: &mut dyn Sink) -> Response {
        let Command { verb, register } = command;
        let Some((reg, row)) = self.find(command) else { return unsupported(register) };
        let (letter, data) = match verb {
            Verb::Read => {
                self.streams.end_of(reg);
                (b'r', self.value(at, reg) as u32)
            }
            Verb::Stream => {
                self.begin_stream(at, reg);
                (b's', self.value(at, reg) as u32)
            }
            Verb::Write(data) => {
                let value = if row.shape == Shape::I32 { data.cast_signed().into() } else { data.into() };
                let taken = row.accepts(value) && self.write(at, reg, value, out);
                (if taken { b'w' } else { b'e' }, data)
            }
        };
        Response { letter, register, data }
    }

    /// The register of a command, if this variant has it and the letter may be used with it.
    fn find(&self, command: Command) -> Option<(Reg, &'static Entry)> {
        let (index, _) = Reg::ENTRIES.at(Space::Holding, u16::from(command.register))?;
        let row = Reg::ENTRIES.list.get(index)?;
        let allowed = match command.verb {
            Verb::Read => row.access.reads(),
            Verb::Write(_) => row.access.writes(),
            Verb::Stream => row.streams,
        };
        Reg::from_row(index).filter(|_| allowed && self.has(row)).map(|reg| (reg, row))
    }

    /// Whether this variant has a row.
    pub(super) fn has(&self, row: &Entry) -> bool {
        row.variants & self.spec.variant != 0
    }

    fn has_motor(&self) -> bool {
        self.spec.variant == variant::M
    }

    /// The present value of a register leaves under this letter.
    pub(super) fn tell(&mut self, at: Instant, letter: u8, reg: Reg, out: &mut dyn Sink) {
        let register = Reg::ENTRIES.list.get(reg.row()).map_or(0, |row| row.address as u8);
        let data = self.value(at, reg) as u32;
        self.respond(at, Response { letter, register, data }, out);
    }

    fn respond(&mut self, at: Instant, response: Response, out: &mut dyn Sink) {
        let text = response.text(self.bank.word(Reg::Eor), self.clock.number(at));
        self.serial.send(at, text.as_bytes(), out);
    }

    /// The rate of command A.
    fn rate(&self) -> u8 {
        self.bank.word(Reg::BaudRate) as u8
    }

    /// Changes the line if the rate is not `before` any more.
    fn follow_rate(&mut self, at: Instant, before: u8, out: &mut dyn Sink) {
        if self.rate() != before {
            self.serial.set_rate(at, self.rate(), out);
        }
    }

    /// A register as it reads, with the counter up to date.
    pub(super) fn value(&self, at: Instant, reg: Reg) -> i64 {
        match reg {
            Reg::Mode => self.mode_register(),
            Reg::DigIO => self.port(at).into(),
            Reg::Str => self.counter.status().into(),
            Reg::Otr => self.counter.cntr().into(),
            Reg::TimeStamp => self.clock.number(at).into(),
            Reg::ReadEncoder => self.encoder_register(at).into(),
            Reg::MdStatus => self.motor.status(at).into(),
            Reg::Version => self.version(),
            _ => self.bank.get(reg),
        }
    }

    /// VERSION: decimal digits of the serial number, then the product and the firmware.
    fn version(&self) -> i64 {
        let product = match self.spec.variant {
            variant::D => 0,
            variant::M => 1,
            _ => 2,
        };
        let serial = self.bank.get(Reg::SerialNumber);
        let digits = [10_000, 1_000, 100, 10, 1].map(|unit| serial / unit % 10);
        digits.into_iter().fold(0, |version, digit| version << 4 | digit) << 12 | product << 8 | FIRMWARE
    }

    /// Writes a value that the register's row accepts, and does what that means, in the list's order.
    /// False if it is refused for another reason.
    fn write(&mut self, at: Instant, reg: Reg, value: i64, out: &mut dyn Sink) -> bool {
        if reg == Reg::Command {
            return self.command(at, value, out);
        }
        let pwm_before = self.mode() == Mode::Pwm;
        self.bank.set(reg, kept(reg, value));
        match reg {
            Reg::Mode => {
                if !pwm_before || self.mode() != Mode::Pwm {
                    self.pwm = Pwm::default();
                }
                self.schedule(at);
            }
            Reg::DigIO => self.end_pulse(at, out),
            Reg::DigIOConfig => {
                self.bank.set(Reg::DigIO, 0xF);
                self.end_pulse(at, out);
            }
            Reg::Mdr0 | Reg::Mdr1 | Reg::Dtr => self.configure_counter(at, reg),
            Reg::ClearReg => match value {
                0 => return self.write(at, Reg::Mdr0, 0, out),
                1 => return self.write(at, Reg::Mdr1, 0, out),
                2 => self.counter.clear_cntr(),
                _ => self.counter.clear_status(),
            },
            Reg::LoadReg => match value {
                0 => self.counter.load_cntr(),
                _ => self.counter.load_otr(),
            },
            Reg::IntervalRate => self.schedule(at),
            Reg::TimeStamp if value == 1 => self.clock.set_number(at, 0),
            // The others are looked at when they are used.
            _ => {}
        }
        true
    }

    /// Takes a register of the counter from the bank.
    fn configure_counter(&mut self, at: Instant, reg: Reg) {
        match reg {
            Reg::Mdr0 => self.counter.set_mdr0(self.bank.word(Reg::Mdr0) as u8),
            Reg::Mdr1 => {
                let mdr1 = self.bank.word(Reg::Mdr1);
                self.counter.set_mdr1((mdr1 & !mdr1::WIDTH) as u8);
                self.counter.set_reversed(mdr1 & mdr1::COUNT_DOWN != 0);
                self.counter.edge(at, Channel::Index, self.index_level());
            }
            _ => self.counter.set_dtr(self.bank.get(Reg::Dtr) as u32),
        }
    }

    /// COMMAND. False if it is refused: it is of another variant, or the motor cannot obey.
    fn command(&mut self, at: Instant, value: i64, out: &mut dyn Sink) -> bool {
        let order = match value {
            1 => {
                self.streams.end(stream::ENDED_BY_COMMAND);
                return true;
            }
            3 => {
                self.save_parameters(at, out);
                return true;
            }
            rate if rate & 0xFF == 0x0A => {
                self.save_rate(at, rate >> 8, out);
                return true;
            }
            _ if !self.has_motor() => return false,
            0 => {
                self.leave_motor(at, out);
                return true;
            }
            2 => {
                self.motor.activate(at, out);
                self.show_port(at, out);
                return true;
            }
            4 => Order::Stop,
            5 => Order::Quit,
            6 => Order::Pause,
            7 => Order::Resume,
            8 => Order::Move,
            _ => Order::Jog,
        };
        let settings = Settings {
            step_rate: self.bank.word(Reg::MdStepRate),
            acceleration: self.bank.get(Reg::MdAccel) as u32,
            steps: self.bank.get(Reg::MdMoveSteps) as i32,
            jog_rate: self.bank.get(Reg::MdJogRate) as i32,
        };
        self.motor.order(at, order, &settings, out)
    }

    /// Command 0: the motor drive ends, its streams too, and the port is as it was saved.
    fn leave_motor(&mut self, at: Instant, out: &mut dyn Sink) {
        self.streams.end(stream::ENDED_BY_COMMAND);
        let stored = self.stored(out);
        for reg in [Reg::DigIO, Reg::DigIOConfig] {
            self.bank.set(reg, stored.get(reg));
        }
        let had_lines = self.motor.is_active();
        self.motor.deactivate(at, out);
        self.end_pulse(at, out);
        if had_lines {
            self.motor_left(at, out);
        }
    }

    /// A register as it would read, past the bus.
    pub(super) fn peek(&self, at: Instant, row: usize) -> i64 {
        let Some(reg) = Reg::from_row(row) else { return 0 };
        let mut then = self.clone();
        then.counter.timeout(at);
        then.value(at, reg)
    }

    /// Presets a register, past the bus.
    pub(super) fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Sink,
    ) -> Result<(), Refused> {
        let reg = Reg::from_row(row).ok_or(Refused::NoSuchRegister)?;
        let row = Reg::ENTRIES.list.get(row).filter(|row| self.has(row)).ok_or(Refused::NoSuchRegister)?;
        if !row.accepts(value) {
            return Err(Refused::OutOfRange);
        }
        if self.state == State::Off {
            let saved = row.saved != 0;
            return if saved { self.preset(at, reg, kept(reg, value), out) } else { Err(Refused::ReadOnly) };
        }
        self.look(at, out);
        let rate = self.rate();
        match reg {
            // Only command 3 fills these in.
            Reg::MotorDrive | Reg::Streams => return Err(Refused::ReadOnly),
            Reg::TimeStamp => self.clock.set_number(at, value as u32),
            _ if !row.access.writes() => return Err(Refused::ReadOnly),
            _ if !self.write(at, reg, value, out) => return Err(Refused::OutOfRange),
            _ => self.follow_rate(at, rate, out),
        }
        self.look_for_changes(at);
        Ok(())
    }
}

/// What a register keeps of a value.
fn kept(reg: Reg, value: i64) -> i64 {
    match reg {
        Reg::Mode => value & 3,
        Reg::Mdr1 => value & !i64::from(mdr1::WIDTH),
        _ => value,
    }
}

/// The answer to what is not understood.
fn unsupported(register: u8) -> Response {
    Response { letter: b'x', register, data: 0 }
}
