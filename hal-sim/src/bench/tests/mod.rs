//! Tests with exact times, and properties that every bench must have.

mod ascii;
mod characters;
mod contacts;
mod early_requests;
mod faults;
mod motors;
mod names;
mod received;
mod recordings;
mod shared_lines;
mod tcp;
mod tcp_faults;

use std::sync::{Arc, Mutex};

use drivetwin_firmware::device::{Axis, Encoder, Fault, Level, Line, Pin};
use drivetwin_firmware::md3::{Md3, Reg};
use drivetwin_firmware::mdrive::Mdrive;
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::rtu::{self, Timing};
use drivetwin_protocol::time::Span;
use proptest::prelude::*;

use super::*;
use crate::line::faults::LineFaults;
use crate::line::{PortParity, Sender};
use crate::replay;
use crate::testing::echo_device::EchoDevice;
use crate::testing::test_device::{self, TestDevice};

/// Duration of a character of 9,600 8E1.
const CHARACTER: Duration = Duration::from_ticks(18_333);
const T3_5: Duration = Duration::from_ticks(64_166);
/// Duration of a request or reply of eight characters.
const EIGHT: Duration = Duration::from_ticks(8 * 18_333);
const RS485: Port = Port(0);

fn make(kind: &str) -> Option<Box<dyn Device>> {
    match kind {
        "md3" => Some(Box::new(Md3::new())),
        "echo" => Some(Box::new(EchoDevice::default())),
        "toy" => Some(Box::new(TestDevice::default())),
        _ => None,
    }
}

/// An MD3 with that address, which receives requests from [`start`] on.
fn md3(bench: &mut Bench, name: &str, address: i64) -> DriveId {
    let presets = vec![(Reg::DeviceAddress as usize, address)];
    let setup = Setup { boot_fast: true, presets, ..Setup::default() };
    bench.add_with(name, Box::new(Md3::new()), setup).unwrap()
}

/// A bench at 1 ms with one MD3, at address 1, and a client on its line.
fn alone(line: LineMode) -> (Bench, DriveId, Client) {
    let mut bench = Bench::with(Settings { line, ..Settings::default() });
    let drive = md3(&mut bench, "x", 1);
    bench.run_until(start());
    let client = bench.connect(bench.bus(drive, RS485).unwrap());
    (bench, drive, client)
}

/// A bench at 1 ms with two MD3s on one line, at addresses 1 and 2.
fn pair(line: LineMode) -> (Bench, [DriveId; 2], Bus) {
    let mut bench = Bench::with(Settings { line, ..Settings::default() });
    let slots = [md3(&mut bench, "x", 1), md3(&mut bench, "y", 2)];
    bench.run_until(start());
    let bus = bench.share("line1", &slots.map(|drive| (drive, RS485)));
    (bench, slots, bus)
}

fn received_by(bench: &mut Bench, client: Client) -> Vec<u8> {
    let mut bytes = Vec::new();
    bench.receive(client, &mut bytes);
    bytes
}

/// Time from which the MD3s receive requests: at the very instant of power-on they do not.
fn start() -> Instant {
    Instant::from(1.millis())
}

/// The timestamps of those lines of a trace that contain `words`.
fn stamps(bench: &Bench, words: &str) -> Vec<String> {
    let text = bench.trace().to_text();
    text.lines()
        .filter(|line| line.contains(words))
        .map(|line| line.split(' ').next().unwrap().to_owned())
        .collect()
}

#[test]
fn the_first_character_of_a_reply_ends_t3_5_and_two_characters_after_the_request() {
    let (mut bench, _, client) = alone(LineMode::Timed);
    bench.send(client, &rtu::read(1, 0, 1));
    let leaves = start() + EIGHT + T3_5 + CHARACTER;
    assert_eq!(bench.now(), start());
    bench.run_until(leaves + CHARACTER - Duration::TICK);
    assert_eq!(received_by(&mut bench, client), [0; 0]);
    assert_eq!(bench.next(), leaves + CHARACTER);
    bench.run_until(leaves + CHARACTER);
    assert_eq!(received_by(&mut bench, client), [1]);
    bench.run_until(leaves + CHARACTER * 7 - Duration::TICK);
    assert_eq!(received_by(&mut bench, client), [3, 2, 0, 1, 0x79]);
    bench.run_until(leaves + CHARACTER * 7);
    assert_eq!(received_by(&mut bench, client), [0x84]);
}

#[test]
fn the_trace_has_the_times_of_request_and_reply() {
    // Architecture, "Tests", has `1.000000 > rx 01 03 …`, `14.177083 < tx …`. Here a character has a whole
    // number of ticks, so the reply starts at 14.176875.
    let text = "drivetwin trace 1
drive md3 md3 fast
compare tx
\
                1.000000 > rx 01 03 00 00 00 01 84 0A
14.176875 < tx 01 03 02 00 01 79 84
";
    let trace = Trace::parse(text, &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}

#[test]
fn a_replay_adds_all_drives_of_an_instant_before_its_events() {
    let mut bench = Bench::new();
    let fast = || Setup { boot_fast: true, ..Setup::default() };
    let slots = ["x", "y"].map(|name| bench.add_with(name, Box::new(Md3::new()), fast()).unwrap());
    bench.fault(slots[0], Fault(0), true);
    bench.run_until(100.millis());
    let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}

#[test]
fn manual_time_goes_to_the_end_of_the_reply() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let reply = bench.ask(drive, &rtu::read(1, 0, 1));
    assert_eq!(reply, [1, 3, 2, 0, 1, 0x79, 0x84]);
    assert_eq!(bench.now(), start() + EIGHT + T3_5 + CHARACTER + CHARACTER * 7);
    // Another client receives it, too.
    assert_eq!(received_by(&mut bench, client), reply);
}

#[test]
fn manual_time_runs_to_the_end_of_a_long_unread_reply_in_slices() {
    let (mut bench, _, client) = alone(LineMode::Timed);
    bench.send(client, &rtu::read(1, 0, 32));
    let settling = bench.begin_idle_run();
    // The reply has 69 characters: nine slices of 10 ms, and two before it starts.
    let slices = (1..12).find(|_| {
        let slice = bench.next().max(bench.now()) + 10.millis();
        bench.continue_idle_run(settling, slice)
    });
    assert!(slices.is_some_and(|slices| slices > 2), "{slices:?}");
    assert_eq!(bench.now(), start() + EIGHT + T3_5 + CHARACTER + CHARACTER * 69);
    assert_eq!(received_by(&mut bench, client).len(), 69);
}

#[test]
fn manual_time_goes_on_until_a_request_without_a_reply_is_judged() {
    let (mut bench, drive, _) = alone(LineMode::Timed);
    assert_eq!(bench.ask(drive, &rtu::read(9, 0, 1)), [0; 0]);
    assert_eq!(bench.now(), start() + EIGHT + T3_5 + CHARACTER);
    assert_eq!(bench.statistics(drive, RS485).foreign, 1);
}

#[test]
fn a_full_length_with_a_bad_crc_is_over_at_once() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    bench.send(client, &[1, 3, 0, 0, 0, 1, 0, 0]);
    bench.run_until_idle();
    assert_eq!(bench.now(), start() + EIGHT + T3_5 + CHARACTER);
    assert_eq!(bench.statistics(drive, RS485).crc, 1);
    assert_eq!(bench.ask(drive, &rtu::read(1, 0, 1)).len(), 7);
}

#[test]
fn half_a_message_whose_rest_does_not_come_is_judged() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    bench.send(client, &rtu::read(1, 0, 1)[..3]);
    bench.run_until_idle();
    assert_eq!(bench.now(), start());
    let settling = bench.begin_idle_run_flushing();
    assert!(bench.continue_idle_run(settling, Instant::NEVER));
    // The frame timeout passes, then three characters on the line and the silence after them.
    assert_eq!(bench.now(), start() + 20.millis() + CHARACTER * 3 + T3_5 + CHARACTER);
    assert_eq!(bench.statistics(drive, RS485).dropped(), 1);
    assert_eq!(bench.ask(drive, &rtu::read(1, 0, 1)).len(), 7);
}

#[test]
fn half_a_message_does_not_keep_another_client_waiting_in_manual_time() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    bench.send(client, &rtu::read(1, 0, 1)[..3]);
    bench.run_until_idle();
    let other = bench.connect(bench.bus(drive, RS485).unwrap());
    bench.send(other, &rtu::read(1, 0, 1));
    bench.run_until_idle();
    assert!(bench.now() > start() + 20.millis());
    assert_eq!(received_by(&mut bench, other).len(), 7);
    assert_eq!(bench.statistics(drive, RS485).dropped(), 1);
}

#[test]
fn half_a_message_waits_in_manual_time() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let frame = rtu::read(1, 0, 1);
    bench.send(client, &frame[..3]);
    bench.run_until_idle();
    assert_eq!(bench.now(), start());
    bench.send(client, &frame[3..]);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client).len(), 7);
    assert_eq!(bench.statistics(drive, RS485).dropped(), 0);
}

