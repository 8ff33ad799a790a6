//! The adapter: commands and their responses, streams, start-up and resets.
//!
//! | file | part of the adapter |
//! |---|---|
//! | `command` | commands and responses as text |
//! | `instrument` | the parts whose state the registers show and set |
//! | `encoder` | the signals at A, B and I |
//! | `port` | the digital port |
//! | `clock` | the clock of 512 Hz |
//! | `motor` | the motor drive of a QSB-M |
//! | `stream` | the streams: which register is sent when |
//! | `serial` | the serial line, on which texts wait for each other |
//! | `saved` | the values in the non-volatile memory |
//! | `reasons` | reasons why an accepted request has no effect |
//!
//! A part knows nothing of the adapter. The instrument has the encoder, the port, the clock and the motor; the streams
//! read it.

use drivetwin_protocol::registers::{Entry, Register, Shape, Space};
use drivetwin_protocol::text::{Lines, TextLine};

use super::command::{self, Command, LINE_CHARACTERS, Response, Verb};
use super::instrument::{Instrument, stored_value};
use super::motor::Order;
use super::registers::{Reg, Variant};
use super::saved::Saved;
use super::serial::Serial;
use super::stream::Streams;
use super::{USB, Words};
use crate::device::{Boot, Context, DropReason, Duration, Input, Instant, LogEvent, Output, PresetError};

/// Time from a reset to the banner; the list of commands does not specify it (QSB-6).
const STARTUP: Duration = Duration::millis(50);

/// Drops the characters of a command received so far (QSB-1).
const BACKSPACE: u8 = 0x08;

/// State of the adapter, from power-on to ready.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// The adapter has no power.
    Off,
    /// Start-up: the banner is sent at this instant.
    Starting(Instant),
    Ready,
}

/// A QSB without its description.
#[derive(Clone, Debug)]
pub(super) struct Adapter {
    state: State,
    /// True if there is no start-up delay.
    fast: bool,
    /// Received characters of a command.
    lines: Lines<LINE_CHARACTERS>,
    instrument: Instrument,
    serial: Serial,
    streams: Streams,
    saved: Saved,
}

impl Adapter {
    pub(super) fn new(variant: Variant) -> Self {
        let at = Instant::ZERO;
        Self {
            state: State::Off,
            fast: false,
            lines: Lines::new(),
            instrument: Instrument::new(at, variant),
            serial: Serial::new(at, false),
            streams: Streams::new(),
            saved: Saved::new(),
        }
    }

    /// Handles power-on.
    pub(super) fn power_on(&mut self, at: Instant, boot: Boot, out: &mut dyn Context) {
        self.fast = boot.fast;
        self.instrument = Instrument::new(at, self.instrument.variant());
        self.serial = Serial::new(Instant::ZERO, boot.fast_line);
        self.saved = Saved::new();
        self.start(at, out);
    }

    /// Switches the power off. Only presets follow until the next power-on.
    pub(super) fn power_off(&mut self) {
        self.state = State::Off;
    }

    /// Handles a reset by the host. A running save is finished first.
    fn reset(&mut self, at: Instant, out: &mut dyn Context) {
        if self.state == State::Off {
            return;
        }
        self.saved.finish(at, out);
        self.instrument.deactivate_motor(at, out);
        self.serial.clear();
        self.start(at, out);
    }

    fn start(&mut self, at: Instant, out: &mut dyn Context) {
        self.lines.clear();
        let words = self.saved.words(out);
        self.serial.set_rate(at, rate(&words), out);
        self.instrument.start(at, words, out);
        self.streams = Streams::new();
        self.state = State::Starting(if self.fast { at } else { at + STARTUP });
    }

    /// Ends the start-up if it is due: sends the banner, and starts the saved streams, as if they were requested now
    /// (QSB-13).
    fn ready_if_due(&mut self, at: Instant, out: &mut dyn Context) {
        if self.receives_from() > at || self.state == State::Ready {
            return;
        }
        self.state = State::Ready;
        self.instrument.ready(at, out);
        self.serial.send(at, &self.instrument.banner(), out);
        for reg in Streams::saved(self.instrument.bank().word(Reg::Streams)) {
            if Reg::ENTRIES.list.get(reg.row()).is_some_and(|row| self.instrument.has(row)) {
                let value = self.instrument.measure(at, reg);
                let _ = self.streams.begin(at, reg, value, self.instrument.pace());
            }
        }
    }

