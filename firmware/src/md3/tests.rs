//! Scripts with times: what the guide says happens, and when.

use std::vec;
use std::vec::Vec;

use standin_protocol::modbus::{Frame, rtu};
use standin_protocol::registers::Register;
use standin_protocol::time::Span;

use super::{Md3, Reg};
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
    plan: Option<Plan>,
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
            Output::Plan { plan, .. } => self.plan = Some(*plan),
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
        let mut bed = Self::off(vec![0xFF; super::MEMORY]);
        bed.power_on(Boot::default());
        bed
    }

    /// A new drive that is ready at 0.
    fn ready() -> Self {
        let mut bed = Self::off(vec![0xFF; super::MEMORY]);
        bed.power_on(Boot { fast: true, ..Boot::default() });
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

    fn position(&self) -> i32 {
        self.world.plan.unwrap().position_at(self.now)
    }

    fn level(&self, pin: &str) -> Level {
        let place = self.drive.spec().pins.iter().position(|spec| spec.name == pin).unwrap();
        self.world.levels.iter().rfind(|(_, pin, _)| usize::from(pin.0) == place).unwrap().2
    }
}

fn exception(function: u8, code: u8) -> Frame {
    rtu::frame(1, &[function | 0x80, code])
}

#[test]
fn a_reply_leaves_when_nobody_began_to_speak_for_3_5_characters() {
    let mut bed = Bed::ready();
    let end = bed.hear(&rtu::read(1, 0x00, 1));
    bed.run_until(end + JUDGEMENT - Duration::TICK);
    assert!(bed.world.sent.is_empty());
    bed.run_until(end + JUDGEMENT);
    assert_eq!(bed.world.sent, [(bed.now, rtu::frame(1, &[3, 2, 0, 1]))]);
}

#[test]
fn a_gap_of_1_5_characters_is_legal_and_a_tick_more_is_not() {
    // 1.5 · 18,333 = 27,499.5 ticks, rounded up.
    let longest = Duration::from_ticks(27_500);
    for (gap, answered) in [(longest, true), (longest + Duration::TICK, false)] {
        let mut bed = Bed::ready();
        let frame = rtu::read(1, 0x00, 1);
        let half = bed.hear(&frame[..4]);
        bed.now = half + gap;
        let end = bed.hear(&frame[4..]);
        bed.run_until(end + JUDGEMENT);
        assert_eq!(bed.world.sent.len(), usize::from(answered));
        if !answered {
            assert_eq!(bed.world.notes, [Note::Dropped { port: Port(0), why: Why::Gap }]);
        }
        assert_eq!(bed.read(0x00), 1, "the next good frame is answered");
    }
}

#[test]
fn frames_are_3_5_characters_apart_and_a_tick_less_spoils_both() {
    let apart = Duration::from_ticks(64_166);
    for (gap, answers) in [(apart, 2), (apart - Duration::TICK, 0)] {
        let mut bed = Bed::ready();
        let frame = rtu::read(1, 0x00, 1);
        bed.now = bed.hear(&frame) + gap;
        let end = bed.hear(&frame);
        bed.run_until(end + JUDGEMENT);
        assert_eq!(bed.world.sent.len(), answers);
    }
}

#[test]
fn above_19200_baud_the_silences_are_fixed() {
    let mut bed = Bed::ready();
    bed.write(0x1c, 0x0025); // 115200 8E1
    bed.world.sent.clear();
    let first = bed.now + 1.millis();
    let frame = rtu::read(1, 0x1c, 1);
    bed.input(first, Input::Bytes { port: Port(0), bytes: &frame });
    // 11 bits at 115,200 are 1,528 ticks; t3.5 is 1.75 ms.
    let reply = first + Duration::from_ticks(7 * 1_528) + 1_750.micros() + Duration::from_ticks(1_528);
    bed.run_until(reply - Duration::TICK);
    assert!(bed.world.sent.is_empty());
    bed.run_until(reply);
    assert_eq!(bed.world.sent, [(reply, rtu::frame(1, &[3, 2, 0x00, 0x25]))]);
}