#[test]
fn patience_ends_20_ms_after_the_last_byte() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let frame = rtu::read(1, 0, 1);
    bench.send(client, &frame[..3]);
    bench.run_until(start() + 15.millis());
    bench.send(client, &frame[3..5]);
    bench.run_until(start() + 35.millis() - Duration::TICK);
    assert_eq!(stamps(&bench, "> rx"), [""; 0]);
    // Then the frame goes to the drive unchanged, and the drive drops it.
    bench.run_until(start() + 35.millis() + CHARACTER * 5 + T3_5 + CHARACTER);
    assert_eq!(stamps(&bench, "> rx"), ["37.145813"]);
    assert_eq!(bench.statistics(drive, RS485).crc, 1);
    bench.send(client, &frame[5..]);
    bench.run_until(200.millis());
    assert_eq!(received_by(&mut bench, client), [0; 0]);
    assert_eq!(bench.ask(drive, &frame).len(), 7);
}

#[test]
fn what_came_apart_is_apart_though_the_line_was_busy() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let other = bench.connect(bench.bus(drive, RS485).unwrap());
    let bad = [1, 3, 0, 0, 0, 1, 0, 0];
    let half = &rtu::read(1, 0, 1)[..5];
    for (n, lost) in (0..).zip([&bad[..], half]) {
        let now = Instant::from(1.secs() * (n + 1));
        bench.run_until(now);
        bench.send(client, &rtu::read(1, 0, 32));
        bench.run_until(now + 5.millis());
        bench.send(other, lost);
        bench.run_until(now + 25.millis());
        bench.send(other, &rtu::read(1, 0x14, 2));
        bench.run_until(now + 500.millis());
        // The answer to the first client, then the answer to the valid frame of the other client.
        let received = received_by(&mut bench, other);
        assert_eq!(received.len(), 69 + 9);
        assert_eq!(rtu::verify_crc(&received[69..]), Some(&[1, 3, 4, 0x00, 0x00, 0x13, 0x88][..]));
    }
}

#[test]
fn a_drive_that_is_ready_at_once_answers_at_once() {
    let mut bench = Bench::with(Settings { line: LineMode::Fast, ..Settings::default() });
    let setup = Setup { boot_fast: true, ..Setup::default() };
    let drive = bench.add_with("x", Box::new(Md3::new()), setup).unwrap();
    assert_eq!(bench.ask(drive, &rtu::read(1, 0, 1)).len(), 7);
    assert!(bench.now() <= Instant::ZERO + Duration::TICK);
}

#[test]
fn bytes_just_before_the_frame_timeout_complete_a_frame() {
    let (mut bench, _, client) = alone(LineMode::Timed);
    let frame = rtu::read(1, 0, 1);
    bench.send(client, &frame[..7]);
    bench.run_until(start() + 20.millis() - Duration::TICK);
    bench.send(client, &frame[7..]);
    bench.run_until(100.millis());
    assert_eq!(received_by(&mut bench, client).len(), 7);
}

#[test]
fn a_request_is_answered_though_the_crc_of_its_begin_holds_by_chance() {
    // Function 16 to registers 0x5021 and 0x5022 of an RS 434544 at address 48. The CRC of the whole request is valid.
    // By chance, the first bytes of this request also end with a valid CRC.
    let request = [0x30, 0x10, 0x50, 0x21, 0x00, 0x02, 0x04, 0xE3, 0x10, 0x00, 0x00, 0x01, 0xC5];
    for cut in 1..=request.len() {
        for paces_itself in [false, true] {
            let mut bench = Bench::new();
            let drive = crate::catalog::make("rs434544").unwrap();
            let address = drive.spec().find("SLAVE_ADDRESS_MODBUS").unwrap().row;
            let setup = Setup { boot_fast: true, presets: vec![(address, 48)], ..Setup::default() };
            let drive = bench.add_with("x", drive, setup).unwrap();
            bench.run_until(5.secs());
            let client = bench.connect(bench.bus(drive, Port(0)).unwrap());
            if paces_itself {
                bench.set_self_paced(client);
            }
            bench.send(client, &request[..cut]);
            bench.run_until(bench.now() + 5.millis());
            bench.send(client, &request[cut..]);
            bench.run_until(bench.now() + 200.millis());
            let statistics = bench.statistics(drive, Port(0));
            assert_eq!(
                (statistics.requests + statistics.refused, statistics.dropped()),
                (1, 0),
                "cut at {cut}"
            );
            assert_eq!(received_by(&mut bench, client)[..1], [0x30], "cut at {cut}");
        }
    }
}

#[test]
fn a_client_that_hears_its_own_answers_only_knows_when_it_is_served() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let own = bench.connect(bench.bus(drive, RS485).unwrap());
    bench.set_hears_own_answers_only(own);
    for (asks, other) in [(client, own), (own, client), (client, own)] {
        bench.send(asks, &rtu::read(1, 0, 1));
        bench.send(other, &rtu::read(1, 0, 2));
        assert!(bench.is_being_served(asks) && bench.is_being_served(other));
        while bench.is_being_served(asks) {
            assert!(bench.is_being_served(other), "the second one waits for its turn");
            bench.run_until(bench.now() + 1.millis());
        }
        bench.run_until(bench.now() + 100.millis());
        assert!(!bench.is_being_served(other));
        let [first, second] = [asks, other].map(|client| received_by(&mut bench, client).len());
        // A reply has 5 bytes and 2 for each register. The usual client hears both.
        assert_eq!((first, second), if asks == own { (7, 16) } else { (16, 9) });
    }
}

#[test]
fn a_request_of_any_length_is_answered_when_silence_has_ended_it() {
    let request = rtu::frame(1, &[65, 1, 2, 3]);
    // The beginning of the other request has a valid CRC, too.
    let begin = rtu::frame(1, &[65, 0, 0, 0, 0]);
    let long = rtu::frame(1, &[&begin[1..], &[9, 9]].concat());
    for request in [&request[..], &long] {
        let (mut bench, drive, client) = alone(LineMode::Timed);
        bench.send(client, &request[..request.len() - 4]);
        bench.run_until(start() + 19.millis());
        bench.send(client, &request[request.len() - 4..]);
        bench.run_until(start() + 100.millis());
        assert_eq!(received_by(&mut bench, client)[..3], [1, 0xC1, 1]);
        assert_eq!(bench.statistics(drive, RS485).dropped(), 0);
        // In manual time the bench does not wait for more, because no client sends before the answer.
        assert_eq!(bench.ask(drive, request)[..3], [1, 0xC1, 1]);
    }
}

#[test]
fn two_frames_written_at_once_are_two() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let both = [rtu::read(1, 0, 1).as_slice(), rtu::read(1, 1, 1).as_slice()].concat();
    bench.send(client, &both);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client).len(), 14);
    assert_eq!(bench.statistics(drive, RS485).requests, 2);
    let reply_ends = start() + EIGHT + T3_5 + CHARACTER + CHARACTER * 7;
    let second = bench.trace().events().filter(|entry| matches!(entry.event, trace::Event::Input(_))).nth(1);
    assert_eq!(second.unwrap().at, reply_ends + T3_5 + CHARACTER);
}

#[test]
fn after_a_broadcast_the_line_is_free_a_tick_later_than_t3_5() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let both = [rtu::write(0, 0x14, 1).as_slice(), rtu::read(1, 1, 1).as_slice()].concat();
    bench.send(client, &both);
    bench.run_until_idle();
    assert_eq!(bench.statistics(drive, RS485).requests, 2);
    let second = bench.trace().events().filter(|entry| matches!(entry.event, trace::Event::Input(_))).nth(1);
    assert_eq!(second.unwrap().at, start() + EIGHT + T3_5 + CHARACTER + Duration::TICK);
}

#[test]
fn a_client_that_leaves_takes_its_half_message_along() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let other = bench.connect(bench.bus(drive, RS485).unwrap());
    bench.send(client, &rtu::read(1, 0, 1)[..3]);
    bench.send(other, &rtu::read(1, 0, 1));
    bench.run_until(start() + 5.millis());
    assert_eq!(received_by(&mut bench, other), [0; 0]);
    bench.disconnect(client);
    bench.run_until_idle();
    let left = start() + 5.millis();
    assert_eq!(bench.now(), left + EIGHT + T3_5 + CHARACTER + CHARACTER * 7);
    assert_eq!(received_by(&mut bench, other).len(), 7);
    assert_eq!(bench.statistics(drive, RS485).dropped(), 0);
}

#[test]
fn what_a_client_wrote_whole_is_sent_when_it_has_left() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let two = [rtu::write(1, 0x15, 3).as_slice(), rtu::write(1, 0x15, 4).as_slice(), &[1, 6]].concat();
    bench.send(client, &two);
    bench.disconnect(client);
    bench.run_until(200.millis());
    assert_eq!(bench.peek(drive, Reg::Speed as usize), 4);
    assert_eq!(bench.statistics(drive, RS485), Statistics { requests: 2, ..Statistics::default() });
    assert_eq!(bench.backlog(client), 0);
}

