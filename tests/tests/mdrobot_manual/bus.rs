//! The serial line: 19,200 8N1, silences, noise, traffic of others, two controllers (2.1 to 2.6; MDROBOT-1 to
//! MDROBOT-5).

use drivetwin_firmware::device::{Boot, Device, Input, Instant, Pin, Port, advance};
use drivetwin_firmware::mdrobot::Mdrobot;
use drivetwin_firmware::testing::Recorder;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Span};
use drivetwin_sim::bench::{Bench, Client, DriveId, Setup};

use crate::pid;
use crate::rig::{BOOT, SILENCE, timed};

/// Ticks of a character at 19,200 8N1. Its 10 bits are 8,333⅓ ticks, rounded.
const CHARACTER: u64 = 8_333;

/// Duration of 3.5 characters, rounded up.
const T35: Duration = Duration::from_ticks(29_166);

/// Controllers with ids 1 and 2 on one line.
fn two() -> (Bench, [DriveId; 2]) {
    let mut bench = Bench::new();
    let seats = [1_i64, 2].map(|id| {
        // Name of the setting by which users preset the id (MDROBOT-5).
        let row = Mdrobot::md400().spec().find("CONTROLLER_ID").expect("a setting").row;
        let setup = Setup { presets: vec![(row, id)], ..Setup::default() };
        bench
            .add_with(if id == 1 { "left" } else { "right" }, Box::new(Mdrobot::md400()), setup)
            .expect("a drive")
    });
    bench.share("line", &seats.map(|seat| (seat, Port(0))));
    bench.run_until(BOOT + 1.millis());
    (bench, seats)
}

/// Sends a frame and waits for a reply of that length. Returns the reply and the time at which its last
/// character ended.
fn exchange(bench: &mut Bench, client: Client, frame: &[u8], length: usize) -> (Vec<u8>, Instant) {
    bench.send(client, frame);
    let mut reply = Vec::new();
    let patience = bench.now() + 100.millis();
    while reply.len() < length && bench.next() < patience {
        bench.run_until(bench.next());
        bench.receive(client, &mut reply);
    }
    (reply, bench.now())
}

/// Two controllers are polled in turn, each request 3.5 characters after the last reply. All of thousands are
/// answered.
#[test]
fn page_3_two_controllers_in_turn() {
    let (mut bench, [left, right]) = two();
    let client = bench.connect(bench.bus(left, Port(0)).expect("a line"));
    // Controller 1 turns its motor while both are polled.
    for frame in
        [rtu::write(1, pid::UI_COM, 1), rtu::write(1, pid::START_STOP, 1), rtu::write(1, pid::VEL_CMD, 777)]
    {
        let (reply, _) = exchange(&mut bench, client, &frame, 8);
        assert_eq!(reply, frame[..]);
        bench.run_until(bench.now() + T35);
    }
    let polls = 4_000;
    let mut turned = 0;
    for poll in 0..polls {
        let unit = 1 + (poll % 2) as u8;
        let begins = bench.now();
        // Alternates between a read of six words and a write of one.
        let (frame, length) = match poll % 4 {
            0 | 1 => (rtu::read(unit, pid::MONITOR, 6), 17),
            _ => (rtu::write(unit, pid::IN_POSITION, poll), 8),
        };
        let (reply, ended) = exchange(&mut bench, client, &frame, length);
        let body = rtu::verify_crc(&reply).unwrap_or_else(|| panic!("poll {poll}: {reply:02X?}"));
        assert_eq!((body[0], reply.len()), (unit, length), "poll {poll}");
        if length == 8 {
            assert_eq!(reply, frame[..]);
        } else if unit == 1 {
            turned += u32::from(u16::from_be_bytes([reply[3], reply[4]]).abs_diff(777) <= 8);
        } else {
            assert_eq!(reply[3..15], [0; 12], "2 stands");
        }
        // A poll takes the request, at least 3.5 characters of silence, and the reply, with at most a few
        // characters more.
        let took = ended.since(begins).ticks();
        let characters = (8 + length) as u64 * CHARACTER;
        assert!(took >= characters + T35.ticks() && took <= characters + 8 * CHARACTER, "{took} ticks");
        bench.run_until(ended + T35);
    }
    assert!(turned > 800, "{turned}");
    let [ones, twos] = [left, right].map(|seat| bench.statistics(seat, Port(0)));
    assert_eq!((ones.requests, twos.requests), (u64::from(polls / 2) + 3, u64::from(polls / 2)));
    assert_eq!((ones.refused, twos.refused), (0, 0));
    // Requests to the other drive, and its replies, do not count as errors.
    for seen in [ones, twos] {
        assert_eq!((seen.crc, seen.gap, seen.length, seen.spoiled), (0, 0, 0, 0), "{seen:?}");
    }
    assert_eq!(bench.peek(right, bench.spec(right).find("IN_POSITION").expect("a PID").row), 3_999);
    assert_eq!(bench.peek(left, bench.spec(left).find("IN_POSITION").expect("a PID").row), 3_998);
}

