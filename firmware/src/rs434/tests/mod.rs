//! Tests of the whole drive over time: the behaviour that the manual specifies, and its times.

mod bus;
mod errors;
mod inputs;
mod motion;
mod program;
mod reasons;
mod saved;
mod startup;

use std::vec;
use std::vec::Vec;

use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span;

use super::{CLR_FLASH, GREEN, HARD_STOP, IN1, IN2, MEMORY, RED, Reg, Rs434, SETTINGS};
use crate::device::{
    Axis, Boot, Device, DropReason, Duration, Input, Instant, Level, LogEvent, Output, Pin, Port, PresetError,
};
use crate::motor::DriveWithMotor;
use crate::testing::{Fixture, Treatment};

/// Duration of a character at 115,200 8E1: 11 bits, 1,527.8 ticks.
const CHARACTER: Duration = Duration::from_ticks(1_528);

/// A new drive with its motor, without power.
fn without_power() -> Fixture<DriveWithMotor<Rs434>> {
    Fixture::new(Rs434::rs434544()).ruled(|output| match output {
        Output::Bytes { .. }
        | Output::Level { .. }
        | Output::Line { .. }
        | Output::Log(_)
        | Output::Store { .. } => Treatment::Keep,
        _ => Treatment::Refuse,
    })
}

/// A new drive, powered on at time 0.
fn booting() -> Fixture<DriveWithMotor<Rs434>> {
    without_power().booting()
}

/// A new drive that is ready at time 0.
fn ready() -> Fixture<DriveWithMotor<Rs434>> {
    without_power().ready()
}

/// A drive that is ready at time 0 and had these values saved before.
fn saved(values: &[(Reg, i64)]) -> Fixture<DriveWithMotor<Rs434>> {
    let mut dut = without_power();
    for (reg, value) in values {
        dut.set(*reg, *value);
    }
    dut.ready()
}

impl Fixture<DriveWithMotor<Rs434>> {
    /// Sends a frame, ends it by an idle line, and returns the reply. Time advances to the end of the reply.
    fn ask(&mut self, frame: &[u8]) -> Vec<u8> {
        let before = self.out.bytes.len();
        let first = self.now + CHARACTER;
        self.input(first, Input::Bytes { port: Port(0), bytes: frame });
        self.input(first + CHARACTER * (frame.len() as u64 - 1), Input::Idle { port: Port(0) });
        let Some((at, _, reply)) = self.out.bytes.get(before).cloned() else { return Vec::new() };
        self.run_until(at + CHARACTER * reply.len() as u64);
        reply
    }

    /// Sends a PDU to address 1. Returns the PDU of the reply; empty if there is no reply.
    fn pdu(&mut self, pdu: &[u8]) -> Vec<u8> {
        let reply = self.ask(&rtu::frame(1, pdu));
        rtu::verify_crc(&reply).map_or(Vec::new(), |body| body[1..].to_vec())
    }

    /// Reads one register with function 3.
    fn read(&mut self, address: u16) -> u16 {
        let [high, low] = address.to_be_bytes();
        match self.pdu(&[3, high, low, 0, 1])[..] {
            [3, 2, high, low] => u16::from_be_bytes([high, low]),
            ref other => panic!("{address:04X}h: {other:02X?}"),
        }
    }

    /// Writes one register with function 6, which must succeed.
    fn write(&mut self, address: u16, value: u16) {
        assert_eq!(self.try_write(address, value)[0], 6, "{address:04X}h = {value}");
    }

    /// Writes one register with function 6. Returns the reply.
    fn try_write(&mut self, address: u16, value: u16) -> Vec<u8> {
        self.pdu(&[&[6][..], &address.to_be_bytes(), &value.to_be_bytes()].concat())
    }

    /// Writes registers with function 16. Returns the reply.
    fn try_write_all(&mut self, first: u16, words: &[u16]) -> Vec<u8> {
        let count = words.len() as u16;
        let mut pdu = [&[16][..], &first.to_be_bytes(), &count.to_be_bytes(), &[2 * count as u8]].concat();
        pdu.extend(words.iter().flat_map(|word| word.to_be_bytes()));
        self.pdu(&pdu)
    }

    /// Sets a coil to 1 with function 5, which must succeed.
    fn coil(&mut self, address: u16) {
        let pdu = [&[5][..], &address.to_be_bytes(), &[0xFF, 0]].concat();
        assert_eq!(self.pdu(&pdu), pdu);
    }

    /// Closes or opens a contact, now.
    fn contact(&mut self, pin: Pin, closed: bool) {
        self.edge(pin, !closed);
    }

    /// Closes a contact for the time `closed`, and then opens it for the time `open`.
    fn pulse(&mut self, pin: Pin, closed: Duration, open: Duration) {
        self.contact(pin, true);
        self.wait(closed);
        self.contact(pin, false);
        self.wait(open);
    }

    /// Returns true if a light is on.
    fn light(&self, pin: Pin) -> bool {
        self.out.level(pin) == Some(Level::High)
    }
}
