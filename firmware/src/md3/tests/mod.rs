//! Tests that run a drive in virtual time and compare its behaviour and its times with the guide.

mod bus;
mod dc;
mod eeprom;
mod homing;
mod inputs;
mod motion;
mod power;
mod reasons;
mod startup;

use std::vec;
use std::vec::Vec;

use drivetwin_protocol::modbus::{Frame, rtu};
use drivetwin_protocol::registers::Register;
use drivetwin_protocol::time::Span;
use fixed::types::I48F16;

use super::{BUSY, DIR, GREEN, HIGH_CURRENT, J2_9, J2_10, J2_12, J3_8, MEMORY, Md3, PINS, RED, Reg, STEP};
use crate::device::{
    Axis, Boot, Device, DropReason, Duration, Fault, Input, Instant, Level, Line, LogEvent, Output, Pin,
    Port, PresetError,
};
use crate::testing::{Fixture, Treatment};

/// Duration of a character of 9600 8E1: 11 bits, 18,333⅓ ticks.
const CHARACTER: Duration = Duration::from_ticks(18_333);
/// Time from the end of a request to its reply: 3.5 characters (64,165.5 ticks, rounded up), and one more
/// character in which no other sender started.
const JUDGEMENT: Duration = Duration::from_ticks(64_166 + 18_333);

const AXIS: Axis = Axis(0);

/// A drive without power, with this content of its memory.
fn off(memory: Vec<u8>) -> Fixture<Md3> {
    of(Md3::new(), memory)
}

/// This drive, with this content of its memory.
fn of(drive: Md3, memory: Vec<u8>) -> Fixture<Md3> {
    Fixture::with_memory(drive, memory).ruled(|output| match output {
        Output::Bytes { .. }
        | Output::Level { .. }
        | Output::Wave { .. }
        | Output::Line { .. }
        | Output::Log(_)
        | Output::CurrentLimit { .. }
        | Output::Duty { .. }
        | Output::Plan { .. }
        | Output::Step { .. }
        | Output::Store { .. } => Treatment::Keep,
        _ => Treatment::Refuse,
    })
}

/// A new drive that is powered on at 0.
fn booting() -> Fixture<Md3> {
    off(vec![0xFF; MEMORY]).booting()
}

/// A new drive that is ready at 0.
fn ready() -> Fixture<Md3> {
    off(vec![0xFF; MEMORY]).ready()
}

impl Fixture<Md3> {
    /// Sends a frame to the drive from now on; returns the end of its last character.
    fn hear(&mut self, frame: &[u8]) -> Instant {
        let first = self.now + CHARACTER;
        self.input(first, Input::Bytes { port: Port(0), bytes: frame });
        first + CHARACTER * (frame.len() as u64 - 1)
    }

    /// Sends a frame and returns the drive's reply; advances the time to the end of the reply.
    fn ask(&mut self, frame: &[u8]) -> Frame {
        let before = self.out.bytes.len();
        let end = self.hear(frame);
        self.run_until(end + JUDGEMENT);
        let reply = self.sent().get(before).map(|(_, reply)| reply.clone()).unwrap_or_default();
        self.now += CHARACTER * reply.len() as u64;
        self.run_until(self.now);
        reply
    }

    fn read(&mut self, address: u16) -> u16 {
        let reply = self.ask(&rtu::read(1, address, 1));
        assert_eq!((reply.len(), &reply[..3]), (7, &[1, 3, 2][..]));
        u16::from_be_bytes([reply[3], reply[4]])
    }

    fn write(&mut self, address: u16, value: u16) {
        let frame = rtu::write(1, address, value);
        assert_eq!(self.ask(&frame), frame);
    }

    /// Presets a register now, with the same effect as a write over the bus.
    fn preset(&mut self, reg: Reg, value: i64) {
        self.run_until(self.now);
        self.set(reg, value);
        self.run_until(self.now);
    }

    /// Present value of `MotionControl`.
    fn control(&self) -> i64 {
        self.get(Reg::MotionControl)
    }

    /// Sets the level of pin `number` of J2.
    fn pin(&mut self, number: u8, high: bool) {
        let names = [2, 3, 4, 5, 9, 10, 12];
        let place = names.iter().position(|name| *name == number).unwrap() as u8;
        self.edge(Pin(place), high);
    }

    /// Frames that the drive has sent, with their times.
    fn sent(&self) -> Vec<(Instant, Frame)> {
        let sent = self.out.bytes.iter();
        sent.map(|(at, _, bytes)| (*at, Frame::from_slice(bytes).unwrap())).collect()
    }

    fn position(&self) -> i32 {
        self.out.plan().position_at(self.now) + self.out.steps_since_plan()
    }

    fn speed(&self) -> I48F16 {
        self.out.plan().speed_at(self.now)
    }

    /// Present peak current in mA.
    fn current(&self) -> u32 {
        self.out.currents.last().unwrap().2
    }

    /// Present duty in 1/65536.
    fn duty(&self) -> i32 {
        self.out.duties.last().unwrap().2
    }

    fn busy(&self) -> bool {
        self.level("J3.7") == Level::Low
    }

    fn level(&self, pin: &str) -> Level {
        let place = self.drive.spec().pins.iter().position(|spec| spec.name == pin).unwrap();
        self.out.level(Pin(place as u8)).unwrap()
    }
}

const MOVE: i64 = 0x01;
const JOG: i64 = 0x02;
const HOME: i64 = 0x04;
const STOP: i64 = 0x08;
const DECEL_STOP: i64 = 0x10;
const DISABLE: i64 = 0x20;
const FAULT: i64 = 0x8000;

fn exception(function: u8, code: u8) -> Frame {
    rtu::frame(1, &[function | 0x80, code])
}