/// Both controllers obey the broadcast id, and neither answers (p. 3).
#[test]
fn page_3_both_obey() {
    let (mut bench, [left, right]) = two();
    assert_eq!(bench.ask(left, &rtu::write(0xFE, pid::MAX_RPM, 1_500)), SILENCE);
    for unit in [1, 2, 2, 1] {
        let reply = bench.ask(right, &rtu::read(unit, pid::MAX_RPM, 1));
        assert_eq!(reply, rtu::frame(unit, &[3, 2, 0x05, 0xDC])[..]);
    }
    assert_eq!(bench.ask(left, &rtu::read(3, pid::VERSION, 1)), SILENCE);
}

/// An id that is written over the bus is valid after a power cycle of that controller (p. 12).
#[test]
fn page_12_an_id_on_a_shared_line() {
    let (mut bench, [left, right]) = two();
    let frame = rtu::write(2, pid::ID, 9 << 8 | 0xAA);
    assert_eq!(bench.ask(left, &frame), frame[..]);
    bench.power(right, drivetwin_sim::bench::PowerAction::Cycle);
    bench.run_until(bench.now() + BOOT + 10.millis());
    assert_eq!(bench.ask(left, &rtu::read(2, pid::VERSION, 1)), SILENCE);
    assert_eq!(bench.ask(left, &rtu::read(9, pid::VERSION, 1)), rtu::frame(9, &[3, 2, 0, 81])[..]);
    assert_eq!(bench.ask(left, &rtu::read(1, pid::VERSION, 1)), rtu::frame(1, &[3, 2, 0, 81])[..]);
}

/// Noise, frames of other protocols, damaged frames, and traffic of other controllers have no answer and no
/// effect. The next valid frame is answered.
#[test]
fn page_3_noise() {
    let good = rtu::read(1, pid::MAX_RPM, 1);
    let reply = rtu::frame(1, &[3, 2, 0x0B, 0xB8]);
    let mut wrong_crc = rtu::write(1, pid::MAX_RPM, 1_000).to_vec();
    wrong_crc[7] ^= 0x10;
    let high_first = {
        // A frame with the bytes of the CRC in the other order.
        let mut frame = rtu::write(1, pid::MAX_RPM, 1_000).to_vec();
        frame.swap(6, 7);
        frame
    };
    // The maker's own protocol: RMID, TMID, ID, PID, number, data, check (p. 19).
    let native = [183, 184, 1, 130, 2, 0xE8, 0x03, 0x1D];
    let bad: [Vec<u8>; 12] = [
        vec![0x00],
        vec![0xFF; 40],
        vec![1],
        vec![1, 3],
        good[..7].to_vec(),
        wrong_crc,
        high_first,
        native.to_vec(),
        rtu::frame(1, &[3, 0, 1, 0]).to_vec(),
        rtu::write(2, pid::MAX_RPM, 1_000).to_vec(),
        rtu::frame(2, &[3, 2, 0x03, 0xE8]).to_vec(),
        (0..=255).collect(),
    ];
    for noise in bad {
        let mut rig = timed();
        assert_eq!(rig.bench.ask(rig.seat, &noise), SILENCE, "to {noise:02X?}");
        rig.after(100.millis());
        assert_eq!(rig.bench.ask(rig.seat, &good), reply[..], "after {noise:02X?}");
    }
}