#[test]
fn a_line_belongs_to_a_client_until_its_reply_is_out() {
    let (mut bench, drive, first) = alone(LineMode::Timed);
    let bus = bench.bus(drive, RS485).unwrap();
    let (second, third) = (bench.connect(bus), bench.connect(bus));
    bench.send(first, &rtu::read(1, 0, 1)[..4]);
    bench.send(second, &rtu::read(1, 0, 2));
    bench.run_until(start() + 1.millis());
    bench.send(third, &rtu::read(1, 0, 3));
    bench.send(first, &rtu::read(1, 0, 1)[4..]);
    bench.run_until_idle();
    let received = received_by(&mut bench, first);
    let lengths = [7, 9, 11];
    assert_eq!(received.len(), lengths.iter().sum::<usize>());
    // Requests are sent in the order of their first bytes. No client receives requests; each receives all
    // replies.
    assert_eq!([received[2], received[9], received[18]], [2, 4, 6]);
    assert_eq!(received_by(&mut bench, second), received);
    assert_eq!(received_by(&mut bench, third), received);
    assert_eq!(bench.statistics(drive, RS485).dropped(), 0);
}

#[test]
fn who_comes_when_the_asker_has_left_does_not_hear_the_reply() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let bus = bench.bus(drive, RS485).unwrap();
    let other = bench.connect(bus);
    bench.send(client, &rtu::read(1, 0, 1));
    bench.run_until(start() + 1.millis());
    bench.disconnect(client);
    let next = bench.connect(bus);
    bench.send(next, &rtu::read(1, 0, 2));
    bench.run_until(start() + 200.millis());
    assert_eq!(received_by(&mut bench, other).len(), 7 + 9);
    assert_eq!(received_by(&mut bench, next)[2..].len(), 7);
    assert_eq!(bench.statistics(drive, RS485).requests, 2);
}

#[test]
fn replies_are_lost_without_a_client() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    bench.send(client, &rtu::read(1, 0, 1));
    bench.disconnect(client);
    bench.run_until(start() + EIGHT + T3_5 + CHARACTER);
    let late = bench.connect(bench.bus(drive, RS485).unwrap());
    bench.run_until(100.millis());
    assert_eq!(bench.statistics(drive, RS485).requests, 1);
    assert_eq!(received_by(&mut bench, late), [0; 0]);
}

#[test]
fn drives_on_a_line_hear_each_other_and_are_not_confused() {
    let (mut bench, [x, y], bus) = pair(LineMode::Timed);
    let client = bench.connect(bus);
    for address in [1, 2, 1] {
        bench.send(client, &rtu::read(address, 0, 1));
        bench.run_until_idle();
        assert_eq!(received_by(&mut bench, client)[0], address);
    }
    // A drive counts the request and the reply of the other drive as foreign.
    assert_eq!(bench.statistics(x, RS485), Statistics { requests: 2, foreign: 2, ..Statistics::default() });
    assert_eq!(bench.statistics(y, RS485), Statistics { requests: 1, foreign: 3, ..Statistics::default() });
    bench.run_until(bench.now() + 20.millis());
    assert_eq!(bench.statistics(y, RS485), Statistics { requests: 1, foreign: 4, ..Statistics::default() });
}

/// A bench with two ready drives with address 1 on one line, and a client there.
fn two_of_one_address(line: LineMode) -> (Bench, [DriveId; 2], Client) {
    let mut bench = Bench::with(Settings { line, ..Settings::default() });
    let slots = [md3(&mut bench, "x", 1), md3(&mut bench, "y", 1)];
    bench.run_until(start());
    let bus = bench.share("line1", &slots.map(|drive| (drive, RS485)));
    let client = bench.connect(bus);
    (bench, slots, client)
}

#[test]
fn drives_that_answer_at_once_do_not_hear_each_other() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, slots, client) = two_of_one_address(line);
        // The answer to a write has the same bytes as the write.
        bench.send(client, &rtu::write(1, 0x15, 7));
        bench.run_until(bench.now() + 1.secs());
        for drive in slots {
            assert_eq!(bench.statistics(drive, RS485), Statistics { requests: 1, ..Statistics::default() });
        }
        // The client receives both answers, and nothing else.
        assert_eq!(received_by(&mut bench, client).len(), 16);
    }
}

#[test]
fn answers_at_once_are_mixed_whatever_the_order_of_the_drives() {
    let mixed = [["x", "y"], ["y", "x"]].map(|names| {
        let mut bench = Bench::new();
        let slots = names.map(|name| {
            let speed = if name == "x" { 3 } else { 4 };
            let drive = md3(&mut bench, name, 1);
            bench.poke(drive, Reg::Speed as usize, speed).unwrap();
            drive
        });
        let bus = bench.share("line1", &slots.map(|drive| (drive, RS485)));
        assert_eq!(
            bench.ports(bus).iter().map(|&(drive, _)| bench.name(drive)).collect::<Vec<_>>(),
            ["x", "y"]
        );
        bench.run_until(2.millis());
        let client = bench.connect(bus);
        bench.send(client, &rtu::read(1, 0x15, 1));
        bench.run_until(1.secs());
        received_by(&mut bench, client)
    });
    assert_eq!(mixed[0][..10], [1, 1, 3, 3, 2, 2, 0, 0, 3, 4]);
    assert_eq!(mixed[0], mixed[1]);
}

#[test]
fn drives_that_answer_each_other_for_ever_take_their_time() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, slots, client) = two_of_one_address(line);
        bench.power(slots[1], PowerAction::Off);
        bench.send(client, &rtu::write(1, 0x15, 7));
        // Drive y is powered again when the request is over, and takes the answer of x for a request.
        let over = if line == LineMode::Fast { Duration::ZERO } else { 10.millis() };
        bench.run_until(bench.now() + over);
        bench.power(slots[1], PowerAction::On);
        bench.run_until(bench.now() + 1.secs());
        let requests = bench.statistics(slots[0], RS485).requests;
        assert!((20..200).contains(&requests), "{requests} in a second");
    }
}

#[test]
fn an_input_comes_before_a_deadline_of_its_instant() {
    let mut bench = Bench::new();
    let toy = bench.add::<TestDevice>("toy");
    let client = bench.connect(bench.bus(toy, test_device::USB).unwrap());
    bench.send(client, b"s");
    let first = Instant::ZERO + Duration::from_ticks(1_389) + test_device::INTERVAL;
    bench.run_until(first - Duration::TICK);
    bench.set_pin(toy, test_device::IN, PinStimulus::Low);
    bench.run_until(first);
    // A stimulus that is set after the deadline has run is handled after it.
    bench.fault(toy, test_device::STALL, true);
    bench.run_until(first + Duration::TICK);
    let text = bench.trace().to_text();
    let script: Vec<&str> = text.lines().skip_while(|line| !line.contains("pin IN")).collect();
    assert_eq!(
        script,
        [
            "3.086813 > pin IN low",
            "3.086813 < step motor 2",
            "3.086813 < tx \".\"",
            "3.086875 > fault stall on",
            "3.086875 < current motor 1",
            "3.086875 end",
        ]
    );
}

#[test]
fn fast_takes_no_time() {
    let (mut bench, drive, _) = alone(LineMode::Fast);
    for _ in 0..3 {
        assert_eq!(bench.ask(drive, &rtu::read(1, 0, 1)), [1, 3, 2, 0, 1, 0x79, 0x84]);
    }
    assert_eq!(bench.now(), start());
    let text = bench.trace().to_text();
    let script: Vec<&str> = text.lines().skip_while(|line| !line.contains("rx")).take(3).collect();
    assert_eq!(
        script,
        ["1.000000 > rx 01 03 00 00 00 01 84 0A", "1.000000 > idle", "1.000000 < tx 01 03 02 00 01 79 84"]
    );
    let trace = Trace::parse(&text, &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}

#[test]
fn fast_lets_other_drives_hear_a_tick_later() {
    let (mut bench, [x, y], bus) = pair(LineMode::Fast);
    let client = bench.connect(bus);
    bench.send(client, &[rtu::read(1, 0, 1).as_slice(), &rtu::read(2, 0, 1)].concat());
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client).len(), 14);
    assert_eq!(bench.statistics(x, RS485), Statistics { requests: 1, foreign: 2, ..Statistics::default() });
    assert_eq!(bench.statistics(y, RS485), Statistics { requests: 1, foreign: 2, ..Statistics::default() });
    assert_eq!(bench.now(), start() + Duration::TICK * 2);
}

#[test]
fn a_sender_with_other_settings_is_noise() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    for sender in [
        Sender { baud: Some(19_200), ..Sender::default() },
        Sender { data: Some(7), ..Sender::default() },
        Sender { stop: Some(2), ..Sender::default() },
        Sender { parity: PortParity::Known(Parity::None), ..Sender::default() },
        Sender { parity: PortParity::Known(Parity::Odd), ..Sender::default() },
    ] {
        bench.send_from(client, &rtu::read(1, 0, 1), sender);
        bench.run_until_idle();
    }
    assert_eq!(bench.statistics(drive, RS485), Statistics { spoiled: 5, ..Statistics::default() });
    let right = Sender { baud: Some(9_600), stop: Some(1), parity: PortParity::NotOdd, ..Sender::default() };
    bench.send_from(client, &rtu::read(1, 0, 1), right);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client).len(), 7);
}

