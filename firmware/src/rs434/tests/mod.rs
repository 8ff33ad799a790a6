//! Scripts with times: what the manual says happens, and when.

mod bus;
mod errors;
mod inputs;
mod motion;
mod program;
mod saved;
mod startup;

use std::vec;
use std::vec::Vec;

use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;

use super::{CLR_FLASH, GREEN, HARD_STOP, IN1, IN2, MEMORY, RED, Reg, Rs434, SETTINGS, rs434544, rs434546};
use crate::device::{
    Axis, Boot, Device, DropReason, Duration, Input, Instant, Level, LogEvent, Output, Pin, Port, PresetError,
};
use crate::motor::DriveWithMotor;
use crate::testing::{Fixture, Treatment};

/// A character of 115,200 8E1: 11 bits, 1,527.8 ticks.
const CHARACTER: Duration = Duration::from_ticks(1_528);

/// A new drive with its motor, without power.
fn without_power() -> Fixture<DriveWithMotor<Rs434>> {
    Fixture::new(rs434544()).ruled(|output| match output {
        Output::Bytes { .. }
        | Output::Level { .. }
        | Output::Line { .. }
        | Output::Log(_)
        | Output::Store { .. } => Treatment::Keep,
        _ => Treatment::Refuse,
    })
}

/// A new drive that gets power at 0.
fn booting() -> Fixture<DriveWithMotor<Rs434>> {
    without_power().booting()
}

/// A new drive that is ready at 0.
fn ready() -> Fixture<DriveWithMotor<Rs434>> {
    without_power().ready()
}

/// A drive that is ready at 0 with these values saved before.
fn saved(values: &[(Reg, i64)]) -> Fixture<DriveWithMotor<Rs434>> {
    let mut dut = without_power();
    for (reg, value) in values {
        dut.set(*reg, *value);
    }
    dut.ready()
}

impl Fixture<DriveWithMotor<Rs434>> {
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

    /// A PDU to address 1, and that of the reply; empty if there is none.
    fn pdu(&mut self, pdu: &[u8]) -> Vec<u8> {
        let reply = self.ask(&rtu::frame(1, pdu));
        rtu::verify_crc(&reply).map_or(Vec::new(), |body| body[1..].to_vec())
    }

    /// Function 3 of one register.
    fn read(&mut self, address: u16) -> u16 {
        let [high, low] = address.to_be_bytes();
        match self.pdu(&[3, high, low, 0, 1])[..] {
            [3, 2, high, low] => u16::from_be_bytes([high, low]),
            ref other => panic!("{address:04X}h: {other:02X?}"),
        }
    }

    /// Function 6, which is accepted.
    fn write(&mut self, address: u16, value: u16) {
        assert_eq!(self.try_write(address, value)[0], 6, "{address:04X}h = {value}");
    }

    /// Function 6, and its reply.
    fn try_write(&mut self, address: u16, value: u16) -> Vec<u8> {
        self.pdu(&[&[6][..], &address.to_be_bytes(), &value.to_be_bytes()].concat())
    }

    /// Function 16, and its reply.
    fn try_write_all(&mut self, first: u16, words: &[u16]) -> Vec<u8> {
        let count = words.len() as u16;
        let mut pdu = [&[16][..], &first.to_be_bytes(), &count.to_be_bytes(), &[2 * count as u8]].concat();
        pdu.extend(words.iter().flat_map(|word| word.to_be_bytes()));
        self.pdu(&pdu)
    }

    /// Function 5 with 1, which is accepted.
    fn coil(&mut self, address: u16) {
        let pdu = [&[5][..], &address.to_be_bytes(), &[0xFF, 0]].concat();
        assert_eq!(self.pdu(&pdu), pdu);
    }

    /// A contact closes or opens, now.
    fn contact(&mut self, pin: Pin, closed: bool) {
        self.edge(pin, !closed);
    }

    /// A contact is closed for the first time and then open for the second.
    fn pulse(&mut self, pin: Pin, closed: Duration, open: Duration) {
        self.contact(pin, true);
        self.wait(closed);
        self.contact(pin, false);
        self.wait(open);
    }

    /// Whether a light is on.
    fn light(&self, pin: Pin) -> bool {
        self.out.level(pin) == Some(Level::High)
    }
}