/// Passes characters to the drive, each after a silence in ticks. Returns the drive's answers.
fn fed(characters: &[(u8, u64)]) -> Vec<u8> {
    let mut drive = Mdrobot::md400();
    let mut out = Recorder::new(drive.spec().memory.into());
    let power = Instant::ZERO;
    drive.power_on(power, Boot::default(), &mut out);
    let mut at = power + BOOT + 1.millis();
    let mut inputs = Vec::new();
    for &(byte, silence) in characters {
        at += Duration::from_ticks(silence + CHARACTER);
        inputs.push((at, byte));
    }
    let bytes: Vec<[u8; 1]> = inputs.iter().map(|&(_, byte)| [byte]).collect();
    let inputs =
        inputs.iter().zip(&bytes).map(|(&(at, _), byte)| (at, Input::Bytes { port: Port(0), bytes: byte }));
    advance(&mut drive, at + 100.millis(), inputs, &mut out);
    out.bytes.into_iter().flat_map(|(.., bytes)| bytes).collect()
}

/// A silence of up to 1.5 characters inside a frame is ignored. A longer silence spoils the frame, and
/// neither part of it is used (serial 2.5.1.1).
#[test]
fn page_3_silences() {
    let read = rtu::read(1, pid::VERSION, 1);
    let reply = rtu::frame(1, &[3, 2, 0, 81]);
    // 1.5 characters are 12,500 ticks.
    for (silence, answered) in [(0, true), (8_000, true), (12_000, true), (13_000, false), (25_000, false)] {
        for gap in 1..read.len() {
            let frame: Vec<(u8, u64)> = read
                .iter()
                .enumerate()
                .map(|(n, &byte)| (byte, if n == gap { silence } else { 0 }))
                .collect();
            let expected = if answered { &reply[..] } else { &[] };
            assert_eq!(fed(&frame), expected, "{silence} ticks before character {gap}");
        }
        // Now the same silence is before every character.
        let frame: Vec<(u8, u64)> =
            read.iter().enumerate().map(|(n, &byte)| (byte, if n == 0 { 0 } else { silence })).collect();
        let expected = if answered { &reply[..] } else { &[] };
        assert_eq!(fed(&frame), expected, "{silence} ticks before every character");
    }
    // Two frames 3.5 characters apart. The first is for another drive, or only a part of a frame.
    for first in [&rtu::write(2, pid::MAX_RPM, 1)[..], &read[..5]] {
        let mut both: Vec<(u8, u64)> = first.iter().map(|&byte| (byte, 0)).collect();
        both.extend(
            read.iter().enumerate().map(|(n, &byte)| (byte, if n == 0 { T35.ticks() + 1 } else { 0 })),
        );
        assert_eq!(fed(&both), reply[..], "after {first:02X?}");
    }
}

/// The pins of the connector and the faults have the manual's names, in any order.
#[test]
fn page_11_pins() {
    let drive = Mdrobot::md400();
    let spec = drive.spec();
    for name in [
        "INT_SPEED",
        "ALARM_RESET",
        "DIR",
        "RUN_BRAKE",
        "START_STOP",
        "ENC_A",
        "ENC_B",
        "SPEED_IN",
        "PULSE_IN",
        "ALARM",
        "CLUTCH",
        "FAN",
    ] {
        let pin: Option<Pin> = spec.pin(name);
        assert!(pin.is_some(), "there is no {name}");
    }
    let faults = [
        "over_voltage",
        "over_temperature",
        "overload",
        "hall_fail",
        "encoder_fail",
        "inverse_velocity",
        "stall",
        "ctrl_fail",
        "regen_over_temperature",
    ];
    for fault in faults {
        assert!(spec.faults.contains(&fault), "there is no {fault}");
    }
    assert_eq!(spec.faults.len(), faults.len());
}