#[test]
fn a_client_with_other_settings_reads_other_characters() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, drive, client) = alone(line);
        let other = bench.connect(bench.bus(drive, RS485).unwrap());
        let eight_bits = Sender { parity: PortParity::Known(Parity::None), ..Sender::default() };
        bench.set_receiver(other, eight_bits);
        bench.send(client, &rtu::read(1, 0, 1));
        bench.run_until_idle();
        let reply = received_by(&mut bench, client);
        assert_eq!(reply, [1, 3, 2, 0, 1, 0x79, 0x84]);
        // The parity bit of 03 is a zero in place of a stop bit; the next start bit follows all the same.
        assert_eq!(received_by(&mut bench, other), [1, 3, 2, 0, 1, 0x79, 0x84]);
        bench.set_receiver(other, Sender { baud: Some(4_800), ..Sender::default() });
        bench.send(client, &rtu::read(1, 0, 1));
        bench.run_until_idle();
        assert_eq!(received_by(&mut bench, client), reply);
        let misread = received_by(&mut bench, other);
        assert!(!misread.is_empty() && misread.len() <= 4, "{misread:?}");
    }
}

#[test]
fn a_dropped_backlog_is_not_sent() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let request = rtu::read(1, 0, 1);
    bench.send(client, &request[..5]);
    bench.drop_backlog(client);
    // The rest of the request alone would be no frame, and the line waits for nothing.
    bench.send(client, &request);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client).len(), 7);
    assert_eq!(bench.statistics(drive, RS485), Statistics { requests: 1, ..Statistics::default() });
}

#[test]
fn a_new_rate_holds_when_the_reply_has_left() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    let bus = bench.bus(drive, RS485).unwrap();
    let old = bench.line(bus);
    assert_eq!(old, Line::new(9_600, 8, Parity::Even, 1));
    let request = rtu::write(1, 0x1c, 0b0000_0011);
    bench.send(client, &request);
    let reply_ends = start() + EIGHT + T3_5 + CHARACTER + EIGHT;
    bench.run_until(reply_ends - Duration::TICK);
    assert_eq!(bench.line(bus), old);
    bench.run_until(reply_ends);
    assert_eq!(received_by(&mut bench, client), request.as_slice());
    let new = bench.line(bus);
    assert_ne!(new.baud, 9_600);
    // The next request and its reply are sent at the new rate.
    let asked = bench.now();
    assert_eq!(bench.ask(drive, &rtu::read(1, 0, 1)).len(), 7);
    let Timing { character, t3_5, .. } = Timing::of(new);
    assert_eq!(bench.now(), asked + t3_5 + character * 8 + t3_5 + character + character * 7);
}

#[test]
fn without_power_a_drive_neither_receives_nor_sends() {
    let (mut bench, drive, client) = alone(LineMode::Timed);
    bench.send(client, &rtu::read(1, 0, 1));
    let leaves = start() + EIGHT + T3_5 + CHARACTER;
    bench.run_until(leaves + CHARACTER * 2);
    bench.power(drive, PowerAction::Off);
    bench.run_until_idle();
    assert!(!bench.powered(drive));
    bench.run_until(100.millis());
    // The client receives the characters that had ended by power-off.
    assert_eq!(received_by(&mut bench, client), [1, 3]);
    assert_eq!(bench.ask(drive, &rtu::read(1, 0, 1)), [0; 0]);
    assert_eq!(bench.poke(drive, 0, 1), Err(PresetError::ReadOnly));
    bench.power(drive, PowerAction::On);
    bench.run_until(bench.now() + 1.millis());
    assert_eq!(bench.ask(drive, &rtu::read(1, 0, 1)).len(), 7);
}

#[test]
fn a_cycle_is_off_for_a_tick() {
    let mut bench = Bench::new();
    let toy = bench.add::<TestDevice>("toy");
    bench.run_until(5.millis());
    bench.power(toy, PowerAction::Cycle);
    bench.run_until_idle();
    assert!(bench.powered(toy));
    assert_eq!(stamps(&bench, "> power off"), ["5.000000"]);
    assert_eq!(stamps(&bench, "> power on"), ["5.000063"]);
    // The wave of the light starts again.
    assert_eq!(bench.level(toy, test_device::LED), Level::High);
}

#[test]
fn inputs_that_are_not_at_rest_are_reported_at_power_on() {
    let mut bench = Bench::new();
    let toy = bench.add::<TestDevice>("toy");
    bench.power(toy, PowerAction::Off);
    bench.run_until_idle();
    bench.set_pin(toy, test_device::IN, PinStimulus::Low);
    bench.set_pin(toy, test_device::LEVEL, PinStimulus::Millivolts(2_500));
    bench.fault(toy, test_device::STALL, true);
    bench.run_until(1.millis());
    assert_eq!(bench.motion(toy, test_device::MOTOR), Motion::default());
    bench.power(toy, PowerAction::On);
    bench.run_until(1.millis());
    let motion = bench.motion(toy, test_device::MOTOR);
    assert_eq!((motion.position, motion.duty, motion.current_ma), (2, 2_500, 1));
    let text = bench.trace().to_text();
    let script: Vec<&str> = text.lines().skip_while(|line| !line.contains("power on")).collect();
    assert_eq!(
        script,
        [
            "1.000000 > power on",
            "1.000000 < wave LED 1.000000 of 4.000000",
            "1.000000 > fault stall on",
            "1.000000 < current motor 1",
            "1.000000 > pin IN low",
            "1.000000 < step motor 2",
            "1.000000 > millivolts LEVEL 2500",
            "1.000000 < duty motor 2500",
            "1.000000 < pin OUT high",
            "1.000000 end",
        ]
    );
}

#[test]
fn a_pin_arrives_a_tick_later() {
    let mut bench = Bench::new();
    let toy = bench.add::<TestDevice>("toy");
    bench.set_pin(toy, test_device::IN, PinStimulus::Low);
    assert_eq!(bench.level(toy, test_device::IN), Level::Low);
    bench.run_until(Instant::ZERO);
    assert_eq!(bench.motion(toy, test_device::MOTOR).position, 0);
    bench.run_until(Instant::from_ticks(1));
    assert_eq!(bench.motion(toy, test_device::MOTOR).position, 2);
    // If the level stays the same, there is no edge.
    bench.set_pin(toy, test_device::IN, PinStimulus::Millivolts(1_400));
    bench.run_until(1.millis());
    assert_eq!(bench.motion(toy, test_device::MOTOR).position, 2);
    bench.set_pin(toy, test_device::IN, PinStimulus::Open);
    bench.run_until(2.millis());
    assert_eq!(bench.motion(toy, test_device::MOTOR).position, 3);
}

#[test]
fn pulses_are_made_edge_by_edge() {
    let mut bench = Bench::new();
    let toy = bench.add::<TestDevice>("toy");
    bench.pulse(toy, test_device::IN, 3, 1_000.0).unwrap();
    assert_eq!(bench.pulse(toy, test_device::IN, 1, 1.0), Err(Busy));
    // Three low pulses of half a millisecond. They begin at 0, 1 and 2 ms, and arrive one tick later.
    bench.run_until(Instant::from(2.millis()));
    assert_eq!(bench.motion(toy, test_device::MOTOR).position, 2 * 3);
    bench.run_until(Instant::from(2.millis()) + Duration::TICK);
    assert_eq!(bench.motion(toy, test_device::MOTOR).position, 2 * 3 + 2);
    assert_eq!(bench.level(toy, test_device::IN), Level::Low);
    bench.run_until(Instant::from(2_500.micros()) + Duration::TICK);
    assert_eq!(bench.motion(toy, test_device::MOTOR).position, 3 * 3);
    assert_eq!(bench.level(toy, test_device::IN), Level::High);
    assert_eq!(bench.next(), Instant::NEVER);
    bench.pulse(toy, test_device::IN, 1, f64::NAN).unwrap();
    bench.set_pin(toy, test_device::IN, PinStimulus::High);
    bench.pulse(toy, test_device::IN, 250_000, 250_000.0).unwrap();
    bench.run_until(bench.now() + 1.secs() + Duration::TICK);
    assert_eq!(bench.motion(toy, test_device::MOTOR).position, 3 * 250_003);
}

#[test]
fn pulses_take_their_share_of_a_period() {
    // A period has 16,000 ticks. The pin is low from tick 1 on, for that share of the period, within the
    // limits of ticks.
    for (duty, low) in [(0.25, 4_000), (0.75, 12_000), (0.0, 1), (1.0, 15_999), (1e-9, 1)] {
        let mut bench = Bench::new();
        let toy = bench.add::<TestDevice>("toy");
        bench.pulse_width(toy, test_device::IN, 2, 1_000.0, duty).unwrap();
        for (ticks, level) in [
            (1, Level::Low),
            (low, Level::Low),
            (low + 1, Level::High),
            (16_000, Level::High),
            (16_001, Level::Low),
            (16_000 + low, Level::Low),
            (16_001 + low, Level::High),
        ] {
            bench.run_until(Instant::from_ticks(ticks));
            assert_eq!(bench.level(toy, test_device::IN), level, "{duty}: {ticks}");
        }
    }
}