#[test]
fn what_is_no_frame_for_it_is_met_with_silence() {
    let mut bed = Bed::ready();
    let mut wrong = rtu::write(1, 0x1d, 7);
    wrong[6] ^= 1;
    assert!(bed.ask(&wrong).is_empty());
    assert!(bed.ask(&rtu::write(2, 0x1d, 7)).is_empty());
    assert!(bed.ask(&[1]).is_empty());
    assert!(bed.ask(&rtu::frame(1, &[3, 0, 0, 0])).is_empty());
    assert!(bed.ask(&[0x55; 300]).is_empty());
    let end = bed.now + CHARACTER;
    bed.input(end, Input::Spoiled { port: Port(0) });
    bed.run_until(end + JUDGEMENT);
    let why: Vec<_> = bed
        .world
        .notes
        .iter()
        .map(|note| match note {
            Note::Dropped { why, .. } => *why,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(why, [Why::Crc, Why::Address, Why::Crc, Why::Length, Why::Length, Why::Spoiled]);
    assert_eq!(bed.read(0x1d), 0, "nothing was written");
}

#[test]
fn another_slaves_reply_is_not_for_it() {
    let mut bed = Bed::ready();
    // The reply of slave 1 to a read looks like a request to slave 1 of another length.
    assert!(bed.ask(&rtu::frame(1, &[3, 4, 0, 1, 0, 2])).is_empty());
    assert_eq!(bed.read(0x00), 1);
}

#[test]
fn functions_other_than_3_and_6_are_exception_1() {
    let mut bed = Bed::ready();
    for function in [1_u8, 2, 4, 5, 8, 15, 16, 23, 43, 0x7F] {
        let reply = bed.ask(&rtu::frame(1, &[function, 0, 0, 0, 1]));
        assert_eq!(reply, exception(function, 1));
    }
}

#[test]
fn addresses_and_values_it_does_not_have_are_exception_2() {
    let mut bed = Bed::ready();
    for (first, count) in [(0x00, 0), (0x00, 33), (0x1f, 2), (0x20, 1), (0xFFFF, 1), (0x00, 0xFFFF)] {
        assert_eq!(bed.ask(&rtu::read(1, first, count)), exception(3, 2));
    }
    for (address, value) in [
        (0x0b, 0),
        (0x1b, 0),
        (0x1e, 0),
        (0x1f, 0),
        (0x20, 0),
        (0xFFFF, 0), // 7.10, 7.21, 7.24, none
        (0x00, 0),
        (0x00, 248),
        (0x00, 0xFFFF), // 7.1
    ] {
        assert_eq!(bed.ask(&rtu::write(1, address, value)), exception(6, 2));
    }
    assert_eq!(bed.read(0x00), 1, "the address is still 1");
}

#[test]
fn a_broadcast_is_obeyed_and_not_answered() {
    let mut bed = Bed::ready();
    assert!(bed.ask(&rtu::write(0, 0x1d, 0x1234)).is_empty());
    assert!(bed.ask(&rtu::read(0, 0x1d, 1)).is_empty());
    assert!(bed.ask(&rtu::write(0, 0x40, 1)).is_empty());
    assert_eq!(bed.read(0x1d), 0x1234);
}

#[test]
fn a_new_address_holds_from_the_next_frame() {
    let mut bed = Bed::ready();
    bed.write(0x00, 7);
    assert!(bed.ask(&rtu::read(1, 0, 1)).is_empty());
    assert_eq!(bed.ask(&rtu::read(7, 0, 1)), rtu::frame(7, &[3, 2, 0, 7]));
}

#[test]
fn a_new_line_holds_after_the_reply_has_left_with_the_old_one() {
    let mut bed = Bed::ready();
    bed.world.lines.clear();
    bed.write(0x1c, 0x0000); // 4800 8N1
    let (left, reply) = bed.world.sent[0].clone();
    let line = Line::new(4_800, 8, standin_protocol::line::Parity::None, 1);
    assert_eq!(bed.world.lines, [(left + CHARACTER * reply.len() as u64, line)]);
}

#[test]
fn the_manuals_lines() {
    use standin_protocol::line::Parity::{Even, None, Odd};
    for (configuration, line) in [
        (0x21, Line::new(9_600, 8, Even, 1)),
        (0x00, Line::new(4_800, 8, None, 1)),
        (0x02, Line::new(19_200, 8, None, 1)),
        (0x13, Line::new(38_400, 8, Odd, 1)),
        (0x2c, Line::new(57_600, 8, Even, 2)),
        (0x05, Line::new(115_200, 8, None, 1)),
        (0x0e, Line::new(230_400, 8, None, 2)),
        (0x1f, Line::new(460_800, 8, Odd, 2)),
        (0x31, Line::new(9_600, 8, None, 1)),
    ] {
        assert_eq!(super::line(configuration), line);
    }
}

#[test]
fn it_is_deaf_for_two_and_a_half_seconds() {
    let mut bed = Bed::booting();
    bed.run_until(1.secs());
    assert!(bed.ask(&rtu::read(1, 0, 1)).is_empty());
    // The last character that is lost ends with the delay.
    bed.now = Instant::from(2_500.millis()) - CHARACTER;
    assert!(bed.ask(&rtu::read(1, 0, 1)).is_empty());
    let mut bed = Bed::booting();
    bed.now = Instant::from(2_500.millis()) - CHARACTER + Duration::TICK;
    assert_eq!(bed.ask(&rtu::read(1, 0, 1)), rtu::frame(1, &[3, 2, 0, 1]));
}

#[test]
fn a_startup_delay_of_250_makes_five_seconds() {
    let mut bed = Bed::ready();
    bed.write(0x03, 250); // 7.4
    bed.write(0x1a, 1);
    bed.run_until(bed.now + 20.millis());
    let mut bed = Bed::off(bed.world.memory);
    bed.power_on(Boot::default());
    bed.run_until(Instant::from(5.secs()) - Duration::TICK);
    assert_eq!(bed.world.current, [(Instant::ZERO, 0)]);
    bed.run_until(5.secs());
    assert_eq!(bed.world.current[1..], [(bed.now, 1_000)]);
}

const HALF: Duration = Duration::millis(500);
const FLASH: (Duration, Duration) = (HALF, Duration::millis(250));

#[test]
fn lights_of_a_drive_that_starts() {
    let mut bed = Bed::booting();
    bed.run_until(10.secs());
    let (red, green) = (super::RED, super::GREEN);
    let second = |n: u64| Instant::from(n.millis());
    let (turn, beat) = ((HALF * 2, HALF), (Duration::millis(1_500), Duration::millis(250)));
    assert_eq!(
        bed.world.waves,
        [
            (second(0), red, FLASH.0, FLASH.1),
            (second(0), green, FLASH.0, FLASH.1),
            (second(1_000), green, turn.0, turn.1),
            (second(1_500), red, turn.0, turn.1),
            (second(2_500), green, beat.0, beat.1),
        ]
    );
    let red: Vec<_> = bed.world.levels.iter().filter(|(_, pin, _)| *pin == red).collect();
    assert_eq!(red, [&(second(1_000), super::RED, Level::Low), &(second(2_500), super::RED, Level::Low)]);
}

#[test]
fn a_bad_eeprom_flashes_red_and_starts_with_the_defaults() {
    let garbage: Vec<u8> = (0..super::MEMORY).map(|n| n as u8).collect();
    let mut bed = Bed::off(garbage.clone());
    bed.power_on(Boot::default());
    // Ten flashes in five seconds, then the built-in delay.
    assert_eq!(bed.world.waves, [(Instant::ZERO, super::RED, FLASH.0, FLASH.1)]);
    bed.run_until(Instant::from(7_500.millis()) - Duration::TICK);
    assert_eq!(bed.world.current.len(), 1);
    bed.run_until(7_500.millis());
    assert_eq!(bed.world.current.len(), 2);
    assert_eq!(bed.read(0x1a), 0xf100);
    assert_eq!(bed.read(0x15), 0x1388);
    assert_eq!(bed.world.memory, garbage, "it stays as it is until a save");
    bed.write(0x1a, 1);
    bed.run_until(bed.now + 20.millis());
    let mut bed = Bed::off(bed.world.memory);
    bed.power_on(Boot { fast: true, ..Boot::default() });
    assert_eq!(bed.read(0x1a), 0x9a00);
}

#[test]
fn a_save_takes_20_ms_and_shows_it() {
    let mut bed = Bed::ready();
    bed.write(0x1d, 0xBEEF);
    let before = bed.world.memory.clone();
    let end = bed.hear(&rtu::write(1, 0x1a, 1));
    let begun = end + JUDGEMENT;
    bed.run_until(begun);
    assert_ne!(bed.world.memory, before);
    assert_eq!(bed.drive.peek(bed.now, Reg::EEPROMControl.row()), 0x9a01);
    bed.run_until(begun + 20.millis() - Duration::TICK);
    assert_eq!(bed.world.stores.len(), 1);
    bed.run_until(begun + 20.millis());
    assert_eq!(bed.world.stores.len(), 2);
    assert_eq!(bed.drive.peek(bed.now, Reg::EEPROMControl.row()), 0x0000);
}

#[test]
fn power_lost_anywhere_in_a_save_leaves_the_old_the_new_or_a_bad_memory() {
    let mut bed = Bed::ready();
    bed.write(0x1d, 0x1111);
    bed.write(0x1a, 1);
    bed.run_until(bed.now + 20.millis());
    let old = bed.world.memory.clone();
    bed.write(0x1d, 0x2222);
    bed.world.stores.clear();
    bed.write(0x1a, 1);
    bed.run_until(bed.now + 20.millis());
    let stores: Vec<_> = bed.world.stores.clone();
    let total: usize = stores.iter().map(|(_, _, bytes)| bytes.len()).sum();
    let mut seen = [0; 3];
    for cut in 0..=total {
        let mut memory = old.clone();
        let bytes = stores.iter().flat_map(|(_, offset, bytes)| {
            bytes.iter().enumerate().map(move |(n, byte)| (usize::from(*offset) + n, *byte))
        });
        for (place, byte) in bytes.take(cut) {
            memory[place] = byte;
        }
        let mut bed = Bed::off(memory);
        bed.power_on(Boot { fast: true, ..Boot::default() });
        match (bed.read(0x1a), bed.read(0x1d)) {
            (0x9a00, 0x1111) => seen[0] += 1,
            (0xf100, 0x0000) => seen[1] += 1,
            (0x9a00, 0x2222) => seen[2] += 1,
            other => panic!("{other:x?} after {cut} bytes"),
        }
    }
    // Until the first byte differs it is the old one, with the last it is the new one.
    assert!(seen[0] > 1 && seen[1] > 1 && seen[2] == 1, "{seen:?}");
}

#[test]
fn a_read_brings_the_saved_registers_back() {
    let mut bed = Bed::ready();
    bed.write(0x1d, 0x1111);
    bed.write(0x1a, 1);
    bed.run_until(bed.now + 20.millis());
    assert_eq!(bed.read(0x1a), 0x0000);
    bed.write(0x1d, 0x2222);
    bed.write(0x00, 9);
    let frame = rtu::write(9, 0x1a, 2);
    assert_eq!(bed.ask(&frame), frame, "the reply has the old address");
    assert_eq!(bed.read(0x1d), 0x1111);
    assert_eq!(bed.read(0x1a), 0x9a00);
    bed.world.memory[5] ^= 0xFF;
    bed.write(0x1d, 0x3333);
    bed.write(0x1a, 2);
    assert_eq!((bed.read(0x1a), bed.read(0x1d)), (0xf100, 0x3333));
}

#[test]
fn not_saved_are_counters_and_motion() {
    let mut bed = Bed::ready();
    for (address, value) in [(0x0e, 1), (0x0f, 2), (0x10, 3), (0x11, 0x21), (0x0a, 0x80), (0x0c, 0xFFFF)] {
        bed.write(address, value);
    }
    bed.write(0x1a, 1);
    bed.run_until(bed.now + 20.millis());
    let mut bed = Bed::off(bed.world.memory);
    bed.power_on(Boot { fast: true, ..Boot::default() });
    for (address, value) in [(0x0e, 0), (0x0f, 0), (0x10, 0), (0x11, 0x20), (0x0a, 0x8f), (0x0c, 0xFFFF)] {
        assert_eq!(bed.read(address), value, "register {address:#04x}");
    }
    assert_eq!(bed.level("J3.8"), Level::Low);
    assert_eq!(bed.world.current, [(Instant::ZERO, 0)], "still disabled");
}

#[test]
fn presets_before_power_are_as_if_saved() {
    let mut bed = Bed::off(vec![0xFF; super::MEMORY]);
    let mut poke = |reg: Reg, value| bed.drive.poke(Instant::ZERO, reg.row(), value, &mut bed.world);
    assert_eq!(poke(Reg::DeviceAddress, 12), Ok(()));
    assert_eq!(poke(Reg::SerialNumber, 123_456), Ok(()));
    assert_eq!(poke(Reg::DeviceAddress, 248), Err(Refused::OutOfRange));
    assert_eq!(poke(Reg::ProductInformation, 0), Err(Refused::ReadOnly));
    bed.power_on(Boot { fast: true, ..Boot::default() });
    let reply = bed.ask(&rtu::read(12, 0x1e, 2));
    assert_eq!(reply, rtu::frame(12, &[3, 4, 0x00, 0x01, 0xE2, 0x40]));
    let mut bed = Bed::off(vec![0; super::MEMORY]);
    let refused = bed.drive.poke(Instant::ZERO, Reg::DeviceAddress.row(), 12, &mut bed.world);
    assert_eq!(refused, Err(Refused::BadMemory));
}

#[test]
fn a_move_of_10_000_steps_takes_two_and_a_half_seconds() {
    let mut bed = Bed::ready();
    let begun = bed.hear(&rtu::write(1, 0x11, 1)) + JUDGEMENT;
    bed.run_until(begun);
    assert_eq!(bed.level("J3.7"), Level::Low);
    bed.run_until(begun + 500.millis());
    assert_eq!(bed.position(), 1_250);
    assert_eq!(bed.read(0x11), 1);
    bed.run_until(begun + 2_500.millis() - Duration::TICK);
    assert_eq!((bed.position(), bed.level("J3.7")), (9_999, Level::Low));
    bed.run_until(begun + 2_500.millis());
    assert_eq!((bed.position(), bed.level("J3.7")), (10_000, Level::Float));
    assert_eq!(bed.read(0x11), 0);
}

#[test]
fn a_negative_move_goes_back() {
    let mut bed = Bed::ready();
    bed.write(0x12, 0xFFFF);
    bed.write(0x13, 0xFF9C); // -100
    bed.write(0x11, 1);
    bed.run_until(bed.now + 1.secs());
    assert_eq!(bed.position(), -100);
}

#[test]
fn a_profile_ignores_speeds_and_other_moves() {
    let mut bed = Bed::ready();
    let begun = bed.hear(&rtu::write(1, 0x11, 1)) + JUDGEMENT;
    bed.run_until(begun + 1.secs());
    bed.write(0x15, 100);
    for command in [1, 2, 0] {
        bed.write(0x11, command);
        assert_eq!(bed.read(0x11), 1);
    }
    bed.run_until(begun + 2_500.millis() - Duration::TICK);
    assert_eq!((bed.position(), bed.level("J3.7")), (9_999, Level::Low));
    bed.run_until(begun + 2_500.millis());
    assert_eq!((bed.position(), bed.level("J3.7")), (10_000, Level::Float));
}

#[test]
fn a_new_acceleration_stops_a_profile_at_once() {
    let mut bed = Bed::ready();
    let begun = bed.hear(&rtu::write(1, 0x11, 1)) + JUDGEMENT;
    bed.run_until(begun + 1.secs());
    let written = bed.hear(&rtu::write(1, 0x19, 20_000)) + JUDGEMENT;
    bed.run_until(written - Duration::TICK);
    let position = bed.position();
    bed.run_until(10.secs());
    assert!(bed.position() - position <= 1);
    assert_eq!(bed.read(0x11), 0);
}

#[test]
fn a_jog_follows_the_speed_and_stops_with_a_ramp() {
    let mut bed = Bed::ready();
    bed.write(0x11, 2);
    bed.run_until(1.secs());
    assert_eq!(bed.read(0x11), 2);
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 5_000);
    bed.write(0x15, 2_000);
    bed.run_until(2.secs());
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 2_000);
    bed.write(0x11, 0x10);
    assert_eq!(bed.read(0x11), 0x10);
    bed.run_until(3.secs());
    assert_eq!((bed.read(0x11), bed.level("J3.7")), (0, Level::Float));
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 0);
}

