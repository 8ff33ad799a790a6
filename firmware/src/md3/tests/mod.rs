//! Scripts with times: what the guide says happens, and when.

mod bus;
mod dc;
mod eeprom;
mod homing;
mod inputs;
mod motion;
mod power;
mod startup;

use std::vec;
use std::vec::Vec;

use drivetwin_protocol::modbus::{Frame, rtu};
use drivetwin_protocol::registers::Register;
use drivetwin_protocol::time::Span;
use fixed::types::I48F16;

use super::{BUSY, DIR, GREEN, HIGH_CURRENT, J2_9, J2_10, J2_12, J3_8, MEMORY, Md3, PINS, RED, Reg, STEP};
use crate::device::{
    Boot, Device, Duration, Fault, Input, Instant, Level, Line, Note, Output, Pin, Plan, Port, Refused, Sink,
    Why, advance,
};

/// A character of 9600 8E1: 11 bits, 18,333⅓ ticks.
const CHARACTER: Duration = Duration::from_ticks(18_333);
/// From the end of a request to its reply: 3.5 characters (64,165.5 ticks, rounded up), and the one
/// in which nobody began to speak.
const JUDGEMENT: Duration = Duration::from_ticks(64_166 + 18_333);

/// What a drive did.
#[derive(Default)]
struct World {
    memory: Vec<u8>,
    /// Frames with the instant at which they leave.
    sent: Vec<(Instant, Frame)>,
    levels: Vec<(Instant, Pin, Level)>,
    waves: Vec<(Instant, Pin, Duration, Duration)>,
    lines: Vec<(Instant, Line)>,
    notes: Vec<Note>,
    stores: Vec<(Instant, u16, Vec<u8>)>,
    current: Vec<(Instant, u32)>,
    duty: Vec<(Instant, i32)>,
    plan: Option<Plan>,
    /// Steps made beside the plan.
    steps: Vec<(Instant, i32)>,
}

impl Sink for World {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        match output {
            Output::Bytes { bytes, .. } => self.sent.push((at, Frame::from_slice(bytes).unwrap())),
            Output::Level { pin, level } => self.levels.push((at, pin, level)),
            Output::Wave { pin, period, high } => self.waves.push((at, pin, period, high)),
            Output::Line { line, .. } => self.lines.push((at, line)),
            Output::Note(note) => self.notes.push(note),
            Output::Current { ma, .. } => self.current.push((at, ma)),
            Output::Duty { duty, .. } => self.duty.push((at, duty)),
            Output::Plan { plan, .. } => {
                self.plan = Some(*plan);
                self.steps.clear();
            }
            Output::Step { steps, .. } => self.steps.push((at, steps)),
            Output::Store { offset, bytes } => {
                self.stores.push((at, offset, bytes.to_vec()));
                let offset = usize::from(offset);
                self.memory[offset..offset + bytes.len()].copy_from_slice(bytes);
            }
            other => panic!("an MD3 does not {other:?}"),
        }
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// A drive, its world, and what time it is.
struct Bed {
    drive: Md3,
    world: World,
    now: Instant,
}

impl Bed {
    /// A drive without power, with this memory.
    fn off(memory: Vec<u8>) -> Self {
        let world = World { memory, ..World::default() };
        Self { drive: Md3::new(), world, now: Instant::ZERO }
    }

    /// A new drive that gets power at 0.
    fn booting() -> Self {
        let mut bed = Self::off(vec![0xFF; MEMORY]);
        bed.power_on(Boot::default());
        bed
    }

    /// A new drive that is ready at 0.
    fn ready() -> Self {
        let mut bed = Self::off(vec![0xFF; MEMORY]);
        bed.power_on(Boot { fast: true, ..Boot::default() });
        bed.run_until(Instant::ZERO);
        bed
    }

    fn power_on(&mut self, boot: Boot) {
        self.drive.power_on(self.now, boot, &mut self.world);
    }

    fn run_until(&mut self, at: impl Into<Instant>) {
        self.now = at.into();
        advance(&mut self.drive, self.now, core::iter::empty(), &mut self.world);
    }

    fn input(&mut self, at: Instant, input: Input<'_>) {
        self.now = at;
        advance(&mut self.drive, at, core::iter::once((at, input)), &mut self.world);
    }

    /// Puts a frame on the line from now on; returns the end of its last character.
    fn hear(&mut self, frame: &[u8]) -> Instant {
        let first = self.now + CHARACTER;
        self.input(first, Input::Bytes { port: Port(0), bytes: frame });
        first + CHARACTER * (frame.len() as u64 - 1)
    }

    /// A frame, and the reply that leaves for it; time goes on to the end of the reply.
    fn ask(&mut self, frame: &[u8]) -> Frame {
        let before = self.world.sent.len();
        let end = self.hear(frame);
        self.run_until(end + JUDGEMENT);
        let reply = self.world.sent.get(before).map(|(_, reply)| reply.clone()).unwrap_or_default();
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

    /// Presets a register, which acts as a write over the bus does, now.
    fn set(&mut self, reg: Reg, value: i64) {
        self.run_until(self.now);
        assert_eq!(self.drive.poke(self.now, reg.row(), value, &mut self.world), Ok(()));
        self.run_until(self.now);
    }

    fn get(&self, reg: Reg) -> i64 {
        self.drive.peek(self.now, reg.row())
    }

    /// MotionControl as it reads.
    fn control(&self) -> i64 {
        self.get(Reg::MotionControl)
    }

    fn wait(&mut self, span: Duration) {
        self.run_until(self.now + span);
    }

    /// A pin of J2 changes, by its number.
    fn pin(&mut self, number: u8, high: bool) {
        let names = [2, 3, 4, 5, 9, 10, 12];
        let place = names.iter().position(|name| *name == number).unwrap() as u8;
        self.input(self.now, Input::Edge { pin: Pin(place), high });
    }

    fn position(&self) -> i32 {
        let beside: i32 = self.world.steps.iter().map(|(_, steps)| steps).sum();
        self.world.plan.unwrap().position_at(self.now) + beside
    }

    fn speed(&self) -> I48F16 {
        self.world.plan.unwrap().speed_at(self.now)
    }

    /// Peak current in mA, now.
    fn current(&self) -> u32 {
        self.world.current.last().unwrap().1
    }

    fn busy(&self) -> bool {
        self.level("J3.7") == Level::Low
    }

    fn level(&self, pin: &str) -> Level {
        let place = self.drive.spec().pins.iter().position(|spec| spec.name == pin).unwrap();
        self.world.levels.iter().rfind(|(_, pin, _)| usize::from(pin.0) == place).unwrap().2
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