#[test]
fn a_wave_is_seen_without_events() {
    let mut bench = Bench::new();
    let toy = bench.add::<TestDevice>("toy");
    bench.run_until(Instant::ZERO);
    assert_eq!(bench.next(), Instant::NEVER);
    for (ticks, level) in
        [(0, Level::High), (15_999, Level::High), (16_000, Level::Low), (64_000, Level::High)]
    {
        bench.run_until(Instant::from_ticks(ticks));
        assert_eq!(bench.level(toy, test_device::LED), level, "{ticks}");
    }
}

#[test]
fn characters_have_their_time() {
    let mut bench = Bench::new();
    let toy = bench.add::<TestDevice>("toy");
    bench.poke(toy, test_device::Reg::Volume as usize, b'v'.into()).unwrap();
    assert_eq!(bench.poke(toy, test_device::Reg::Volume as usize, 7), Err(PresetError::OutOfRange));
    let client = bench.connect(bench.bus(toy, test_device::USB).unwrap());
    bench.send(client, b"1r");
    let character = Duration::from_ticks(1_389);
    bench.run_until(Instant::ZERO + character * 5 - Duration::TICK);
    assert_eq!(received_by(&mut bench, client)[1..], [b'v']);
    bench.run_until(Instant::ZERO + character * 5);
    assert_eq!(received_by(&mut bench, client), [b'\n']);
    // Both directions work at the same time: a stream does not stop a command.
    bench.send(client, b"s");
    bench.run_until(bench.now() + 10.millis());
    bench.send(client, b"s");
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), b"...");
}

#[test]
fn presets_are_in_the_memory_or_set_after_every_power_on() {
    let mut bench = Bench::new();
    let presets = vec![(test_device::Reg::Volume as usize, 5), (test_device::Reg::Number as usize, 9)];
    let toy = bench
        .add_with("toy", Box::new(TestDevice::default()), Setup { presets, ..Setup::default() })
        .unwrap();
    assert_eq!(bench.memory(toy), [9, 255, 255, 255, 255, 255, 255, 255, 255, 255]);
    assert_eq!(bench.peek(toy, test_device::Reg::Volume as usize), 5);
    bench.power(toy, PowerAction::Cycle);
    bench.run_until_idle();
    assert_eq!(bench.peek(toy, test_device::Reg::Volume as usize), 5);
    let text = bench.trace().to_text();
    assert!(text.contains("memory toy 0x0000 09 FF FF"), "{text}");
    assert_eq!(text.matches("> poke Volume 5").count(), 2);
}

#[test]
fn a_bench_stays_as_it_was_when_a_seat_is_refused() {
    let mut bench = Bench::new();
    bench.add::<TestDevice>("toy");
    let before = bench.trace().to_text();
    let presets = vec![(test_device::Reg::Number as usize, 9), (test_device::Reg::Volume as usize, 7)];
    let refused =
        bench.add_with("other", Box::new(TestDevice::default()), Setup { presets, ..Setup::default() });
    assert_eq!(refused, Err(AddError::Preset { row: 0, why: PresetError::OutOfRange }));
    let again = bench.add_with("toy", Box::new(TestDevice::default()), Setup::default());
    assert_eq!(again, Err(AddError::Taken("toy".to_owned())));
    for name in ["", "two words", "#1", ">", "end", "1st"] {
        let refused = bench.add_with(name, Box::new(TestDevice::default()), Setup::default());
        assert_eq!(refused, Err(AddError::Name(name.to_owned())));
    }
    assert_eq!(bench.trace().to_text(), before);
    assert_eq!(bench.drives().len(), 1);
}

/// Another thread may own a bench: that of an event loop, or of an interpreter.
#[test]
fn a_bench_can_move_to_another_thread() {
    let mut bench = Bench::new();
    let md3 = bench.add::<drivetwin_firmware::md3::Md3>("x");
    let moved = std::thread::spawn(move || {
        bench.run_until(3.secs());
        bench.ask(md3, &drivetwin_protocol::modbus::rtu::write(1, 0x11, 1))
    });
    assert!(!moved.join().unwrap().is_empty());
}

/// A test device whose power fails during the save that it begins at once. Returns its memory after the
/// failure, the memory that was persisted, and the time of the last store.
fn cut(seed: u64) -> (Vec<u8>, Vec<u8>, String) {
    let mut bench = Bench::with(Settings { seed, ..Settings::default() });
    let kept = Arc::new(Mutex::new(vec![0xFF; 10]));
    let keeper = Arc::clone(&kept);
    let keep: PersistFn = Box::new(move |offset, bytes| {
        let from = usize::from(offset);
        keeper.lock().unwrap()[from..from + bytes.len()].copy_from_slice(bytes);
    });
    let toy = bench
        .add_with("toy", Box::new(TestDevice::default()), Setup { persist: Some(keep), ..Setup::default() })
        .unwrap();
    bench.power(toy, PowerAction::Cut);
    let client = bench.connect(bench.bus(toy, test_device::USB).unwrap());
    bench.send(client, b"ww");
    bench.run_until(1.secs());
    assert!(!bench.powered(toy));
    let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
    let kept = kept.lock().unwrap().clone();
    (bench.memory(toy).to_vec(), kept, stamps(&bench, "< store").last().cloned().unwrap())
}

#[test]
fn power_fails_anywhere_in_a_save() {
    let whole = [0, 1, 2, 3, 4, 5, 6, 7, 0xC0, 0];
    let mut lengths = [0_u32; 10];
    for seed in 0..400 {
        let (memory, kept, when) = cut(seed);
        assert_eq!(memory, kept);
        let length = memory.iter().take_while(|&&byte| byte != 0xFF).count();
        assert_eq!(memory[..length], whole[..length]);
        assert!(memory[length..].iter().all(|&byte| byte == 0xFF));
        // The failure is in the first store, or 20 ms later in the second one.
        let late = when.starts_with("20.");
        assert!(if late { length >= 8 } else { length <= 8 }, "{length} bytes at {when}");
        lengths[length] += 1;
        assert_eq!(cut(seed).0, memory);
    }
    // A cut that changes nothing would not be in the middle of a save.
    assert_eq!(lengths[0], 0);
    assert!(lengths[1..].iter().all(|&times| times > 0), "{lengths:?}");
}

#[test]
fn power_cut_inside_a_save_leaves_an_md3_a_bad_memory() {
    for seed in 0..40 {
        let mut bench = Bench::with(Settings { seed, line: LineMode::Fast, ..Settings::default() });
        let drive = md3(&mut bench, "x", 1);
        bench.run_until(start());
        bench.ask(drive, &rtu::write(1, 0x15, 1_234));
        bench.power(drive, PowerAction::Cut);
        bench.run_until_idle();
        bench.ask(drive, &rtu::write(1, 0x1a, 1));
        bench.run_until(bench.now() + 1.secs());
        assert!(!bench.powered(drive));
        bench.power(drive, PowerAction::On);
        bench.run_until(bench.now() + 10.secs());
        assert_eq!(bench.ask(drive, &rtu::read(1, 0x15, 1))[3..5], 5_000_u16.to_be_bytes());
        assert_eq!(bench.ask(drive, &rtu::read(1, 0x1a, 1))[3..5], [0xF1, 0x00]);
    }
}

/// Pins of an MD3.
const J2_2: Pin = Pin(0);
const J2_4: Pin = Pin(2);
const J2_5: Pin = Pin(3);
const ENCODER_A: Pin = Pin(5);
const ENCODER_B: Pin = Pin(6);
const BUSY: Pin = Pin(7);
const STEP: Pin = Pin(9);
const DIR: Pin = Pin(10);

/// The edges that a device received after `from`: ticks since then, pin, level.
fn edges(bench: &Bench, drive: DriveId, from: Instant) -> Vec<(u64, Pin, bool)> {
    let edge = |entry: &trace::Entry| match entry.event {
        trace::Event::Input(InputRecord::Edge { pin, high })
            if entry.drive == drive.0 as usize && entry.at > from =>
        {
            Some((entry.at.since(from).ticks(), pin, high))
        }
        _ => None,
    };
    bench.trace().events().filter_map(edge).collect()
}

/// A bench at 2 ms with two MD3s. STEP and DIR of the first are wired to pins 4 and 5 of J2 of the second.
/// Tests make the first move, jog or stop with [`command`].
fn geared() -> (Bench, [DriveId; 2]) {
    let (mut bench, [x, y], _) = pair(LineMode::Fast);
    bench.wire((x, STEP), (y, J2_4));
    bench.wire((x, DIR), (y, J2_5));
    bench.run_until(2.millis());
    (bench, [x, y])
}

fn command(bench: &mut Bench, drive: DriveId, bits: u16) {
    bench.poke(drive, Reg::MotionControl as usize, i64::from(bits)).unwrap();
}

const MOVE: u16 = 1;
const JOG: u16 = 2;
const STOP: u16 = 8;