#[test]
fn without_acceleration_a_jog_goes_on_and_stops_at_once() {
    let mut bed = Bed::ready();
    bed.write(0x11, 2);
    bed.run_until(1.secs());
    bed.write(0x19, 0);
    bed.write(0x15, 2_000);
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 5_000);
    bed.write(0x19, 10_000);
    bed.write(0x11, 2); // now it takes the speed
    bed.run_until(2.secs());
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 2_000);
    bed.write(0x19, 0);
    bed.write(0x11, 0x10);
    assert_eq!(bed.read(0x11), 0);
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), 0);
}

#[test]
fn a_drive_that_is_ready_at_0_listens_at_0() {
    let mut bed = Bed::ready();
    bed.input(Instant::ZERO, Input::Bytes { port: Port(0), bytes: &rtu::read(1, 0, 1) });
    bed.input(Instant::ZERO, Input::Idle { port: Port(0) });
    assert_eq!(bed.world.sent, [(Instant::ZERO, rtu::frame(1, &[3, 2, 0, 1]))]);
}

#[test]
fn a_jog_turns_round_by_way_of_standstill() {
    let mut bed = Bed::ready();
    bed.write(0x11, 2);
    bed.run_until(1.secs());
    bed.write(0x14, 0xFFFF); // between the two writes the drive sees -60,536, which acts as -40,000
    bed.write(0x15, 0xEC78); // -5000
    bed.run_until(10.secs());
    assert_eq!(bed.world.plan.unwrap().speed_at(bed.now), -5_000);
}

