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
use drivetwin_protocol::registers::Register;
use drivetwin_protocol::time::Span;

use super::{CLR_FLASH, GREEN, HARD_STOP, IN1, IN2, MEMORY, RED, Reg, Rs434, SETTINGS, rs434544, rs434546};
use crate::device::{
    Axis, Boot, Device, Duration, Fault, Input, Instant, Level, Line, Note, Output, Pin, Port, Refused, Sink,
    Why, advance,
};
use crate::motor::Rig;

/// A character of 115,200 8E1: 11 bits, 1,527.8 ticks.
const CHARACTER: Duration = Duration::from_ticks(1_528);

/// What a drive did.
#[derive(Default)]
struct World {
    memory: Vec<u8>,
    /// Frames with the instant at which they leave.
    sent: Vec<(Instant, Vec<u8>)>,
    levels: Vec<(Instant, Pin, Level)>,
    lines: Vec<(Instant, Line)>,
    notes: Vec<Note>,
    stores: Vec<(Instant, u16, usize)>,
}

impl Sink for World {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        match output {
            Output::Bytes { bytes, .. } => self.sent.push((at, bytes.to_vec())),
            Output::Level { pin, level } => self.levels.push((at, pin, level)),
            Output::Line { line, .. } => self.lines.push((at, line)),
            Output::Note(note) => self.notes.push(note),
            Output::Store { offset, bytes } => {
                let offset = usize::from(offset);
                self.stores.push((at, offset as u16, bytes.len()));
                self.memory[offset..offset + bytes.len()].copy_from_slice(bytes);
            }
            other => panic!("an RS 434544 does not {other:?}"),
        }
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// A drive with its motor, its world, and what time it is.
struct Bed {
    drive: Rig<Rs434>,
    world: World,
    now: Instant,
}

impl Bed {
    /// A drive without power, with this memory.
    fn off(memory: Vec<u8>) -> Self {
        let world = World { memory, ..World::default() };
        Self { drive: rs434544(), world, now: Instant::ZERO }
    }

    fn new() -> Self {
        Self::off(vec![0xFF; MEMORY])
    }

    /// A new drive that gets power at 0.
    fn booting() -> Self {
        let mut bed = Self::new();
        bed.power_on(Boot::default());
        bed
    }

    /// A new drive that is ready at 0.
    fn ready() -> Self {
        let mut bed = Self::new();
        bed.power_on(Boot { fast: true, ..Boot::default() });
        bed.run_until(Instant::ZERO);
        bed
    }

    /// A drive that is ready at 0 with these values saved before.
    fn saved(values: &[(Reg, i64)]) -> Self {
        let mut bed = Self::new();
        for (reg, value) in values {
            bed.set(*reg, *value);
        }
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

    fn wait(&mut self, span: Duration) {
        self.run_until(self.now + span);
    }

    fn input(&mut self, at: Instant, input: Input<'_>) {
        self.now = at;
        advance(&mut self.drive, at, core::iter::once((at, input)), &mut self.world);
    }

    /// A frame from now on, ended by the line, and the reply that leaves for it; time goes on to its end.
    fn ask(&mut self, frame: &[u8]) -> Vec<u8> {
        let before = self.world.sent.len();
        let first = self.now + CHARACTER;
        self.input(first, Input::Bytes { port: Port(0), bytes: frame });
        self.input(first + CHARACTER * (frame.len() as u64 - 1), Input::Idle { port: Port(0) });
        let Some((at, reply)) = self.world.sent.get(before).cloned() else { return Vec::new() };
        self.run_until(at + CHARACTER * reply.len() as u64);
        reply
    }

    /// A PDU to address 1, and that of the reply; empty if there is none.
    fn pdu(&mut self, pdu: &[u8]) -> Vec<u8> {
        let reply = self.ask(&rtu::frame(1, pdu));
        rtu::checked(&reply).map_or(Vec::new(), |body| body[1..].to_vec())
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

    /// Presets a register, past the bus, now.
    fn set(&mut self, reg: Reg, value: i64) {
        assert_eq!(self.try_set(reg, value), Ok(()), "{reg:?} = {value}");
    }

    fn try_set(&mut self, reg: Reg, value: i64) -> Result<(), Refused> {
        self.drive.poke(self.now, reg.row(), value, &mut self.world)
    }

    fn get(&self, reg: Reg) -> i64 {
        self.drive.peek(self.now, reg.row())
    }

    /// A contact closes or opens, now.
    fn contact(&mut self, pin: Pin, closed: bool) {
        self.input(self.now, Input::Edge { pin, high: !closed });
    }

    /// A contact is closed for the first time and then open for the second.
    fn pulse(&mut self, pin: Pin, closed: Duration, open: Duration) {
        self.contact(pin, true);
        self.wait(closed);
        self.contact(pin, false);
        self.wait(open);
    }

    fn fault(&mut self, name: &str, on: bool) {
        let place = self.drive.spec().faults.iter().position(|known| *known == name).unwrap();
        self.input(self.now, Input::Fault { fault: Fault(place as u8), on });
    }

    /// Whether a light is on.
    fn light(&self, pin: Pin) -> bool {
        self.world
            .levels
            .iter()
            .rfind(|(_, other, _)| *other == pin)
            .is_some_and(|level| level.2 == Level::High)
    }

    /// Power goes, and comes again 1 s later.
    fn cycle(&mut self) {
        let Self { world, now, .. } = self;
        *self = Self { now: *now + 1.secs(), ..Self::off(core::mem::take(&mut world.memory)) };
        self.power_on(Boot { fast: true, ..Boot::default() });
        self.run_until(self.now);
    }
}