#[test]
fn a_wire_carries_each_step_pulse_a_tick_later() {
    let (mut bench, [x, y]) = geared();
    // Open inputs are high, and outputs at rest are low.
    assert_eq!(edges(&bench, y, Instant::ZERO), [(16_001, J2_4, false), (16_001, J2_5, false)]);
    bench.poke(x, Reg::MoveSteps as usize, 3).unwrap();
    let from = bench.now();
    command(&mut bench, x, MOVE);
    bench.run_until(from + 1.secs());
    // The first step is made after sqrt(2/10,000) s and the last one after 2·sqrt(3/10,000) s. The second
    // step is as long before the end as the first one is after the start.
    let steps = [226_274, 554_256 - 226_274, 554_256];
    let pulse = |at| [(at + 1, J2_4, true), (at + 33, J2_4, false)];
    let mut expected = vec![(steps[0] - 80 + 1, J2_5, true)];
    expected.extend(steps.map(pulse).concat());
    assert_eq!(edges(&bench, y, from), expected);
    // One step back: DIR changes first.
    bench.poke(x, Reg::MoveSteps as usize, -1).unwrap();
    let from = bench.now();
    command(&mut bench, x, MOVE);
    bench.run_until(from + 1.secs());
    // The only step is made after 2·sqrt(1/10,000) s.
    let only = 320_000;
    let expected = [[(only - 80 + 1, J2_5, false)].as_slice(), &pulse(only)].concat();
    assert_eq!(edges(&bench, y, from), expected);
    assert_eq!(
        bench.pulses(x.step()).map(|pulse| pulse.forward).collect::<Vec<_>>(),
        [true, true, true, false]
    );
}

#[test]
fn pulses_are_made_only_where_a_wire_listens() {
    let (mut bench, drive, _) = alone(LineMode::Fast);
    bench.poke(drive, Reg::MoveSteps as usize, 3).unwrap();
    let from = bench.now();
    command(&mut bench, drive, MOVE);
    assert_eq!(bench.next(), from + Duration::from_ticks(554_256));
    bench.run_until(1.secs());
    command(&mut bench, drive, JOG);
    assert_eq!(bench.next(), Instant::NEVER);
    // The levels are computed for any time at which they are read.
    bench.run_until(2.secs());
    assert_eq!(bench.level(drive, DIR), Level::High);
    command(&mut bench, drive, STOP);
    assert_eq!(bench.level(drive, DIR), Level::High);

    let (mut bench, [x, _]) = geared();
    assert_eq!(bench.next(), Instant::NEVER);
    let from = bench.now();
    command(&mut bench, x, JOG);
    // The first step comes after sqrt(2/10,000) s. DIR changes 5 µs earlier, and the wire adds a tick.
    assert_eq!(bench.next(), from + Duration::from_ticks(226_274 - 80 + 1));
    bench.run_until(from + Duration::from_ticks(226_273));
    assert_eq!([STEP, DIR].map(|pin| bench.level(x, pin)), [Level::Low, Level::High]);
    bench.run_until(from + Duration::from_ticks(226_274));
    assert_eq!(bench.level(x, STEP), Level::High);
    command(&mut bench, x, STOP);
    bench.run_until(1.secs());
    assert_eq!(bench.level(x, STEP), Level::Low);
    assert_eq!(bench.next(), Instant::NEVER);
}

#[test]
fn a_late_wire_carries_the_rest_of_a_move() {
    let (mut bench, [x, y], _) = pair(LineMode::Fast);
    let from = bench.now();
    command(&mut bench, x, MOVE);
    bench.run_until(from + 1_250.millis());
    bench.wire((x, STEP), (y, J2_4));
    bench.wire((x, DIR), (y, J2_5));
    bench.run_until(from + 3.secs());
    let received = edges(&bench, y, from);
    // Half of 10,000 steps are left. J2.5 is high before and stays high. J2.4 falls when the wire is
    // connected.
    assert_eq!(received.iter().filter(|(_, pin, high)| *pin == J2_4 && *high).count(), 5_000);
    assert!(received.iter().all(|(_, pin, _)| *pin == J2_4));
}

#[test]
fn without_power_step_and_direction_fall() {
    for when in [0, 1, 20, 32, 33, 1_000] {
        let (mut bench, [x, y]) = geared();
        let from = bench.now();
        command(&mut bench, x, JOG);
        let first = from + Duration::from_ticks(226_274);
        bench.run_until(first + Duration::from_ticks(when));
        bench.power(x, PowerAction::Off);
        bench.run_until(from + 1.secs());
        let off = when + 1;
        let step_falls = off.min(32 + 1);
        let mut expected = vec![(J2_4, true, 1), (J2_4, false, step_falls), (J2_5, false, off)];
        expected.sort_by_key(|(_, _, at)| *at);
        let received: Vec<_> =
            edges(&bench, y, first).into_iter().map(|(at, pin, high)| (pin, high, at)).collect();
        assert_eq!(received, expected, "{when}");
        assert_eq!(bench.pulses(x.step()).count(), 1);
        bench.power(x, PowerAction::On);
        bench.run_until(from + 2.secs());
        assert_eq!(bench.next(), Instant::NEVER);
    }
}

#[test]
fn a_power_cut_ends_the_pulses() {
    let mut bench = Bench::with(Settings { line: LineMode::Fast, ..Settings::default() });
    let x = md3(&mut bench, "x", 1);
    bench.run_until(start());
    command(&mut bench, x, JOG);
    bench.run_until(500.millis());
    bench.power(x, PowerAction::Cut);
    bench.run_until_idle();
    bench.poke(x, Reg::EEPROMControl as usize, 1).unwrap();
    bench.run_until(1.secs());
    assert!(!bench.powered(x));
    let position = bench.motion(x, Axis(0)).position;
    assert!((1_000..1_500).contains(&position), "{position}");
    assert_eq!(bench.pulses(x.step()).count(), position as usize);
    let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}

/// An MD3 and a test device. BUSY of the MD3 is wired to the input of the test device.
fn busy() -> (Bench, DriveId, DriveId) {
    let (mut bench, x, _) = alone(LineMode::Fast);
    let toy = bench.add::<TestDevice>("toy");
    bench.wire((x, BUSY), (toy, test_device::IN));
    bench.run_until(2.millis());
    (bench, x, toy)
}

#[test]
fn an_output_that_floats_leaves_the_input_to_its_pull_up() {
    let (mut bench, x, toy) = busy();
    bench.poke(x, Reg::MoveSteps as usize, 1).unwrap();
    let from = bench.now();
    command(&mut bench, x, MOVE);
    bench.run_until(from + 1.secs());
    assert_eq!(
        edges(&bench, toy, Instant::ZERO),
        [(32_001, test_device::IN, false), (32_001 + 320_000, test_device::IN, true)]
    );
}

#[test]
fn hands_hold_an_input_until_they_let_go() {
    let (mut bench, x, toy) = busy();
    let from = bench.now();
    command(&mut bench, x, JOG);
    bench.run_until(3.millis());
    bench.set_pin(toy, test_device::IN, PinStimulus::High);
    bench.run_until(4.millis());
    command(&mut bench, x, STOP);
    bench.run_until(5.millis());
    command(&mut bench, x, JOG);
    bench.run_until(6.millis());
    assert_eq!(bench.level(toy, test_device::IN), Level::High);
    // A pulse train is a stimulus, too.
    bench.pulse(toy, test_device::IN, 1, 1_000.0).unwrap();
    bench.run_until(7.millis());
    bench.set_pin(toy, test_device::IN, PinStimulus::Open);
    assert_eq!(bench.level(toy, test_device::IN), Level::Low);
    bench.run_until(8.millis());
    let command: Vec<_> = edges(&bench, toy, from).into_iter().map(|(at, _, high)| (at, high)).collect();
    let ms = 16_000;
    assert_eq!(
        command,
        [(1, false), (ms + 1, true), (4 * ms + 1, false), (4 * ms + ms / 2 + 1, true), (5 * ms + 1, false),]
    );
}

#[test]
fn after_a_train_the_wire_decides_again() {
    let (mut bench, x, toy) = busy();
    let from = bench.now();
    bench.pulse(toy, test_device::IN, 1, 1_000.0).unwrap();
    command(&mut bench, x, JOG);
    bench.run_until(3.millis());
    // Low for half a millisecond, then high, then low at once because BUSY has pulled the wire low in the
    // meantime.
    let command: Vec<_> = edges(&bench, toy, from).into_iter().map(|(at, _, high)| (at, high)).collect();
    assert_eq!(command, [(1, false), (8_001, true), (8_001, false)]);
}

#[test]
fn direction_shows_the_last_step_of_any_source() {
    let (mut bench, x, _) = alone(LineMode::Fast);
    bench.poke(x, Reg::MoveSteps as usize, 3).unwrap();
    command(&mut bench, x, MOVE);
    bench.run_until(1.secs());
    assert_eq!(bench.level(x, DIR), Level::High);
    // A step backward from the step input of the MD3 (7.8), and one forward.
    for (direction, level, position) in
        [(PinStimulus::Low, Level::Low, 2), (PinStimulus::High, Level::High, 3)]
    {
        bench.set_pin(x, J2_5, direction);
        bench.run_until(bench.now() + 1.millis());
        bench.pulse(x, J2_4, 1, 1_000.0).unwrap();
        bench.run_until(bench.now() + 2.millis());
        assert_eq!(bench.motion(x, Axis(0)).position, position);
        assert_eq!(bench.level(x, DIR), level);
    }
}