#[test]
fn stop_stops_at_once_with_current() {
    let mut bed = Bed::ready();
    bed.write(0x11, 2);
    bed.run_until(1.secs());
    bed.write(0x11, 8);
    let position = bed.position();
    bed.run_until(2.secs());
    assert_eq!((bed.position(), bed.read(0x11)), (position, 0));
    assert_eq!(bed.world.current.last().unwrap().1, 1_000);
}

#[test]
fn disable_is_a_level() {
    let mut bed = Bed::ready();
    bed.write(0x11, 0x21); // Move is ignored beside Disable
    assert_eq!((bed.read(0x11), bed.world.current.last().unwrap().1), (0x20, 0));
    bed.write(0x11, 0x01); // enables and moves
    assert_eq!((bed.read(0x11), bed.world.current.last().unwrap().1), (0x01, 1_000));
    bed.write(0x11, 0x00); // changes nothing
    assert_eq!(bed.read(0x11), 0x01);
    bed.write(0x11, 0x20);
    let position = bed.position();
    bed.run_until(10.secs());
    assert_eq!(bed.position(), position);
}

#[test]
fn without_speed_or_acceleration_a_command_completes_at_once() {
    for address in [0x15, 0x19] {
        let mut bed = Bed::ready();
        bed.write(address, 0);
        for command in [1, 2, 4, 0x10] {
            bed.write(0x11, command);
            assert_eq!(bed.read(0x11), 0);
        }
        assert_eq!(bed.position(), 0);
    }
}

