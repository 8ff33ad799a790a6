//! Tests that run a drive in virtual time and compare its behaviour and its times with the manual and the
//! decisions.

mod alarms;
mod bus;
mod commands;
mod limits;
mod reasons;
mod saved;
mod startup;

use core::ops::{Deref, DerefMut};
use std::vec;
use std::vec::Vec;

use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::registers::Register;
use drivetwin_protocol::time::Span;

use super::{ALARM, CLUTCH, FAN, HU, HV, HW, MEMORY, Mdrobot, Pid};
use crate::device::{
    Boot, Device, DropReason, Duration, Input, Instant, Level, Line, LogEvent, Output, Pin, Port, PresetError,
};
use crate::motor::DriveWithMotor;
use crate::testing::{Fixture, Treatment};

/// Duration of a character of 19,200 8N1: 10 bits, 8,333.3 ticks.
const CHARACTER: Duration = Duration::from_ticks(8_333);

/// Settings of a serial line of the drive.
const fn line(baud: u32) -> Line {
    Line::new(baud, 8, Parity::None, 1)
}

/// A drive with its motor, and the id that the tests use for it.
struct Dut {
    fixture: Fixture<DriveWithMotor<Mdrobot>>,
    id: u8,
}

impl Deref for Dut {
    type Target = Fixture<DriveWithMotor<Mdrobot>>;

    fn deref(&self) -> &Self::Target {
        &self.fixture
    }
}

impl DerefMut for Dut {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.fixture
    }
}

impl Dut {
    /// A drive without power, with this content of its memory.
    fn off(memory: Vec<u8>) -> Self {
        let fixture = Fixture::with_memory(Mdrobot::md400(), memory).ruled(|output| match output {
            // Levels of the motor's sensors.
            Output::Level { pin: HU | HV | HW, .. } => Treatment::Ignore,
            // Outputs for an external motor.
            Output::Duty { .. } | Output::CurrentLimit { .. } => Treatment::Ignore,
            Output::Bytes { .. }
            | Output::Level { .. }
            | Output::Line { .. }
            | Output::Log(_)
            | Output::Store { .. } => Treatment::Keep,
            _ => Treatment::Refuse,
        });
        Self { fixture, id: 1 }
    }

    fn new() -> Self {
        Self::off(vec![0xFF; MEMORY])
    }

    /// A new drive that is powered on at 0.
    fn booting() -> Self {
        let mut dut = Self::new();
        dut.power_on(Boot::default());
        dut
    }

    /// A new drive that is ready at 0.
    fn ready() -> Self {
        let mut dut = Self::new();
        dut.power_on_fast();
        dut
    }

    /// A new drive that is ready at 0 and executes motion commands of the bus.
    fn armed() -> Self {
        let mut dut = Self::ready();
        dut.write(78, 1);
        dut.write(100, 1);
        dut
    }

    /// Switches power off, and on again 1 s later. Earlier outputs are cleared from the record.
    fn cycle(&mut self) {
        self.out.clear();
        self.fixture.cycle();
    }

    /// Sends a frame, ends it by an idle line, and returns the drive's reply; advances the time to the end of
    /// the reply.
    fn ask(&mut self, frame: &[u8]) -> Vec<u8> {
        let before = self.out.bytes.len();
        let first = self.now + CHARACTER;
        self.input(first, Input::Bytes { port: Port(0), bytes: frame });
        self.input(first + CHARACTER * (frame.len() as u64 - 1), Input::Idle { port: Port(0) });
        let Some((at, _, reply)) = self.out.bytes.get(before).cloned() else { return Vec::new() };
        self.run_until(at + CHARACTER * reply.len() as u64);
        reply
    }

    /// Sends a PDU to the drive and returns the PDU of the reply; empty if there is no reply.
    fn pdu(&mut self, pdu: &[u8]) -> Vec<u8> {
        let reply = self.ask(&rtu::frame(self.id, pdu));
        rtu::verify_crc(&reply).map_or(Vec::new(), |body| body[1..].to_vec())
    }

    /// Reads words by function 3.
    fn read_words(&mut self, pid: u8, quantity: u8) -> Vec<u16> {
        let reply = self.pdu(&[3, 0, pid, 0, quantity]);
        assert_eq!(reply[..2], [3, 2 * quantity], "PID {pid}");
        reply[2..].as_chunks::<2>().0.iter().map(|word| u16::from_be_bytes(*word)).collect()
    }

    /// Reads one word by function 3.
    fn read(&mut self, pid: u8) -> u16 {
        self.read_words(pid, 1)[0]
    }

    /// Writes a word by function 6; the drive must accept it.
    fn write(&mut self, pid: u8, value: u16) {
        let [high, low] = value.to_be_bytes();
        assert_eq!(self.try_write(pid, value), [6, 0, pid, high, low], "PID {pid} = {value}");
    }

    /// Writes a word by function 6 and returns the reply.
    fn try_write(&mut self, pid: u8, value: u16) -> Vec<u8> {
        let [high, low] = value.to_be_bytes();
        self.pdu(&[6, 0, pid, high, low])
    }

    /// Writes words by function 16 and returns the reply.
    fn try_write_words(&mut self, pid: u8, words: &[u16]) -> Vec<u8> {
        let count = words.len() as u8;
        let mut pdu = vec![16, 0, pid, 0, count, 2 * count];
        pdu.extend(words.iter().flat_map(|word| word.to_be_bytes()));
        self.pdu(&pdu)
    }

    /// Writes words by function 16; the drive must accept them.
    fn write_words(&mut self, pid: u8, words: &[u16]) {
        let reply = self.try_write_words(pid, words);
        assert_eq!(reply, [16, 0, pid, 0, words.len() as u8], "PID {pid} = {words:?}");
    }

    /// Closes a contact to ground, or opens it, now.
    fn contact(&mut self, pin: Pin, closed: bool) {
        self.edge(pin, !closed);
    }

    /// Present level of an output; `rest` if the drive has not driven it yet.
    fn level(&self, pin: Pin, rest: Level) -> Level {
        self.out.level(pin).unwrap_or(rest)
    }

    /// Returns true if the ALARM pin shows an alarm.
    fn alarm(&self) -> bool {
        self.level(ALARM, Level::High) == Level::Low
    }

    /// Present value of `RPM_DATA`.
    fn rpm(&self) -> i64 {
        self.get(Pid::RPM_DATA)
    }
}