#[test]
fn of_two_wires_to_one_input_low_wins() {
    let (mut bench, x, toy) = busy();
    let other = bench.add::<TestDevice>("other");
    bench.wire((other, test_device::OUT), (toy, test_device::IN));
    bench.run_until(3.millis());
    // The levels of the wires are high and floating, then high and low, then both low, then low and floating.
    assert_eq!(edges(&bench, toy, Instant::ZERO), []);
    command(&mut bench, x, JOG);
    bench.run_until(4.millis());
    bench.poke(other, test_device::Reg::Volume as usize, 1).unwrap();
    bench.run_until(5.millis());
    command(&mut bench, x, STOP);
    bench.run_until(6.millis());
    assert_eq!(edges(&bench, toy, Instant::ZERO), [(3 * 16_000 + 1, test_device::IN, false)]);
}

#[test]
fn a_wave_has_edges_only_where_a_wire_listens() {
    let mut bench = Bench::new();
    let (from, to) = (bench.add::<TestDevice>("a"), bench.add::<TestDevice>("b"));
    bench.run_until(9.millis());
    assert_eq!(bench.next(), Instant::NEVER);
    // The light is high for 1 ms of every 4 ms, from 0 on.
    for drive in [to, from] {
        bench.wire((from, test_device::LED), (drive, test_device::IN));
    }
    bench.run_until(14.millis());
    let ms = 16_000;
    let expected = [
        (9 * ms + 1, test_device::IN, false),
        (12 * ms + 1, test_device::IN, true),
        (13 * ms + 1, test_device::IN, false),
    ];
    assert_eq!(edges(&bench, to, Instant::ZERO), expected);
    assert_eq!(edges(&bench, from, Instant::ZERO), expected);
    bench.power(from, PowerAction::Off);
    bench.run_until(1.secs());
    assert_eq!(edges(&bench, to, Instant::from(14.millis())), [(1, test_device::IN, true)]);
    assert_eq!(bench.next(), Instant::NEVER);
}

#[test]
#[should_panic(expected = "a has no pin 99")]
fn a_wire_has_two_ends() {
    let mut bench = Bench::new();
    let a = bench.add::<TestDevice>("a");
    bench.wire((a, test_device::OUT), (a, Pin(99)));
}

#[test]
fn an_encoder_turns_both_ways_from_where_it_is() {
    let (mut bench, drive, _) = alone(LineMode::Fast);
    let from = bench.now();
    // Edges of 3 Hz are 5,333,333⅓ ticks apart.
    bench.encoder(drive, Encoder(0), 5, 3.0).unwrap();
    bench.run_until(from + 10.secs());
    // A leads B.
    let (a, b) = (ENCODER_A, ENCODER_B);
    assert_eq!(
        edges(&bench, drive, from),
        [
            (1, a, true),
            (5_333_334, b, true),
            (10_666_668, a, false),
            (16_000_001, b, false),
            (21_333_334, a, true),
        ]
    );
    let from = bench.now();
    assert_eq!(bench.next(), Instant::NEVER);
    bench.encoder(drive, Encoder(0), -6, 16_000.0).unwrap();
    bench.run_until(from + 1.secs());
    assert_eq!(
        edges(&bench, drive, from),
        [
            (1, a, false),
            (1_001, b, true),
            (2_001, a, true),
            (3_001, b, false),
            (4_001, a, false),
            (5_001, b, true),
        ]
    );
    assert_eq!([a, b].map(|pin| bench.level(drive, pin)), [Level::Low, Level::High]);
}

#[test]
fn one_thing_at_a_time_runs_on_a_pin() {
    let (mut bench, drive, _) = alone(LineMode::Fast);
    bench.encoder(drive, Encoder(0), 1_000, 1_000.0).unwrap();
    assert_eq!(bench.encoder(drive, Encoder(0), 1, 1.0), Err(Busy));
    assert_eq!(bench.pulse(drive, ENCODER_A, 1, 1.0), Err(Busy));
    assert_eq!(bench.pulse(drive, ENCODER_B, 1, 1.0), Err(Busy));
    // The index is on another pin, so a pulse train may run there.
    bench.pulse(drive, Pin(4), 1, 1.0).unwrap();
    let from = bench.now();
    bench.run_until(from + 10.millis());
    bench.set_pin(drive, ENCODER_B, PinStimulus::Open);
    bench.run_until(from + 2.secs());
    let turned = edges(&bench, drive, from).iter().filter(|(_, pin, _)| *pin != Pin(4)).count();
    // Ten edges come in 10 ms, the last one a rise. B falls when it is released, and no more edges come.
    assert_eq!(turned, 11);
    bench.pulse(drive, ENCODER_B, 1, 1_000.0).unwrap();
    assert_eq!(bench.encoder(drive, Encoder(0), 1, 1.0), Err(Busy));
    bench.run_until(bench.now() + 1.secs());
    bench.encoder(drive, Encoder(0), 0, 1.0).unwrap();
    assert_eq!(bench.next(), Instant::NEVER);
    // At the fastest rate there is an edge in every tick.
    let from = bench.now();
    bench.encoder(drive, Encoder(0), 4_000, 1e9).unwrap();
    bench.run_until(from + Duration::from_ticks(4_000));
    assert_eq!(edges(&bench, drive, from).len(), 4_000);
    assert_eq!(bench.next(), Instant::NEVER);
}

/// Actions on a bench of [`drives`].
#[derive(Clone, Debug)]
enum Act {
    Send(usize, Vec<u8>),
    Connect(usize),
    Disconnect(usize),
    Pin(usize, PinStimulus),
    Pulse(usize, u32, u32),
    Encoder(usize, i32, u32),
    Move(usize, i64, u16),
    Power(usize, PowerAction),
    Fault(usize, bool),
    Poke(usize, i64),
    Disturb(usize, Box<LineFaults>),
    Collide(usize, bool),
}

const NAMES: [&str; 5] = ["b", "x", "a", "y", "z"];

/// A bench of three MD3s and two test devices, added in `order`. The MD3s x and y share a line.
///
/// If `twins` is true, x and y have the same address.
fn drives(order: &[usize], line: LineMode, twins: bool) -> (Bench, [DriveId; 5], Vec<Bus>) {
    let mut bench = Bench::with(Settings { seed: 7, line, ..Settings::default() });
    let mut slots = [DriveId(0); 5];
    for &index in order {
        slots[index] = if NAMES[index] < "x" {
            let setup = Setup { presets: vec![(test_device::Reg::Volume as usize, 5)], ..Setup::default() };
            bench.add_with(NAMES[index], Box::new(TestDevice::default()), setup).unwrap()
        } else {
            let address = if twins && index == 3 { 1 } else { index as i64 };
            let presets = vec![(Reg::DeviceAddress as usize, address)];
            let setup = Setup { boot_fast: true, presets, ..Setup::default() };
            bench.add_with(NAMES[index], Box::new(Md3::new()), setup).unwrap()
        };
    }
    // The order in which ports are named makes no difference, either.
    let shared: Vec<(DriveId, Port)> =
        order.iter().filter(|&&index| index == 1 || index == 3).map(|&index| (slots[index], RS485)).collect();
    let line = bench.share("line1", &shared);
    // The wires form a ring: from the slow axis of x to y, and then through the other drives back to x.
    let [b, x, a, y, z] = slots;
    for (from, to) in [
        ((x, STEP), (y, J2_4)),
        ((x, DIR), (y, J2_5)),
        ((y, STEP), (a, test_device::IN)),
        ((y, BUSY), (z, J2_2)),
        ((a, test_device::OUT), (b, test_device::IN)),
        ((b, test_device::LED), (x, J2_2)),
        ((b, test_device::OUT), (x, J2_2)),
        ((z, STEP), (x, ENCODER_A)),
    ] {
        bench.wire(from, to);
    }
    let own = |index: usize| bench.bus(slots[index], Port(0)).unwrap();
    let buses = vec![line, own(4), own(0), own(2)];
    (bench, slots, buses)
}