    /// Returns true if the start-up has ended.
    fn is_ready(&self) -> bool {
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

    pub(super) fn deadline(&self) -> Instant {
        let starting = if self.is_ready() { Instant::NEVER } else { self.receives_from() };
        starting
            .min(self.instrument.deadline(self.streams.has_status()))
            .min(self.saved.deadline())
            .min(self.streams.deadline(self.serial.free_at()))
    }

    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        self.instrument.timeout(at, out);
        self.saved.timeout(at, out);
        self.ready_if_due(at, out);
        if at < self.streams.deadline(self.serial.free_at()) {
            self.settle(at);
        } else if let Some((reg, value)) = self.streams.take_record(at, &self.instrument) {
            self.send(at, b's', reg, value, out);
        }
    }

    /// Notes which streams an event has changed.
    fn settle(&mut self, at: Instant) {
        self.streams.note_changes(at, &self.instrument);
    }

    /// Handles an input.
    pub(super) fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        match input {
            Input::Bytes { bytes, .. } => {
                for character in bytes {
                    self.on_character(at, Some(*character), out);
                }
            }
            Input::RxError { .. } => self.on_character(at, None, out),
            Input::HostPresence { here: true, .. } => self.reset(at, out),
            _ => {
                self.instrument.input(at, input, self.streams.has_status(), out);
                self.settle(at);
            }
        }
    }

    /// Handles a received character, or `None` for a character with an error.
    fn on_character(&mut self, at: Instant, character: Option<u8>, out: &mut dyn Context) {
        self.ready_if_due(at, out);
        if !self.is_ready() {
            out.put(at, Output::Log(LogEvent::Dropped { port: USB, why: DropReason::Starting }));
            return;
        }
        match character {
            None => {
                self.lines.rx_error();
                out.put(at, Output::Log(LogEvent::Dropped { port: USB, why: DropReason::RxError }));
            }
            Some(BACKSPACE) => self.lines.clear(),
            Some(character) => {
                if let Some(line) = self.lines.push(character) {
                    self.execute(at, &line, out);
                }
            }
        }
    }

    /// Executes the command of a received line, and sends the response.
    fn execute(&mut self, at: Instant, line: &TextLine<LINE_CHARACTERS>, out: &mut dyn Context) {
        self.instrument.catch_up(at, out);
        let response = match command::parse(line) {
            Ok(command) => self.dispatch(at, command, out),
            Err(register) => unsupported(register),
        };
        let function = line.text.first().copied().unwrap_or(0);
        out.put(
            at,
            Output::Log(match response.letter {
                code @ (b'e' | b'x') => LogEvent::Refused { port: USB, function, code },
                _ => LogEvent::Request { port: USB, unit: 0, function },
            }),
        );
        self.respond(at, response, out);
        self.serial.set_rate(at, rate(self.instrument.bank()), out);
        self.settle(at);
    }

    fn dispatch(&mut self, at: Instant, command: Command, out: &mut dyn Context) -> Response {
        let Command { verb, register } = command;
        let Some((reg, row)) = self.find(command) else { return unsupported(register) };
        let (letter, data) = match verb {
            Verb::Read => {
                self.streams.end_of(reg);
                (b'r', self.instrument.value(at, reg) as u32)
            }
            Verb::Stream => {
                let value = self.instrument.measure(at, reg);
                if let Err(why) = self.streams.begin(at, reg, value, self.instrument.pace()) {
                    why.put(at, out);
                }
                (b's', self.instrument.data(at, reg, value))
            }
            Verb::Write(data) => {
                let value = if row.shape == Shape::I32 { data.cast_signed().into() } else { data.into() };
                let accepted = row.accepts(value) && self.write(at, reg, value, out);
                (if accepted { b'w' } else { b'e' }, data)
            }
        };
        Response { letter, register, data }
    }

    /// The register of a command, if this variant has it and the letter is allowed with it.
    fn find(&self, command: Command) -> Option<(Reg, &'static Entry)> {
        let (index, _) = Reg::ENTRIES.at(Space::Holding, u16::from(command.register))?;
        let row = Reg::ENTRIES.list.get(index)?;
        let allowed = match command.verb {
            Verb::Read => row.access.reads(),
            Verb::Write(_) => row.access.writes(),
            Verb::Stream => row.streams,
        };
        Reg::from_row(index).filter(|_| allowed && self.instrument.has(row)).map(|reg| (reg, row))
    }

    /// Writes a value that the register's row accepts. Returns false if the adapter refuses the write for a reason that
    /// the row does not state.
    fn write(&mut self, at: Instant, reg: Reg, value: i64, out: &mut dyn Context) -> bool {
        if reg == Reg::Command {
            return self.command(at, value, out);
        }
        if let Err(why) = self.instrument.write(at, reg, value, out) {
            why.put(at, out);
        }
        if matches!(reg, Reg::Mode | Reg::IntervalRate) {
            self.streams.schedule(at, self.instrument.pace());
        }
        true
    }

    /// Executes COMMAND. Returns false if it is refused: this variant does not have the command, or the motor
    /// cannot obey it.
    fn command(&mut self, at: Instant, value: i64, out: &mut dyn Context) -> bool {
        let order = match value {
            _ if is_for_motor(value) && !self.instrument.variant().motor => return false,
            0 => {
                self.release_motor(at, out);
                return true;
            }
            1 => {
                if let Err(why) = self.streams.end_by_command() {
                    why.put(at, out);
                }
                return true;
            }
            2 => {
                self.instrument.activate_motor(at, out);
                return true;
            }
            3 => {
                self.save(at, out);
                return true;
            }
            rate if rate & 0xFF == 0x0A => {
                self.instrument.note(Reg::BaudRate, rate >> 8);
                self.saved.save_value(at, Reg::BaudRate, rate >> 8, out);
                return true;
            }
            4 => Order::Stop,
            5 => Order::Quit,
            6 => Order::Pause,
            7 => Order::Resume,
            8 => Order::Move,
            _ => Order::Jog,
        };
        self.instrument.order(at, order, out)
    }

    /// Command 0: ends the motor drive mode, ends the same streams as command 1, and restores the saved values
    /// of the port.
    fn release_motor(&mut self, at: Instant, out: &mut dyn Context) {
        let ended = self.streams.end_by_command();
        let stored = self.saved.words(out);
        let was_active = self.instrument.release_motor(at, &stored, out);
        if let Err(why) = ended
            && !was_active
        {
            why.put(at, out);
        }
    }

    /// Command 3: saves the parameters.
    fn save(&mut self, at: Instant, out: &mut dyn Context) {
        self.instrument.note(Reg::Streams, self.streams.running().into());
        self.instrument.note(Reg::MotorDrive, self.instrument.is_motor_active().into());
        self.saved.save(at, self.instrument.bank(), out);
    }

    /// Sends a measured value of a register, in a response that begins with `letter`.
    fn send(&mut self, at: Instant, letter: u8, reg: Reg, value: u32, out: &mut dyn Context) {
        let register = Reg::ENTRIES.list.get(reg.row()).map_or(0, |row| row.address as u8);
        let data = self.instrument.data(at, reg, value);
        self.respond(at, Response { letter, register, data }, out);
    }

    fn respond(&mut self, at: Instant, response: Response, out: &mut dyn Context) {
        let text = response.text(self.instrument.bank().word(Reg::Eor), self.instrument.timestamp(at));
        self.serial.send(at, text.as_bytes(), out);
    }

    /// Value that a read of a register would return now. The adapter does not change.
    pub(super) fn peek(&self, at: Instant, row: usize) -> i64 {
        Reg::from_row(row).map_or(0, |reg| self.instrument.peek(at, reg))
    }

    /// Presets a register.
    pub(super) fn poke(
        &mut self,
        at: Instant,
        row: usize,
        value: i64,
        out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        let reg = Reg::from_row(row).ok_or(PresetError::NoSuchRegister)?;
        let row = Reg::ENTRIES.list.get(row).filter(|row| self.instrument.has(row));
        let row = row.ok_or(PresetError::NoSuchRegister)?;
        if !row.accepts(value) {
            return Err(PresetError::OutOfRange);
        }
        if self.state == State::Off {
            let saved = row.saved != 0;
            return if saved {
                self.saved.preset(at, reg, stored_value(reg, value), out)
            } else {
                Err(PresetError::ReadOnly)
            };
        }
        self.instrument.catch_up(at, out);
        match reg {
            // Only command 3 writes these two registers.
            Reg::MotorDrive | Reg::Streams => return Err(PresetError::ReadOnly),
            Reg::TimeStamp => self.instrument.set_timestamp(at, value as u32),
            _ if !row.access.writes() => return Err(PresetError::ReadOnly),
            _ if !self.write(at, reg, value, out) => return Err(PresetError::OutOfRange),
            _ => self.serial.set_rate(at, rate(self.instrument.bank()), out),
        }
        self.settle(at);
        Ok(())
    }
}

/// The response to an unknown command (QSB-2).
fn unsupported(register: u8) -> Response {
    Response { letter: b'x', register, data: 0 }
}

/// The code of the baud rate, as command A sets it.
fn rate(words: &Words) -> u8 {
    words.word(Reg::BaudRate) as u8
}

/// Returns true for a value of COMMAND that an adapter without a motor refuses.
pub(super) fn is_for_motor(command: i64) -> bool {
    !matches!(command, 1 | 3) && command & 0xFF != 0x0A
}
