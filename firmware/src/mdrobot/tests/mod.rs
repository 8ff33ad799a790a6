//! Scripts with times: what the manual and the decisions say happens, and when.

mod alarms;
mod bus;
mod commands;
mod limits;
mod saved;
mod startup;

use core::ops::{Deref, DerefMut};
use std::vec;
use std::vec::Vec;

use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::registers::Register;
use drivetwin_protocol::time::Span;

use super::{ALARM, CLUTCH, FAN, HU, HV, HW, MEMORY, Mdrobot, Pid, mdrobot};
use crate::device::{
    Boot, Device, DropReason, Duration, Input, Instant, Level, Line, LogEvent, Output, Pin, Port, PresetError,
};
use crate::motor::DriveWithMotor;
use crate::testing::{Fixture, Treatment};

/// A character of 19,200 8N1: 10 bits, 8,333.3 ticks.
const CHARACTER: Duration = Duration::from_ticks(8_333);

/// What it speaks on.
const fn line(baud: u32) -> Line {
    Line::new(baud, 8, Parity::None, 1)
}

/// A drive with its motor, and the id that it is spoken to by.
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
    /// A drive without power, with this memory.
    fn off(memory: Vec<u8>) -> Self {
        let fixture = Fixture::with_memory(mdrobot(), memory).ruled(|output| match output {
            // Those of the motor's sensors.
            Output::Level { pin: HU | HV | HW, .. } => Treatment::Ignore,
            // For a motor elsewhere.
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

    /// A new drive that gets power at 0.
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

    /// A new drive that the bus may move, ready at 0.
    fn armed() -> Self {
        let mut dut = Self::ready();
        dut.write(78, 1);
        dut.write(100, 1);
        dut
    }

    /// Power goes, and comes again 1 s later; what it did before is forgotten.
    fn cycle(&mut self) {
        self.out.clear();
        self.fixture.cycle();
    }

    /// A frame from now on, ended by the line, and the reply that leaves for it; time goes on to its end.
    fn ask(&mut self, frame: &[u8]) -> Vec<u8> {
        let before = self.out.bytes.len();
        let first = self.now + CHARACTER;
        self.input(first, Input::Bytes { port: Port(0), bytes: frame });
        self.input(first + CHARACTER * (frame.len() as u64 - 1), Input::Idle { port: Port(0) });
        let Some((at, _, reply)) = self.out.bytes.get(before).cloned() else { return Vec::new() };
        self.run_until(at + CHARACTER * reply.len() as u64);
        reply
    }

    /// A PDU to the drive, and that of the reply; empty if there is none.
    fn pdu(&mut self, pdu: &[u8]) -> Vec<u8> {
        let reply = self.ask(&rtu::frame(self.id, pdu));
        rtu::verify_crc(&reply).map_or(Vec::new(), |body| body[1..].to_vec())
    }

    /// Function 3, and the words that it brings.
    fn read_words(&mut self, pid: u8, quantity: u8) -> Vec<u16> {
        let reply = self.pdu(&[3, 0, pid, 0, quantity]);
        assert_eq!(reply[..2], [3, 2 * quantity], "PID {pid}");
        reply[2..].as_chunks::<2>().0.iter().map(|word| u16::from_be_bytes(*word)).collect()
    }

    /// Function 3 of one word.
    fn read(&mut self, pid: u8) -> u16 {
        self.read_words(pid, 1)[0]
    }

    /// Function 6, which is echoed.
    fn write(&mut self, pid: u8, value: u16) {
        let [high, low] = value.to_be_bytes();
        assert_eq!(self.try_write(pid, value), [6, 0, pid, high, low], "PID {pid} = {value}");
    }

    /// Function 6, and its reply.
    fn try_write(&mut self, pid: u8, value: u16) -> Vec<u8> {
        let [high, low] = value.to_be_bytes();
        self.pdu(&[6, 0, pid, high, low])
    }

    /// Function 16, and its reply.
    fn try_write_words(&mut self, pid: u8, words: &[u16]) -> Vec<u8> {
        let count = words.len() as u8;
        let mut pdu = vec![16, 0, pid, 0, count, 2 * count];
        pdu.extend(words.iter().flat_map(|word| word.to_be_bytes()));
        self.pdu(&pdu)
    }

    /// Function 16, which is accepted.
    fn write_words(&mut self, pid: u8, words: &[u16]) {
        let reply = self.try_write_words(pid, words);
        assert_eq!(reply, [16, 0, pid, 0, words.len() as u8], "PID {pid} = {words:?}");
    }

    /// A contact is closed to ground, or opened, now.
    fn contact(&mut self, pin: Pin, closed: bool) {
        self.edge(pin, !closed);
    }

    /// What an output shows; `rest` if it was never driven.
    fn level(&self, pin: Pin, rest: Level) -> Level {
        self.out.level(pin).unwrap_or(rest)
    }

    /// Whether ALARM shows one.
    fn alarm(&self) -> bool {
        self.level(ALARM, Level::High) == Level::Low
    }

    /// RPM_DATA.
    fn rpm(&self) -> i64 {
        self.get(Pid::RPM_DATA)
    }
}