/// Does `acts` on a bench of [`drives`], each after a number of ticks, and returns the trace. In between the
/// bench runs in steps of `chunks` ticks, which repeat.
fn perform(acts: &[(u64, Act)], order: &[usize], chunks: &[u64], (line, twins): (LineMode, bool)) -> String {
    let (mut bench, slots, buses) = drives(order, line, twins);
    let mut clients: Vec<Client> = buses.iter().map(|&bus| bench.connect(bus)).collect();
    let mut received = Vec::new();
    let mut at = Instant::ZERO;
    for (wait, act) in acts {
        at += Duration::from_ticks(*wait);
        for chunk in chunks.iter().cycle() {
            let next = bench.now() + Duration::from_ticks(*chunk);
            if next >= at {
                break;
            }
            bench.run_until(next);
        }
        bench.run_until(at);
        match act {
            Act::Send(n, bytes) => bench.send(clients[n % clients.len()], bytes),
            Act::Connect(n) => clients.push(bench.connect(buses[n % buses.len()])),
            Act::Disconnect(n) => bench.disconnect(clients[n % clients.len()]),
            Act::Pin(n, drive) => bench.set_pin(slots[*n], Pin(0), *drive),
            Act::Pulse(n, count, hz) => drop(bench.pulse(slots[*n], Pin(0), *count, f64::from(*hz))),
            Act::Encoder(n, counts, hz) => {
                let _ = bench.encoder(slots[*n], Encoder(0), *counts, f64::from(*hz));
            }
            Act::Move(n, steps, bits) => {
                let _ = bench.poke(slots[*n], Reg::MoveSteps as usize, *steps);
                let _ = bench.poke(slots[*n], Reg::MotionControl as usize, i64::from(*bits));
            }
            Act::Power(n, action) => bench.power(slots[*n], *action),
            Act::Fault(n, on) => bench.fault(slots[*n], Fault(0), *on),
            Act::Poke(n, value) => drop(bench.poke(slots[*n], 0, *value)),
            Act::Disturb(n, faults) => bench.set_line_faults(buses[n % buses.len()], **faults),
            Act::Collide(n, collide) => bench.set_collisions(buses[n % buses.len()], *collide),
        }
        for client in &clients {
            received.push(received_by(&mut bench, *client));
        }
    }
    // Everything ends at some time, however late replies are.
    bench.run_until_idle();
    let end = bench.now();
    assert!(end <= at + 600.secs(), "settled at {end:?} only");
    bench.run_until(end + 3.secs());
    assert!(clients.iter().all(|&client| bench.backlog(client) == 0), "a line is stuck");
    format!("{}# {received:?}\n", bench.trace().to_text())
}

fn act() -> impl Strategy<Value = Act> {
    let drive = 0..NAMES.len();
    let stimulus = prop_oneof![
        Just(PinStimulus::Low),
        Just(PinStimulus::High),
        Just(PinStimulus::Open),
        (0..5_000).prop_map(PinStimulus::Millivolts)
    ];
    let power = prop_oneof![
        Just(PowerAction::Off),
        Just(PowerAction::On),
        Just(PowerAction::Cycle),
        Just(PowerAction::Cut)
    ];
    let frame = (0_u8..6, prop_oneof![Just(3_u8), Just(6)], 0_u16..0x24, 0_u16..40).prop_map(
        |(unit, function, a, b)| {
            if function == 3 { rtu::read(unit, a, b).to_vec() } else { rtu::write(unit, a, b).to_vec() }
        },
    );
    let toys = "[rsw01]{1,4}".prop_map(String::into_bytes);
    let noise = proptest::collection::vec(any::<u8>(), 0..12);
    let half = frame.clone().prop_map(|frame| frame[..3].to_vec());
    let bytes = prop_oneof![4 => frame, 3 => toys, 1 => noise, 1 => half];
    prop_oneof![
        8 => (0..8_usize, bytes).prop_map(|(n, bytes)| Act::Send(n, bytes)),
        1 => (0..8_usize).prop_map(Act::Connect),
        1 => (0..8_usize).prop_map(Act::Disconnect),
        2 => (drive.clone(), stimulus).prop_map(|(n, stimulus)| Act::Pin(n, stimulus)),
        1 => (drive.clone(), 0_u32..5, 1_u32..10_000_000).prop_map(|(n, count, hz)| Act::Pulse(n, count, hz)),
        1 => (drive.clone(), -9..9, 1_u32..10_000_000).prop_map(|(n, counts, hz)| Act::Encoder(n, counts, hz)),
        2 => (drive.clone(), -40_i64..40, prop_oneof![4 => Just(MOVE), 1 => Just(JOG), 1 => Just(STOP)])
            .prop_map(|(n, steps, bits)| Act::Move(n, steps, bits)),
        2 => (drive.clone(), power).prop_map(|(n, power)| Act::Power(n, power)),
        1 => (drive.clone(), any::<bool>()).prop_map(|(n, on)| Act::Fault(n, on)),
        2 => (drive, 0_i64..300).prop_map(|(n, value)| Act::Poke(n, value)),
        3 => (0..8_usize, faults::any_faults())
            .prop_map(|(n, faults)| Act::Disturb(n, Box::new(faults::of_all_drives(faults)))),
        1 => (0..8_usize, any::<bool>()).prop_map(|(n, collide)| Act::Collide(n, collide)),
    ]
}

/// Acts that often happen at the same instant, so that their order matters.
fn acts() -> impl Strategy<Value = Vec<(u64, Act)>> {
    let wait = prop_oneof![3 => Just(0_u64), 2 => 0..3_u64, 2 => 0..100_000_u64, 1 => 0..5_000_000_u64];
    proptest::collection::vec((wait, act()), 1..40)
}

fn modes() -> impl Strategy<Value = (LineMode, bool)> {
    (prop_oneof![Just(LineMode::Timed), Just(LineMode::Fast)], any::<bool>())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn the_order_of_drives_changes_nothing(
        acts in acts(), order in Just([0, 1, 2, 3, 4]).prop_shuffle(), mode in modes(),
    ) {
        prop_assert_eq!(perform(&acts, &order, &[], mode), perform(&acts, &[0, 1, 2, 3, 4], &[], mode));
    }

    #[test]
    fn polling_more_often_changes_nothing(
        acts in acts(), chunks in proptest::collection::vec(200_u64..200_000, 1..9), mode in modes(),
    ) {
        let order = [0, 1, 2, 3, 4];
        prop_assert_eq!(perform(&acts, &order, &chunks, mode), perform(&acts, &order, &[], mode));
    }

    #[test]
    fn bytes_split_anywhere_are_the_same(
        cuts in proptest::collection::vec(0_usize..24, 0..6), (mode, _) in modes(),
    ) {
        let bytes: Vec<u8> = [rtu::read(1, 0, 2), rtu::write(1, 0x15, 7), rtu::read(2, 0, 1)].concat();
        let mut whole = alone(mode);
        whole.0.send(whole.2, &bytes);
        whole.0.run_until(1.secs());
        let mut cuts = cuts;
        cuts.extend([0, bytes.len()]);
        cuts.sort_unstable();
        let mut split = alone(mode);
        for part in cuts.windows(2) {
            split.0.send(split.2, &bytes[part[0]..part[1]]);
        }
        split.0.run_until(1.secs());
        prop_assert_eq!(whole.0.trace().to_text(), split.0.trace().to_text());
        prop_assert_eq!(received_by(&mut whole.0, whole.2), received_by(&mut split.0, split.2));
    }
}

proptest! {
    // Fewer cases, because each one reads a long trace three times and replays it three times.
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn a_replay_is_exact(acts in acts(), mode in modes()) {
        let text = perform(&acts, &[0, 1, 2, 3, 4], &[], mode);
        let trace = Trace::parse(&text, &make).unwrap();
        prop_assert_eq!(replay::run(&trace, &make), Ok(None));
        let again = replay::rewrite(&text, &make).unwrap();
        let trace = Trace::parse(&again, &make).unwrap();
        prop_assert_eq!(replay::run(&trace, &make), Ok(None));
        // Reading a text and writing it again gives the same text.
        let (text, _) = text.split_once("# ").unwrap();
        let trace = Trace::parse(text, &make).unwrap();
        prop_assert_eq!(trace.to_text(), text);
    }
}

/// The bench tells the drive that its power is off, and shows its registers as they were then.
#[test]
fn without_power_registers_keep_their_last_values() {
    let mut bench = Bench::new();
    let setup = Setup { boot_fast: true, ..Setup::default() };
    let drive = bench.add_with("d", Box::new(Mdrive::plus()), setup).unwrap();
    let position = bench.spec(drive).find("P").unwrap().row;
    bench.run_until(1.secs());
    let client = bench.connect_to(drive, Port(1)).unwrap();
    bench.send(client, b"SL 51200\r\n");
    bench.run_until(3.secs());
    assert!(bench.peek(drive, position) > 51_200);
    bench.power(drive, PowerAction::Off);
    bench.run_until(bench.now() + Duration::TICK);
    let last = bench.peek(drive, position);
    bench.run_until(10.secs());
    assert_eq!(bench.peek(drive, position), last);
    bench.power(drive, PowerAction::On);
    bench.run_until(11.secs());
    assert_eq!(bench.peek(drive, position), 0);
}

/// A process that runs for months may have more than 2³² clients, one after the other.
#[test]
fn numbers_of_clients_begin_again_and_spare_those_that_are_there() {
    let (mut bench, drive, first) = alone(LineMode::Timed);
    let bus = bench.bus(drive, Port(0)).unwrap();
    bench.last_client = u32::MAX - 1;
    let others = [(); 3].map(|()| bench.connect(bus));
    assert_eq!((first, others), (Client(1), [Client(u32::MAX), Client(2), Client(3)]));
}