#[test]
fn a_thermal_fault_stays_until_it_has_cooled() {
    let mut bed = Bed::ready();
    let hot = |on| Input::Fault { fault: Fault(0), on };
    bed.write(0x11, 2);
    bed.input(bed.now, hot(true));
    assert_eq!((bed.read(0x11), bed.level("J3.7")), (0x8000, Level::Low));
    assert_eq!(bed.world.current.last().unwrap().1, 0);
    let position = bed.position();
    bed.write(0x11, 0x8001);
    assert_eq!(bed.read(0x11), 0x8000);
    bed.input(bed.now, hot(false));
    assert_eq!(bed.read(0x11), 0x8000, "it stays until it is cleared");
    bed.write(0x11, 1);
    assert_eq!((bed.read(0x11), bed.position()), (0x8000, position), "answered, and nothing moves");
    bed.write(0x11, 0x8000);
    assert_eq!((bed.read(0x11), bed.level("J3.7")), (0, Level::Float));
    assert_eq!(bed.world.current.last().unwrap().1, 1_000);
}

#[test]
fn other_faults_are_cleared_by_a_write_that_may_move_at_once() {
    let mut bed = Bed::ready();
    bed.input(bed.now, Input::Fault { fault: Fault(1), on: true });
    assert_eq!(bed.read(0x11), 0x8000);
    bed.write(0x11, 0x8001);
    assert_eq!(bed.read(0x11), 1);
}

