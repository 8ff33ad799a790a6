//! Scripts with times: what the manual and the decisions say happens, and when.

mod alarms;
mod bus;
mod commands;
mod limits;
mod saved;
mod startup;

use std::vec;
use std::vec::Vec;

use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::registers::Register;
use drivetwin_protocol::time::Span;

use super::{ALARM, CLUTCH, FAN, HU, HV, HW, MEMORY, Mdrobot, Pid, mdrobot};
use crate::device::{
    Boot, Device, Duration, Fault, Input, Instant, Level, Line, Note, Output, Pin, Port, Refused, Sink, Why,
    advance,
};
use crate::motor::Rig;

/// A character of 19,200 8N1: 10 bits, 8,333.3 ticks.
const CHARACTER: Duration = Duration::from_ticks(8_333);

/// What it speaks on.
const fn line(baud: u32) -> Line {
    Line::new(baud, 8, Parity::None, 1)
}

/// What a drive did.
#[derive(Default)]
struct World {
    memory: Vec<u8>,
    /// Frames with the instant at which they leave.
    sent: Vec<(Instant, Vec<u8>)>,
    /// Not those of the motor's sensors.
    levels: Vec<(Instant, Pin, Level)>,
    lines: Vec<(Instant, Line)>,
    notes: Vec<Note>,
    stores: Vec<(Instant, u16, usize)>,
}

impl Sink for World {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        match output {
            Output::Bytes { bytes, .. } => self.sent.push((at, bytes.to_vec())),
            Output::Level { pin: HU | HV | HW, .. } => {}
            Output::Level { pin, level } => self.levels.push((at, pin, level)),
            Output::Line { line, .. } => self.lines.push((at, line)),
            Output::Note(note) => self.notes.push(note),
            // For a motor elsewhere.
            Output::Duty { .. } | Output::Current { .. } => {}
            Output::Store { offset, bytes } => {
                let offset = usize::from(offset);
                self.stores.push((at, offset as u16, bytes.len()));
                self.memory[offset..offset + bytes.len()].copy_from_slice(bytes);
            }
            other => panic!("an MDROBOT does not {other:?}"),
        }
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}

/// A drive with its motor, its world, and what time it is.
struct Bed {
    drive: Rig<Mdrobot>,
    world: World,
    now: Instant,
    /// The id that it is spoken to by.
    id: u8,
}

impl Bed {
    /// A drive without power, with this memory.
    fn off(memory: Vec<u8>) -> Self {
        Self { drive: mdrobot(), world: World { memory, ..World::default() }, now: Instant::ZERO, id: 1 }
    }

    fn new() -> Self {
        Self::off(vec![0xFF; MEMORY])
    }

    /// A new drive that gets power at 0.
    fn booting() -> Self {
        let mut bed = Self::new();
        bed.drive.power_on(bed.now, Boot::default(), &mut bed.world);
        bed
    }

    /// A new drive that is ready at 0.
    fn ready() -> Self {
        let mut bed = Self::new();
        bed.power_on();
        bed
    }

    /// A new drive that the bus may move, ready at 0.
    fn armed() -> Self {
        let mut bed = Self::ready();
        bed.write(78, 1);
        bed.write(100, 1);
        bed
    }

    /// Power comes, and the drive is ready at once.
    fn power_on(&mut self) {
        self.drive.power_on(self.now, Boot { fast: true, ..Boot::default() }, &mut self.world);
        self.run_until(self.now);
    }

    /// Power goes, and comes again 1 s later.
    fn cycle(&mut self) {
        let Self { world, now, id, .. } = self;
        let memory = core::mem::take(&mut world.memory);
        *self = Self { now: *now + 1.secs(), id: *id, ..Self::off(memory) };
        self.power_on();
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

    /// A PDU to the drive, and that of the reply; empty if there is none.
    fn pdu(&mut self, pdu: &[u8]) -> Vec<u8> {
        let reply = self.ask(&rtu::frame(self.id, pdu));
        rtu::checked(&reply).map_or(Vec::new(), |body| body[1..].to_vec())
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

    /// Presets a register, past the bus, now.
    fn set(&mut self, pid: Pid, value: i64) {
        assert_eq!(self.try_set(pid, value), Ok(()), "{pid:?} = {value}");
    }

    fn try_set(&mut self, pid: Pid, value: i64) -> Result<(), Refused> {
        self.drive.poke(self.now, pid.row(), value, &mut self.world)
    }

    fn get(&self, pid: Pid) -> i64 {
        self.drive.peek(self.now, pid.row())
    }

    /// A contact is closed to ground, or opened, now.
    fn contact(&mut self, pin: Pin, closed: bool) {
        self.input(self.now, Input::Edge { pin, high: !closed });
    }

    fn fault(&mut self, name: &str, on: bool) {
        let place = self.drive.spec().faults.iter().position(|known| *known == name).unwrap();
        self.input(self.now, Input::Fault { fault: Fault(place as u8), on });
    }

    /// What an output shows; `rest` if it was never driven.
    fn level(&self, pin: Pin, rest: Level) -> Level {
        self.world.levels.iter().rfind(|(_, other, _)| *other == pin).map_or(rest, |level| level.2)
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