#[test]
fn the_port_shows_pins_and_drives_outputs() {
    let mut bed = Bed::ready();
    assert_eq!(bed.read(0x0a), 0x000f);
    for (pin, word) in [(0, 0x0007), (1, 0x0003), (2, 0x0001), (3, 0x0000)] {
        bed.input(bed.now, Input::Edge { pin: Pin(pin), high: false });
        assert_eq!(bed.read(0x0a), word);
    }
    bed.input(bed.now, Input::Edge { pin: Pin(5), high: true }); // J2 pin 10
    bed.write(0x0a, 0xFFD0);
    assert_eq!(bed.read(0x0a), 0xFFA0, "inputs show their pins, unused bits what was written");
    assert_eq!((bed.level("J3.8"), bed.level("J2.9")), (Level::Low, Level::Float));
    bed.write(0x09, 0x1000);
    assert_eq!(bed.read(0x0a), 0xFFD0);
    assert_eq!(
        (bed.level("J2.9"), bed.level("J2.10"), bed.level("J2.12")),
        (Level::High, Level::Low, Level::High)
    );
}

#[test]
fn pins_are_where_their_names_say() {
    let names = |pins: &[Pin]| -> Vec<_> {
        pins.iter().map(|pin| super::PINS[usize::from(pin.0)].name).collect()
    };
    assert_eq!(names(&[0, 1, 2, 3].map(Pin)), ["J2.2", "J2.3", "J2.4", "J2.5"]);
    assert_eq!(names(&super::GPIO.map(|(pin, _)| pin)), ["J2.9", "J2.10", "J2.12"]);
    assert_eq!(names(&[super::BUSY, super::J3_8, super::STEP, super::DIR]), ["J3.7", "J3.8", "STEP", "DIR"]);
    // Section 2: the heartbeat is green, D6; the cutback light red, D5.
    assert_eq!(names(&[super::RED, super::GREEN]), ["D5", "D6"]);
    // Section 2: J2 pins 9, 10, 12 are index, A, B.
    let encoder = &super::HIGH_CURRENT.encoders[0];
    assert_eq!(names(&[encoder.index, encoder.a, encoder.b]), ["J2.9", "J2.10", "J2.12"]);
}
