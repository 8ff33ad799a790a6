//! Faults of lines: what drives and clients receive of each frame, and when.

use super::*;
use crate::line::faults::{Amount, Direction, FaultRule};
use crate::record::capture::{Frame, Medium, Source};

/// A request for the address of drive 1, with 8 characters; its answer has 7.
pub(super) const ASKED: [u8; 8] = [1, 3, 0, 0, 0, 1, 0x84, 0x0A];
pub(super) const ANSWER: [u8; 7] = [1, 3, 2, 0, 1, 0x79, 0x84];
pub(super) const SEVEN: Duration = Duration::from_ticks(7 * 18_333);
pub(super) const QUIET: LineFaults = LineFaults::NONE;

/// A bench at 1 ms with MD3s at addresses 1 and 2 on one line that has these faults, and a client there.
pub(super) fn line_faults(
    line: LineMode,
    seed: u64,
    faults: LineFaults,
) -> (Bench, [DriveId; 2], Bus, Client) {
    let settings =
        Settings { seed, line, trace: Retention::All, capture: Retention::All, ..Settings::default() };
    let mut bench = Bench::with(settings);
    let slots = [md3(&mut bench, "x", 1), md3(&mut bench, "y", 2)];
    bench.run_until(start());
    let bus = bench.share("line1", &slots.map(|drive| (drive, RS485)));
    bench.set_line_faults(bus, faults);
    let client = bench.connect(bus);
    (bench, slots, bus, client)
}

/// Sends a frame, runs until the bench is idle, and returns the bytes that the client received.
fn exchange(bench: &mut Bench, client: Client, frame: &[u8]) -> Vec<u8> {
    bench.send(client, frame);
    bench.run_until_idle();
    received_by(bench, client)
}

/// The frames on the lines: start in ticks since `start()`, sender, and bytes.
fn frames(bench: &Bench) -> Vec<(u64, Source, &[u8])> {
    let frame = |frame: &'_ Frame| (frame.at.since(start()).ticks(), frame.from);
    let seen: Vec<&Frame> = bench.capture().since(0).collect();
    seen.into_iter().map(|seen| (frame(seen).0, frame(seen).1, seen.bytes.as_slice())).collect()
}

/// Time from `start()` to the start of the answer to a request that was sent at `start()`.
pub(super) fn leaves() -> Duration {
    EIGHT + T3_5 + CHARACTER
}

/// A rule from a number; small numbers cover no frame.
fn rule_of(number: u64) -> FaultRule {
    let field = |shift: u32, most: u64| (number >> shift) % most;
    let rule = match field(0, 8) {
        0..=2 => FaultRule::NONE,
        3 => FaultRule::ALL,
        4 => FaultRule::next(field(8, 4) as u32),
        _ => FaultRule::rate(field(8, 11) as f64 / 10.0),
    };
    let pick = |shift, most| Some(field(shift, most)).filter(|&choice| choice < 2);
    FaultRule {
        direction: pick(16, 4).map(|choice| [Direction::Request, Direction::Reply][choice as usize]),
        drive: pick(24, 8).map(|choice| DriveId(choice as u32)),
        function: pick(32, 8).map(|choice| [3, 6][choice as usize]),
        register: pick(40, 8).map(|choice| ["Speed", "MoveSteps"][choice as usize]),
        ..rule
    }
}

/// The same faults, without drives in the rules: their handles depend on the order of the drives.
pub(super) fn of_all_drives(mut faults: LineFaults) -> LineFaults {
    faults.delayed.drive = None;
    faults.rules().into_iter().for_each(|(_, rule)| rule.drive = None);
    faults
}

pub(super) fn any_faults() -> impl Strategy<Value = LineFaults> {
    let delay = prop_oneof![3 => Just(0_u64), 2 => 0..100_u64, 1 => Just(1_500)];
    let baud = prop_oneof![4 => Just(None), 1 => prop::sample::select(&[50, 9_600, 115_200, 4_000_000][..]).prop_map(Some)];
    let numbers = any::<[u64; 9]>();
    (numbers, any::<u8>(), delay, 0..100_u64, baud).prop_map(
        |(numbers, exception_code, delay, spread, baud)| {
            let (delay, delay_spread) = (Duration::millis(delay), Duration::millis(spread / 50 * spread));
            let rules = numbers.map(rule_of);
            let mute = if numbers[7] % 10 == 0 { rules[7] } else { FaultRule::NONE };
            let mut faults = LineFaults {
                exception_code,
                delay,
                delay_spread,
                delayed: if numbers[8] % 2 == 0 { FaultRule::ALL } else { rules[8] },
                baud,
                ..LineFaults::NONE
            };
            for ((_, rule), some) in faults.rules().into_iter().zip(rules).take(7) {
                *rule = some;
            }
            LineFaults { mute, ..faults }
        },
    )
}

#[test]
fn an_undisturbed_line_is_as_it_is() {
    let (mut bench, [x, _], bus, client) = line_faults(LineMode::Timed, 1, QUIET);
    assert_eq!(bench.line_faults(bus), LineFaults::default());
    assert_eq!(exchange(&mut bench, client, &ASKED), ANSWER);
    let answer = leaves().ticks();
    assert_eq!(frames(&bench), [(0, Source::Client, &ASKED[..]), (answer, Source::Drive(x), &ANSWER[..])]);
    let frame = bench.capture().since(1).next().unwrap();
    let line = frame.line.unwrap().to_string();
    assert_eq!((frame.on, frame.lasts, line), (Medium::Line(bus), SEVEN, "9600 8E1".to_owned()));
}

#[test]
fn a_lost_request_is_over_when_it_would_be_judged() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, [x, _], _, client) =
            line_faults(line, 1, LineFaults { drop: FaultRule::rate(1.0), ..QUIET });
        assert_eq!(exchange(&mut bench, client, &ASKED), [0; 0]);
        if line == LineMode::Timed {
            assert_eq!(bench.now(), start() + EIGHT + T3_5 + CHARACTER);
        }
        assert_eq!(bench.statistics(x, RS485), Statistics::default());
        assert_eq!((stamps(&bench, "> rx").len(), frames(&bench).len()), (0, 0));
    }
}

#[test]
fn a_muted_reply_takes_its_time() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, [x, y], bus, client) =
            line_faults(line, 1, LineFaults { mute: FaultRule::ALL, ..QUIET });
        assert_eq!(exchange(&mut bench, client, &ASKED), [0; 0]);
        if line == LineMode::Timed {
            assert_eq!(bench.now(), start() + leaves() + SEVEN);
        }
        assert_eq!((bench.statistics(x, RS485).requests, stamps(&bench, "< tx").len()), (1, 1));
        assert_eq!(frames(&bench), [(0, Source::Client, &ASKED[..])]);
        // The other drive does not receive the reply, either: it has received only the request.
        bench.run_until(1.secs());
        assert_eq!(bench.statistics(y, RS485).foreign, 1);
        bench.set_line_faults(bus, QUIET);
        assert_eq!(exchange(&mut bench, client, &ASKED), ANSWER);
    }
}

#[test]
fn a_bit_that_turns_over_is_a_wrong_parity_or_a_wrong_check_sum() {
    // Serial settings (7.22): 9,600 baud, one stop bit, and even or no parity.
    for (configuration, count) in [(0x21, (1, 0)), (0x01, (0, 1))] {
        for seed in 0..50 {
            let mut bench = Bench::with(Settings { seed, capture: Retention::All, ..Settings::default() });
            let presets = vec![(Reg::SerialPortConfiguration as usize, configuration)];
            let setup = Setup { boot_fast: true, presets, ..Setup::default() };
            let x = bench.add_with("x", Box::new(Md3::new()), setup).unwrap();
            bench.run_until(start());
            let bus = bench.bus(x, RS485).unwrap();
            bench.set_line_faults(bus, LineFaults { corrupt: FaultRule::rate(1.0), ..QUIET });
            assert_eq!(bench.ask(x, &ASKED), [0; 0]);
            let Statistics { spoiled, crc, .. } = bench.statistics(x, RS485);
            assert_eq!((spoiled, crc), count);
            let seen = &frames(&bench)[0];
            let turned: u32 = seen.2.iter().zip(ASKED).map(|(seen, sent)| (seen ^ sent).count_ones()).sum();
            assert_eq!((seen.2.len(), turned), (8, 1));
            // A reply reaches a client with the wrong bit, because a pty or TCP has no parity.
            bench.set_line_faults(bus, QUIET);
            let client = bench.connect(bus);
            bench.send(client, &ASKED);
            bench.set_line_faults(bus, LineFaults { corrupt: FaultRule::rate(1.0), ..QUIET });
            bench.run_until_idle();
            let received = received_by(&mut bench, client);
            let turned: u32 =
                received.iter().zip(ANSWER).map(|(received, sent)| (received ^ sent).count_ones()).sum();
            assert_eq!((received.len(), turned), (7, 1));
        }
    }
}

#[test]
fn a_frame_without_its_end_takes_all_its_time() {
    let mut lengths = [0; 8];
    for seed in 0..200 {
        let (mut bench, [x, _], _, client) =
            line_faults(LineMode::Timed, seed, LineFaults { truncate: FaultRule::rate(1.0), ..QUIET });
        assert_eq!(exchange(&mut bench, client, &ASKED), [0; 0]);
        assert_eq!(bench.now(), start() + EIGHT + T3_5 + CHARACTER);
        let seen = frames(&bench);
        assert_eq!(seen.len(), 1);
        assert!(ASKED.starts_with(seen[0].2));
        lengths[seen[0].2.len()] += 1;
        assert_eq!(bench.statistics(x, RS485).requests, 0);
        assert_eq!(bench.statistics(x, RS485).dropped(), 1);
    }
    assert_eq!(lengths[0], 0);
    assert!(lengths[1..].iter().all(|&count| count > 0), "{lengths:?}");
}

#[test]
fn what_comes_twice_comes_again_behind_silence() {
    let (mut bench, [x, _], _, client) =
        line_faults(LineMode::Timed, 1, LineFaults { duplicate: FaultRule::rate(1.0), ..QUIET });
    let write = rtu::write(1, 0x15, 7);
    let received = exchange(&mut bench, client, &write);
    assert_eq!(received, write.repeat(4), "the answer to a write is the write");
    assert_eq!(bench.statistics(x, RS485).requests, 2);
    // Request, answer, answer, then the same again. Each comes after t3.5, except for the turnaround time of
    // the drive.
    let round = leaves() + EIGHT + T3_5 + EIGHT + T3_5;
    let once = [Duration::ZERO, leaves(), leaves() + EIGHT + T3_5];
    let expected: Vec<u64> = once.iter().chain(&once.map(|at| at + round)).map(|at| at.ticks()).collect();
    assert_eq!(frames(&bench).iter().map(|frame| frame.0).collect::<Vec<_>>(), expected);
    assert_eq!(bench.now(), start() + round + round - T3_5);
    // Clients that wait for the line wait for the repetitions, too.
    let (mut bench, _, bus, client) =
        line_faults(LineMode::Timed, 1, LineFaults { duplicate: FaultRule::rate(1.0), ..QUIET });
    let other = bench.connect(bus);
    bench.send(client, &write);
    bench.send(other, &rtu::read(2, 0, 1));
    bench.run_until_idle();
    assert_eq!(frames(&bench)[6].0, (round + round).ticks());
    assert_eq!(received_by(&mut bench, client).len(), 4 * 8 + 4 * 7);
}

#[test]
fn what_comes_twice_comes_twice_where_characters_take_no_time() {
    let (mut bench, [x, _], _, client) =
        line_faults(LineMode::Fast, 1, LineFaults { duplicate: FaultRule::rate(1.0), ..QUIET });
    let write = rtu::write(1, 0x15, 7);
    assert_eq!(exchange(&mut bench, client, &write), write.repeat(4));
    assert_eq!(bench.statistics(x, RS485).requests, 2);
    assert!(bench.now() <= start() + 10.micros());
}

#[test]
fn a_wrong_address_is_one_that_no_drive_of_the_line_has() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, _, _, client) =
            line_faults(line, 1, LineFaults { wrong_address: FaultRule::rate(1.0), ..QUIET });
        let answer = exchange(&mut bench, client, &ASKED);
        // Address 2 is in use.
        assert_eq!(rtu::verify_crc(&answer), Some(&[3, 3, 2, 0, 1][..]));
    }
    let mut bench = Bench::new();
    let x = md3(&mut bench, "x", 247);
    bench.run_until(start());
    bench.set_line_faults(
        bench.bus(x, RS485).unwrap(),
        LineFaults { wrong_address: FaultRule::rate(1.0), ..QUIET },
    );
    assert_eq!(bench.ask(x, &rtu::read(247, 0, 1))[0], 1);
}

#[test]
fn a_refused_request_is_not_carried_out() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let faults = LineFaults { exception: FaultRule::rate(1.0), exception_code: 6, ..QUIET };
        let (mut bench, [x, _], bus, client) = line_faults(line, 1, faults);
        let write = rtu::write(1, 0x15, 7);
        let answer = exchange(&mut bench, client, &write);
        assert_eq!(rtu::verify_crc(&answer), Some(&[1, 0x86, 6][..]));
        assert_eq!(bench.peek(x, Reg::Speed as usize), 5_000);
        if line == LineMode::Timed {
            // The exchange takes as long as a normal request and an exception.
            assert_eq!(bench.now(), start() + leaves() + CHARACTER * 5);
        }
        // The capture shows the write and the exception. No drive has received the write.
        assert_eq!(frames(&bench).iter().map(|frame| frame.2).collect::<Vec<_>>(), [&write[..], &answer]);
        assert_eq!(bench.trace().to_text().lines().filter(|line| line.contains("x > rx")).count(), 0);
        assert_eq!(bench.statistics(x, RS485), Statistics::default());
        let entries: Vec<String> = bench.received(x).messages().map(|entry| entry.to_string()).collect();
        assert_eq!(entries, ["rs485 <- write SpeedLow = 7 -> refused: by a fault (06)"]);
        // A broadcast has no answer, so it is executed.
        assert_eq!(exchange(&mut bench, client, &rtu::write(0, 0x15, 7)), [0; 0]);
        assert_eq!(bench.peek(x, Reg::Speed as usize), 7);
        // Exceptions of the drive itself stay unchanged.
        bench.set_line_faults(bus, QUIET);
        let answer = exchange(&mut bench, client, &rtu::frame(1, &[110, 0]));
        assert_eq!(rtu::verify_crc(&answer), Some(&[1, 0x80 | 110, 1][..]));
    }
}

#[test]
fn an_exception_that_there_is_not_acts_as_the_nearest() {
    let faults = LineFaults { exception: FaultRule::rate(1.0), exception_code: 0, ..QUIET };
    let (mut bench, _, _, client) = line_faults(LineMode::Timed, 1, faults);
    assert_eq!(rtu::verify_crc(&exchange(&mut bench, client, &ASKED)), Some(&[1, 0x83, 1][..]));
}

#[test]
fn a_late_reply_occupies_the_line_later() {
    let delay = Duration::millis(5);
    let (mut bench, [x, y], _, client) = line_faults(LineMode::Timed, 1, LineFaults { delay, ..QUIET });
    bench.send(client, &[ASKED, ASKED].concat());
    bench.run_until(start() + leaves() + delay + CHARACTER - Duration::TICK);
    assert_eq!(received_by(&mut bench, client), [0; 0]);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, client), ANSWER.repeat(2));
    let round = leaves() + delay + SEVEN + T3_5;
    let expected = [Duration::ZERO, leaves() + delay, round, round + leaves() + delay];
    assert_eq!(frames(&bench).iter().map(|frame| frame.0).collect::<Vec<_>>(), expected.map(Duration::ticks));
    assert_eq!(bench.now(), start() + round * 2 - T3_5);
    bench.run_until(1.secs());
    assert_eq!((bench.statistics(x, RS485).requests, bench.statistics(y, RS485).foreign), (2, 4));

    let (mut bench, _, _, client) = line_faults(LineMode::Fast, 1, LineFaults { delay, ..QUIET });
    assert_eq!(exchange(&mut bench, client, &ASKED), ANSWER);
    assert!(bench.now().since(start() + delay) <= Duration::TICK, "{:?}", bench.now());
}

#[test]
fn a_late_reply_still_comes_when_its_drive_has_lost_power() {
    let delay = Duration::millis(100);
    let (mut bench, [x, _], _, client) = line_faults(LineMode::Timed, 1, LineFaults { delay, ..QUIET });
    bench.send(client, &ASKED);
    // Three characters have left by then, and arrive 100 ms later.
    bench.run_until(start() + leaves() + CHARACTER * 3);
    bench.power(x, PowerAction::Off);
    bench.run_until(1.secs());
    assert_eq!(received_by(&mut bench, client), ANSWER[..3]);
}

#[test]
fn a_late_reply_that_has_been_transmitted_comes_whole() {
    let delay = Duration::millis(100);
    let (mut bench, [x, _], _, client) = line_faults(LineMode::Timed, 1, LineFaults { delay, ..QUIET });
    bench.send(client, &ASKED);
    bench.run_until(start() + leaves() + SEVEN);
    bench.power(x, PowerAction::Off);
    bench.run_until(start() + leaves() + SEVEN + delay - Duration::TICK);
    assert_eq!(received_by(&mut bench, client), ANSWER[..6]);
    bench.run_until(1.secs());
    assert_eq!(received_by(&mut bench, client), ANSWER[6..]);
}

#[test]
fn power_that_fails_during_a_reply_does_not_cut_a_late_one_before_it() {
    let mut bench = Bench::with(Settings { trace: Retention::All, ..Settings::default() });
    let toy = bench.add::<TestDevice>("t");
    let bus = bench.bus(toy, test_device::USB).unwrap();
    let client = bench.connect(bus);
    let faults = LineFaults { delay: Duration::millis(100), delayed: FaultRule::next(1), ..QUIET };
    bench.set_line_faults(bus, faults);
    // Each answer of three characters leaves before the next request; only the first one is late.
    let mut sent = Instant::ZERO;
    for answers in 1..=2 {
        bench.send(client, b"r");
        while stamps(&bench, "< tx").len() < answers {
            sent = bench.next();
            bench.run_until(sent);
        }
        if answers == 1 {
            bench.run_until(sent + 20.millis());
        }
    }
    let character = bench.line(bus).character();
    bench.run_until(sent + character);
    let begin = stamps(&bench, "< tx").pop().unwrap().parse::<f64>().unwrap();
    let transmitted = (bench.now().ticks() as f64 / 16_000.0 - begin) / (character.ticks() as f64 / 16_000.0);
    bench.power(toy, PowerAction::Off);
    bench.run_until(1.secs());
    let received = received_by(&mut bench, client);
    assert!((0.0..3.0).contains(&transmitted), "{transmitted}");
    assert_eq!(received.len(), 3 + transmitted.round() as usize, "{received:?}");
}

#[test]
fn a_power_failure_cuts_only_the_output_of_its_drive() {
    // Two drives with one address answer at the same time, and one of them loses power.
    let (mut bench, [x, y], _, client) = line_faults(LineMode::Timed, 1, QUIET);
    bench.poke(y, Reg::DeviceAddress as usize, 1).unwrap();
    bench.send(client, &ASKED);
    bench.run_until(start() + leaves() + CHARACTER * 3);
    bench.power(x, PowerAction::Off);
    bench.run_until_idle();
    assert_eq!(
        bench.now(),
        start() + leaves() + SEVEN,
        "the line is that of the other one until it has answered"
    );
    let twice = ANSWER[..3].iter().flat_map(|&byte| [byte, byte]);
    assert_eq!(received_by(&mut bench, client), twice.chain(ANSWER[3..].iter().copied()).collect::<Vec<_>>());

    // The noise after an answer still reaches all clients.
    let (mut bench, [x, _], _, client) =
        line_faults(LineMode::Timed, 1, LineFaults { noise: FaultRule::rate(1.0), ..QUIET });
    bench.send(client, &ASKED);
    bench.run_until(start() + leaves() + CHARACTER * 3);
    bench.power(x, PowerAction::Off);
    bench.run_until_idle();
    let received = received_by(&mut bench, client);
    let answered: Vec<u8> = frames(&bench)[1..].iter().flat_map(|frame| frame.2).copied().collect();
    assert_eq!(received[..3], ANSWER[..3]);
    assert_eq!((received, frames(&bench).len()), (answered, 4));
}

#[test]
fn noise_comes_behind_frames_and_spoils_none() {
    let faults = LineFaults { noise: FaultRule::rate(1.0), ..QUIET };
    let (mut bench, [x, _], _, client) = line_faults(LineMode::Timed, 1, faults);
    let received = exchange(&mut bench, client, &ASKED);
    let seen = frames(&bench);
    let [
        (0, Source::Client, _),
        (answer, Source::Drive(_), b),
        (first, Source::Noise, c),
        (second, Source::Noise, d),
    ] = seen[..]
    else {
        panic!("{seen:?}");
    };
    assert_eq!(received, [b, c, d].concat());
    assert_eq!((answer, first), (leaves().ticks(), (leaves() + SEVEN + T3_5).ticks()));
    assert!((1..=8).contains(&c.len()) && (1..=8).contains(&d.len()));
    // The noise after the answer comes first, then the noise after the request.
    assert_eq!(second, first + (CHARACTER * c.len() as u64 + T3_5).ticks());
    for _ in 0..100 {
        bench.send(client, &ASKED);
        bench.run_until_idle();
        let received = received_by(&mut bench, client);
        assert_eq!(received[..7], ANSWER);
    }
    let statistics = bench.statistics(x, RS485);
    assert_eq!(statistics.requests, 101);
    assert!(statistics.dropped() > 150, "the drives hear it, too: {statistics:?}");
    assert!(statistics.spoiled > 50 && statistics.crc > 20, "{statistics:?}");
}

#[test]
fn another_baud_rate_is_garbage_both_ways() {
    let faults = LineFaults { baud: Some(4_800), ..QUIET };
    let (mut bench, [x, _], bus, client) = line_faults(LineMode::Timed, 1, faults);
    assert_eq!(exchange(&mut bench, client, &ASKED), [0; 0]);
    assert_eq!(bench.statistics(x, RS485).spoiled, 1);
    let frame = bench.capture().since(0).next().unwrap();
    // A character of 11 bits takes 2,291.67 µs at 4,800 baud.
    assert_eq!((frame.line.unwrap().baud, frame.lasts), (4_800, Duration::from_ticks(8 * 36_667)));
    // In the time of seven characters, a receiver at half the rate reads three characters.
    bench.set_line_faults(bus, QUIET);
    bench.send(client, &ASKED);
    bench.set_line_faults(bus, faults);
    bench.run_until_idle();
    let received = received_by(&mut bench, client);
    assert_eq!(received.len(), 3);
    assert_ne!(received, ANSWER[..3]);
    bench.set_line_faults(bus, LineFaults { baud: Some(9_600), ..QUIET });
    assert_eq!(exchange(&mut bench, client, &ASKED), ANSWER);
}

#[test]
fn characters_are_disturbed_by_what_was_written_at_once() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let mut bench = Bench::with(Settings { line, capture: Retention::All, ..Settings::default() });
        let toy = bench.add::<TestDevice>("t");
        let bus = bench.bus(toy, test_device::USB).unwrap();
        let client = bench.connect(bus);
        bench.set_line_faults(bus, LineFaults { drop: FaultRule::rate(1.0), ..QUIET });
        assert_eq!(exchange(&mut bench, client, b"rrr"), [0; 0]);
        assert_eq!(bench.backlog(client), 0);
        bench.set_line_faults(bus, LineFaults { duplicate: FaultRule::rate(1.0), ..QUIET });
        // Two requests arrive, and each answer of three characters is sent twice.
        assert_eq!(exchange(&mut bench, client, b"r").len(), 12);
        bench.set_line_faults(bus, LineFaults { truncate: FaultRule::rate(1.0), ..QUIET });
        bench.send(client, b"10");
        bench.run_until_idle();
        assert_eq!(bench.level(toy, test_device::OUT), Level::High, "the 1 was heard, and the 0 was not");
        bench.set_line_faults(
            bus,
            LineFaults {
                mute: FaultRule::ALL,
                wrong_address: FaultRule::rate(1.0),
                exception: FaultRule::rate(1.0),
                ..QUIET
            },
        );
        assert_eq!(exchange(&mut bench, client, b"0r"), [0; 0]);
        assert_eq!(bench.level(toy, test_device::OUT), Level::Low);
        bench.set_line_faults(
            bus,
            LineFaults { wrong_address: FaultRule::rate(1.0), exception: FaultRule::rate(1.0), ..QUIET },
        );
        assert_eq!(exchange(&mut bench, client, b"r").len(), 3);
        let before = bench.capture().seen();
        bench.set_line_faults(bus, LineFaults { noise: FaultRule::rate(1.0), ..QUIET });
        bench.send(client, b"x");
        bench.run_until_idle();
        let noise = bench.capture().since(before).filter(|frame| frame.from == Source::Noise).count();
        assert!((1..=8).contains(&noise), "{noise}");
    }
}

#[test]
fn a_stream_that_comes_twice_does_not_pile_up() {
    let mut bench = Bench::new();
    let toy = bench.add::<TestDevice>("t");
    let bus = bench.bus(toy, test_device::USB).unwrap();
    let client = bench.connect(bus);
    bench.send(client, b"s");
    bench.set_line_faults(
        bus,
        LineFaults {
            duplicate: FaultRule::rate(1.0),
            noise: FaultRule::rate(1.0),
            delay: Duration::millis(7),
            ..QUIET
        },
    );
    // A copy and the noise after it would each take 1.75 ms, but the next output comes after 3 ms, so there
    // is no room.
    bench.run_until(20.secs());
    let dots = received_by(&mut bench, client).iter().filter(|&&byte| byte == b'.').count();
    assert!((6_450..13_300).contains(&dots), "{dots}");
    bench.set_line_faults(bus, QUIET);
    bench.send(client, b"s");
    bench.run_until(Instant::from(20.secs()) + 520.millis());
    received_by(&mut bench, client);
    assert_eq!(bench.next(), Instant::NEVER, "half a second late at most");
}

#[test]
fn shares_are_what_they_say() {
    // 10,000 frames, with a tolerance of 4 σ = 4·√(n·p·(1 − p)). An exchange has an answer if neither of its
    // two frames is lost.
    let (mut bench, [x, _], _, client) =
        line_faults(LineMode::Fast, 1, LineFaults { drop: FaultRule::rate(0.3), ..QUIET });
    let answers = (0..10_000).filter(|_| !exchange(&mut bench, client, &ASKED).is_empty()).count();
    assert!(bench.statistics(x, RS485).requests.abs_diff(7_000) < 184);
    assert!(answers.abs_diff(4_900) < 200, "{answers}");

    let faults = LineFaults { wrong_address: FaultRule::rate(0.2), exception: FaultRule::rate(0.1), ..QUIET };
    let (mut bench, [x, _], _, client) = line_faults(LineMode::Fast, 1, faults);
    let answers: Vec<Vec<u8>> = (0..10_000).map(|_| exchange(&mut bench, client, &ASKED)).collect();
    let refused = answers.iter().filter(|answer| answer[1] == 0x83).count();
    let elsewhere = answers.iter().filter(|answer| answer[0] != 1).count();
    assert!(refused.abs_diff(1_000) < 120 && elsewhere.abs_diff(2_000) < 160, "{refused} {elsewhere}");
    assert_eq!(bench.statistics(x, RS485).requests, 10_000 - refused as u64);

    for (name, faults, ours) in [
        ("corrupt", LineFaults { corrupt: FaultRule::rate(0.25), ..QUIET }, 0.25),
        ("truncate", LineFaults { truncate: FaultRule::rate(0.05), ..QUIET }, 0.05),
    ] {
        let (mut bench, [x, _], _, client) = line_faults(LineMode::Fast, 1, faults);
        for _ in 0..10_000 {
            exchange(&mut bench, client, &ASKED);
        }
        let good = bench.statistics(x, RS485).requests as f64;
        let sigma = f64::sqrt(10_000.0 * ours * (1.0 - ours));
        assert!((good - 10_000.0 * (1.0 - ours)).abs() < 4.0 * sigma, "{name}: {good}");
    }
    for faults in [
        LineFaults { duplicate: FaultRule::rate(0.15), ..QUIET },
        LineFaults { noise: FaultRule::rate(0.15), ..QUIET },
    ] {
        let (mut bench, _, _, client) = line_faults(LineMode::Fast, 1, faults);
        let silent = rtu::write(0, 0x15, 1);
        for _ in 0..10_000 {
            exchange(&mut bench, client, &silent);
        }
        let more = frames(&bench).len() - 10_000;
        assert!(more.abs_diff(1_500) < 143, "{more}");
    }
}

/// Returns true if a drive answers a request.
fn is_answered(bench: &mut Bench, client: Client) -> bool {
    let before = bench.capture().seen();
    exchange(bench, client, &ASKED);
    bench.capture().since(before).any(|frame| matches!(frame.from, Source::Drive(_)))
}

/// Sends 300 requests. Returns true for each one that is answered, and the capture and trace of all of them.
fn answered(seed: u64, faults: LineFaults) -> (Vec<bool>, String) {
    let (mut bench, _, _, client) = line_faults(LineMode::Fast, seed, faults);
    let answered = (0..300).map(|_| is_answered(&mut bench, client)).collect();
    (answered, format!("{:?}{}", frames(&bench), bench.trace().to_text()))
}

#[test]
fn the_same_seed_is_the_same_chance() {
    let some = LineFaults {
        drop: FaultRule::rate(0.2),
        corrupt: FaultRule::rate(0.1),
        noise: FaultRule::rate(0.3),
        duplicate: FaultRule::rate(0.1),
        truncate: FaultRule::rate(0.1),
        ..QUIET
    };
    let (received, seen) = answered(5, some);
    assert_eq!(answered(5, some), (received.clone(), seen));
    assert_ne!(answered(6, some).0, received);
}

/// True for each of 300 requests that reaches the line.
fn sent(faults: LineFaults) -> Vec<bool> {
    let (mut bench, _, _, client) = line_faults(LineMode::Fast, 5, faults);
    let reaches = |bench: &mut Bench| {
        let before = bench.capture().seen();
        exchange(bench, client, &ASKED);
        bench.capture().since(before).any(|frame| frame.from == Source::Client)
    };
    (0..300).map(|_| reaches(&mut bench)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn no_fault_moves_what_another_one_does_to_requests(faults in any_faults()) {
        let reached = sent(LineFaults { drop: FaultRule::rate(0.2), ..QUIET });
        prop_assert!((30..90).contains(&reached.iter().filter(|reached| !**reached).count()));
        prop_assert_eq!(sent(LineFaults { drop: FaultRule::rate(0.2), ..faults }), reached);
    }
}

/// The random choices for a reply depend on its number, so a fault that removes or adds replies changes the
/// choices for the following ones.
#[test]
fn as_long_as_as_many_answer_no_fault_moves_what_another_one_does_to_replies() {
    let (received, _) = answered(5, LineFaults { drop: FaultRule::rate(0.2), ..QUIET });
    let more = LineFaults { wrong_address: FaultRule::rate(0.5), exception: FaultRule::rate(0.3), ..QUIET };
    for other in [
        more,
        LineFaults { noise: FaultRule::rate(1.0), ..more },
        LineFaults { delay: Duration::millis(1), ..more },
    ] {
        assert_eq!(answered(5, LineFaults { drop: FaultRule::rate(0.2), ..other }).0, received);
    }
}

#[test]
fn chances_go_by_the_number_of_a_frame() {
    // Broadcasts are used because they have no replies.
    let lost = |from: usize| {
        let (mut bench, [x, _], bus, client) = line_faults(LineMode::Fast, 5, QUIET);
        let mut lost = Vec::new();
        for n in 0..300 {
            if n == from {
                bench.set_line_faults(bus, LineFaults { drop: FaultRule::rate(0.2), ..QUIET });
            }
            let before = bench.statistics(x, RS485).requests;
            exchange(&mut bench, client, &rtu::write(0, 0x15, 1));
            if bench.statistics(x, RS485).requests == before {
                lost.push(n);
            }
        }
        lost
    };
    let all = lost(0);
    assert!(all.len() > 30 && all[0] < 100, "{all:?}");
    let later: Vec<usize> = all.iter().copied().filter(|&n| n >= 100).collect();
    assert_eq!(lost(100), later, "quiet frames count, too");
}

#[test]
fn a_retry_loop_gets_every_answer_at_last() {
    let (mut bench, _, _, client) = line_faults(
        LineMode::Timed,
        1,
        LineFaults { drop: FaultRule::rate(0.3), corrupt: FaultRule::rate(0.1), ..QUIET },
    );
    let mut tries = 0;
    for value in 0..200_u16 {
        let write = rtu::write(1, 0x15, value);
        loop {
            tries += 1;
            if exchange(&mut bench, client, &write) == write.as_slice() {
                break;
            }
        }
    }
    // The expected number of tries is 200 / (0.7·0.9)² = 504.
    assert!((400..620).contains(&tries), "{tries}");
}

#[test]
fn a_disturbed_trace_replays_without_its_faults() {
    let faults = LineFaults {
        drop: FaultRule::rate(0.1),
        corrupt: FaultRule::rate(0.1),
        duplicate: FaultRule::rate(0.2),
        truncate: FaultRule::rate(0.1),
        exception: FaultRule::rate(0.2),
        noise: FaultRule::rate(0.3),
        ..QUIET
    };
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, _, _, client) =
            line_faults(line, 3, LineFaults { delay: Duration::millis(3), ..faults });
        for value in 0..100 {
            exchange(&mut bench, client, &rtu::write(1 + (value % 2) as u8, 0x15, value));
        }
        let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
        assert_eq!(replay::run(&trace, &make), Ok(None));
    }
}

/// In recordings of versions before BENCH-12 was changed, a drive refuses function 110 in place of the request.
#[test]
fn an_old_recording_of_a_forced_exception_replays() {
    let (mut bench, _, _, client) = line_faults(LineMode::Timed, 1, QUIET);
    let refused = rtu::frame(1, &[0x80 | 110, 1]);
    assert_eq!(exchange(&mut bench, client, &rtu::frame(1, &[110, 0, 0x15, 0, 7])), refused[..]);
    let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}

/// A bench at 1 ms with MD3s on a line where characters may collide, and two clients there.
fn colliding<const N: usize>(addresses: [i64; N]) -> (Bench, [DriveId; N], [Client; 2]) {
    let mut bench = Bench::with(Settings { capture: Retention::All, ..Settings::default() });
    let mut names = ["x", "y", "z"].into_iter();
    let slots = addresses.map(|address| md3(&mut bench, names.next().unwrap(), address));
    bench.run_until(start());
    let bus = bench.share("line1", &slots.map(|drive| (drive, RS485)));
    bench.set_collisions(bus, true);
    let clients = [bench.connect(bus), bench.connect(bus)];
    (bench, slots, clients)
}

#[test]
fn two_clients_that_speak_at_once_spoil_each_other() {
    let (mut bench, [x, _], [a, b]) = colliding([1, 2]);
    bench.send(a, &ASKED);
    // Client b sends in the middle of the third character of client a.
    let into = CHARACTER * 2 + Duration::from_ticks(9_000);
    bench.run_until(start() + into);
    bench.send(b, &ASKED);
    bench.run_until_idle();
    assert_eq!((received_by(&mut bench, a), received_by(&mut bench, b)), (vec![], vec![]));
    // Characters 1 and 2 of a, then characters of both, then of b alone: drives see one frame, which is
    // spoiled.
    let all = EIGHT + into;
    assert_eq!(bench.now(), start() + all + T3_5 + CHARACTER);
    assert_eq!(bench.statistics(x, RS485), Statistics { spoiled: 1, ..Statistics::default() });
    // Six characters of a and the first six of b are spoiled; b's last two are valid.
    assert_eq!(stamps(&bench, "x > spoiled").len(), 12, "{}", bench.trace().to_text());
    // Afterwards the line works as before.
    bench.send(a, &ASKED);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, b), ANSWER);
    assert_eq!(collided(&bench), [true, true, false, false]);
}

#[test]
fn a_client_that_sends_during_an_answer_corrupts_it() {
    let (mut bench, [x, y], [a, b]) = colliding([1, 2]);
    bench.send(a, &ASKED);
    // Client b sends at the end of the second character of the answer.
    bench.run_until(start() + leaves() + CHARACTER * 2);
    bench.send(b, &rtu::read(2, 0, 1));
    bench.run_until_idle();
    let received = received_by(&mut bench, a);
    assert_eq!((&received[..2], received.len()), (&ANSWER[..2], 7));
    for (index, (received, sent)) in received.iter().zip(ANSWER).enumerate().skip(2) {
        assert_ne!(*received, sent, "character {index}");
    }
    assert_eq!(received_by(&mut bench, b), received);
    // The request was valid; the answer and the request that was sent during it are corrupt.
    assert_eq!(collided(&bench), [false, true, true]);
    // A sender does not receive; the other drive receives corrupt characters.
    assert_eq!((bench.statistics(x, RS485).requests, bench.statistics(y, RS485).requests), (1, 0));
    bench.run_until(1.secs());
    assert_eq!(bench.statistics(y, RS485).spoiled, 1);
}

/// A value for each frame on the lines: true if the frame has collided.
fn collided(bench: &Bench) -> Vec<bool> {
    bench.capture().since(0).map(|frame| frame.collided).collect()
}

/// Checks that drives with the same address answer at the same time, and that none of their characters is
/// valid.
fn answer_at_once<const N: usize>() {
    let (mut bench, slots, [a, b]) = colliding([1; N]);
    bench.send(a, &ASKED);
    bench.run_until_idle();
    let received = received_by(&mut bench, a);
    assert_eq!(received.len(), ANSWER.len() * N);
    assert!(!received.chunks(N).zip(ANSWER).any(|(all, sent)| all.contains(&sent)), "{received:02X?}");
    assert_eq!(received_by(&mut bench, b), received);
    assert_eq!(collided(&bench), [&[false][..], &[true; N]].concat());
    assert!(slots.iter().all(|&drive| bench.statistics(drive, RS485).requests == 1));
}

#[test]
fn drives_that_answer_at_once_spoil_each_other() {
    answer_at_once::<2>();
    answer_at_once::<3>();
}

#[test]
fn on_a_colliding_line_a_client_waits_for_its_own_answers() {
    let (mut bench, [x, _], [a, b]) = colliding([1, 2]);
    bench.send(a, &ASKED.repeat(3));
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, a), ANSWER.repeat(3));
    // A partial frame of another client is not on the line before its frame timeout, and does not delay a.
    bench.send(b, &ASKED[..3]);
    bench.send(a, &ASKED);
    bench.run_until(bench.now() + 60.millis());
    assert_eq!(received_by(&mut bench, a), ANSWER);
    assert_eq!(bench.statistics(x, RS485), Statistics { requests: 4, crc: 1, ..Statistics::default() });
    // Without collisions the clients wait for each other.
    let bus = bench.find_bus("line1").unwrap();
    bench.set_collisions(bus, false);
    bench.run_until(1.secs());
    bench.send(a, &ASKED);
    bench.send(b, &ASKED);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, b)[28..], ANSWER.repeat(2));
}

#[test]
fn a_turn_on_a_colliding_line_lasts_as_long_as_the_longest_in_it() {
    let (mut bench, [x, y], [a, b]) = colliding([1, 2]);
    // The answer for 16 registers has 37 characters; b sends during its first characters.
    bench.send(a, &rtu::read(1, 0, 16));
    bench.run_until(start() + leaves() + CHARACTER);
    bench.send(b, &rtu::read(2, 0, 1));
    bench.run_until_idle();
    assert_eq!(bench.now(), start() + leaves() + CHARACTER * 37);
    let received = received_by(&mut bench, b);
    let sound = rtu::frame(1, &[&[3, 32][..], &[0; 32]].concat()).len();
    assert_eq!(received.len(), sound);
    // Only characters 2 to 9 are spoiled.
    bench.send(a, &rtu::read(1, 0, 16));
    bench.run_until_idle();
    let clean = received_by(&mut bench, b);
    let spoiled: Vec<usize> = (0..37).filter(|&index| received[index] != clean[index]).collect();
    assert_eq!(spoiled, [1, 2, 3, 4, 5, 6, 7, 8]);
    assert_eq!((bench.statistics(x, RS485).requests, bench.statistics(y, RS485).requests), (2, 0));
}

/// Write 7 to the low word of Speed, 0x15 of an MD3 (7.17).
fn write(unit: u8) -> Vec<u8> {
    rtu::write(unit, 0x15, 7).to_vec()
}

#[test]
fn a_count_disturbs_the_next_frames_and_then_none() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, _, bus, client) =
            line_faults(line, 1, LineFaults { drop: FaultRule::next(2), ..QUIET });
        // Without a direction a request is a frame, and a reply is one.
        for (left, answer) in [(1, &[][..]), (0, &[]), (0, &ANSWER), (0, &ANSWER)] {
            assert_eq!(exchange(&mut bench, client, &ASKED), answer);
            assert_eq!(bench.line_faults(bus).drop, FaultRule::next(left));
        }
        let lost = FaultRule::next(1).direction(Direction::Reply);
        bench.set_line_faults(bus, LineFaults { drop: lost, ..QUIET });
        assert_eq!(exchange(&mut bench, client, &write(1)), [0; 0]);
        assert_eq!(exchange(&mut bench, client, &write(1)), write(1));
    }
}

#[test]
fn a_rule_disturbs_the_frames_that_it_names() {
    let lost = |rule: FaultRule| LineFaults { mute: rule, ..QUIET };
    let (mut bench, [x, y], bus, client) = line_faults(LineMode::Timed, 1, QUIET);
    let asks = |bench: &mut Bench, faults| {
        bench.set_line_faults(bus, faults);
        // Reads of register 0 and writes of Speed, of both drives.
        let frames = [ASKED.to_vec(), write(1), rtu::read(2, 0, 1).to_vec(), write(2)];
        frames.map(|frame| !exchange(bench, client, &frame).is_empty())
    };
    let all = FaultRule::ALL;
    for (rule, expected) in [
        (all, [false; 4]),
        (all.drive(x), [false, false, true, true]),
        (all.drive(y), [true, true, false, false]),
        (all.function(6), [true, false, true, false]),
        (all.register("Speed"), [true, false, true, false]),
        (all.register("Speed").function(3), [true; 4]),
        (all.register("Speed").drive(y), [true, true, true, false]),
        (FaultRule::next(1).register("Speed"), [true, false, true, true]),
        (FaultRule::next(0), [true; 4]),
    ] {
        assert_eq!(asks(&mut bench, lost(rule)), expected, "{rule:?}");
        let in_drop = LineFaults { drop: rule, ..QUIET };
        let requests = LineFaults { drop: rule.direction(Direction::Request), ..QUIET };
        assert_eq!(asks(&mut bench, in_drop), expected, "{rule:?}");
        assert_eq!(asks(&mut bench, requests), expected, "{rule:?}");
    }
}

#[test]
fn an_exception_of_a_rule_is_for_the_writes_of_a_register() {
    let exception = FaultRule::next(1).register("Speed");
    let faults = LineFaults { exception, exception_code: 2, ..QUIET };
    let (mut bench, _, bus, client) = line_faults(LineMode::Timed, 1, faults);
    assert_eq!(exchange(&mut bench, client, &ASKED), ANSWER);
    // No drive answers a broadcast, so it has no exception and does not count.
    assert_eq!(exchange(&mut bench, client, &write(0)), [0; 0]);
    assert_eq!(bench.line_faults(bus).exception, exception);
    assert_eq!(rtu::verify_crc(&exchange(&mut bench, client, &write(1))), Some(&[1, 0x86, 2][..]));
    assert_eq!(exchange(&mut bench, client, &write(1)), write(1));
}

/// A frame that is lost has no other fault: none acts, none counts, and the journal names none.
#[test]
fn a_lost_frame_has_no_other_fault() {
    let lost = FaultRule::ALL.direction(Direction::Request);
    let (drop, mute) = (LineFaults { drop: lost, ..QUIET }, LineFaults { mute: FaultRule::ALL, ..QUIET });
    let unanswered = LineFaults { drop: FaultRule::ALL.direction(Direction::Reply), ..QUIET };
    for (faults, direction, said) in [
        (drop, Direction::Request, "lost; by a fault, the request was dropped"),
        (unanswered, Direction::Reply, "DeviceAddress = 1; by a fault, the reply was dropped"),
        (mute, Direction::Reply, "DeviceAddress = 1; by a fault, the reply was not delivered"),
    ] {
        for rule in [FaultRule::ALL, FaultRule::next(1)].map(|rule| rule.direction(direction)) {
            let delayed = FaultRule { direction: None, ..rule };
            let others = LineFaults { corrupt: rule, duplicate: rule, truncate: rule, noise: rule, ..faults };
            let others = LineFaults { delay: 5.millis(), delayed, ..others };
            let (mut bench, [x, _], bus, client) = line_faults(LineMode::Timed, 1, others);
            assert_eq!(exchange(&mut bench, client, &ASKED), [0; 0]);
            assert_eq!(bench.line_faults(bus), others, "a count is as it was");
            assert!(frames(&bench).iter().all(|(_, from, _)| *from != Source::Noise));
            let last = bench.received(x).messages().last().unwrap().to_string();
            assert_eq!(last, format!("rs485 <- read DeviceAddress -> {said}"));
        }
    }
}

/// A request has an exception only if a drive would have answered it; otherwise it does not count.
#[test]
fn only_a_request_with_a_receiver_is_refused() {
    let once = LineFaults { exception: FaultRule::next(1), exception_code: 6, ..QUIET };
    let count = |bench: &Bench, bus| bench.line_faults(bus).exception.amount;
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, [x, y], bus, client) = line_faults(line, 1, once);
        let mut spoiled = ASKED;
        spoiled[7] ^= 1;
        // An address that no drive has, a broadcast, a wrong checksum.
        // Requests of a wrong length: too short, too long, a reply.
        let short = [1, 3, 0, 1, 0x30, 0x18];
        let long = [1, 6, 0, 1, 0, 2, 3, 0x4B, 0x3B];
        let reply = [1, 3, 2, 0, 1, 0x79, 0x84];
        let wrong: [&[u8]; 3] = [&short, &long, &reply];
        for frame in wrong.into_iter().chain([&rtu::read(3, 0, 1)[..], &write(0), &spoiled]) {
            assert_eq!(exchange(&mut bench, client, frame), [0; 0]);
        }
        // Another baud rate, of the client or by a fault.
        let sender = Sender { baud: Some(4_800), ..Sender::default() };
        bench.send_from(client, &ASKED, sender);
        bench.run_until_idle();
        bench.set_line_faults(bus, LineFaults { baud: Some(4_800), ..once });
        assert_eq!(exchange(&mut bench, client, &ASKED), [0; 0]);
        // Another fault that keeps the request from the drive.
        for faults in [
            LineFaults { drop: FaultRule::ALL.direction(Direction::Request), ..once },
            LineFaults { corrupt: FaultRule::ALL.direction(Direction::Request), ..once },
            LineFaults { truncate: FaultRule::ALL.direction(Direction::Request), ..once },
            LineFaults { noise: FaultRule::ALL.direction(Direction::Request), noise_before: true, ..once },
        ] {
            bench.set_line_faults(bus, faults);
            assert_eq!(exchange(&mut bench, client, &ASKED), [0; 0], "{faults:?}");
            assert_eq!(count(&bench, bus), Amount::Count(1), "{faults:?}");
        }
        bench.set_line_faults(bus, once);
        bench.power(x, PowerAction::Off);
        bench.run_until_idle();
        assert_eq!(exchange(&mut bench, client, &ASKED), [0; 0]);
        bench.power(x, PowerAction::On);
        assert_eq!(count(&bench, bus), Amount::Count(1));
        let answer = rtu::frame(2, &[0x83, 6]);
        assert_eq!(exchange(&mut bench, client, &rtu::read(2, 0, 1)), answer[..]);
        assert_eq!(count(&bench, bus), Amount::Count(0));
        let last = bench.received(y).messages().last().unwrap().to_string();
        assert_eq!(last, "rs485 <- read DeviceAddress -> refused: by a fault (06)");
    }
    let mut bench = Bench::new();
    let x = bench.add::<Md3>("x");
    let bus = bench.bus(x, RS485).unwrap();
    bench.set_line_faults(bus, once);
    assert_eq!(bench.ask(x, &ASKED), [0; 0]);
    assert_eq!(count(&bench, bus), Amount::Count(1), "the drive starts");
    bench.run_until(3.secs());
    assert_eq!(bench.ask(x, &ASKED).len(), 5);
}

/// Drives with one address answer at the same time, so neither hears the other. No fault of replies changes this:
/// after one request the line is silent again, and the next request has its answers (HOST-5).
#[test]
fn no_fault_lets_drives_with_one_address_answer_each_other() {
    let late = LineFaults { delay: 20.millis(), ..QUIET };
    for line in [LineMode::Timed, LineMode::Fast] {
        for (faults, clients_hear) in [
            // Only one drive is refused in place of both.
            (LineFaults { exception: FaultRule::next(1), ..QUIET }, 5),
            (late, 16),
            (LineFaults { delay_spread: 20.millis(), ..late }, 16),
            (LineFaults { duplicate: FaultRule::ALL.direction(Direction::Reply), ..QUIET }, 32),
        ] {
            let mut bench = Bench::with(Settings { line, ..Settings::default() });
            let slots = ["x", "y"].map(|name| (md3(&mut bench, name, 1), RS485));
            bench.run_until(start());
            let bus = bench.share("line1", &slots);
            let client = bench.connect(bus);
            bench.set_line_faults(bus, faults);
            bench.send(client, &write(1));
            bench.run_until(start() + 1.secs());
            assert_eq!(received_by(&mut bench, client).len(), clients_hear, "{line:?} {faults:?}");
            bench.run_until(start() + 3.secs());
            assert_eq!(received_by(&mut bench, client), [0; 0], "{line:?} {faults:?}");
            bench.set_line_faults(bus, QUIET);
            assert_eq!(exchange(&mut bench, client, &write(1)).len(), 16, "{line:?} {faults:?}");
            for (drive, _) in slots {
                let refused = usize::from(faults.exception != FaultRule::NONE && drive != slots[0].0);
                let messages = bench.received(drive).messages().count();
                assert_eq!(messages, 2 - refused, "{line:?} {faults:?}");
            }
        }
    }
}

#[test]
fn a_refusal_ends_with_the_power_of_its_drive() {
    let faults = LineFaults { exception: FaultRule::ALL, ..QUIET };
    for (at, received) in [(EIGHT, 0), (leaves() + CHARACTER * 2, 2)] {
        let (mut bench, [x, _], _, client) = line_faults(LineMode::Timed, 1, faults);
        bench.send(client, &ASKED);
        bench.run_until(start() + at);
        bench.power(x, PowerAction::Off);
        bench.run_until_idle();
        assert_eq!(received_by(&mut bench, client).len(), received);
        let last = bench.received(x).messages().last().unwrap().to_string();
        let cut = "refused: by a fault (04); power lost after 2 of 5 bytes of the reply";
        let outcome = if received == 0 { "no power" } else { cut };
        assert_eq!(last, format!("rs485 <- read DeviceAddress -> {outcome}"));
    }
}

#[test]
fn a_refused_request_has_the_other_faults_too_and_is_no_retry() {
    let exception = FaultRule::next(1).drive(DriveId(0));
    let reply = FaultRule::ALL.direction(Direction::Reply);
    let faults =
        LineFaults { exception, wrong_address: reply, duplicate: reply, delay: Duration::millis(5), ..QUIET };
    let (mut bench, [x, _], bus, client) = line_faults(LineMode::Timed, 1, faults);
    assert_eq!(exchange(&mut bench, client, &ASKED), rtu::frame(3, &[0x83, 4]).repeat(2));
    assert_eq!(bench.now(), start() + leaves() + Duration::millis(5) + CHARACTER * 10 + T3_5);
    let last = bench.received(x).messages().last().unwrap().to_string();
    assert!(
        last.ends_with("by a fault, the reply was sent twice and had a wrong address and was delayed"),
        "{last}"
    );
    bench.set_line_faults(bus, LineFaults { exception: FaultRule::ALL, ..QUIET });
    for _ in 0..2 {
        exchange(&mut bench, client, &write(1));
    }
    assert_eq!(bench.request_statistics(bus).retries, 0);
    // A request that comes twice has two exceptions.
    let twice = FaultRule::ALL.direction(Direction::Request);
    bench.set_line_faults(bus, LineFaults { exception: FaultRule::ALL, duplicate: twice, ..QUIET });
    assert_eq!(exchange(&mut bench, client, &ASKED), rtu::frame(1, &[0x83, 4]).repeat(2));
}

#[test]
fn a_refused_request_that_collides_has_no_answer() {
    let (mut bench, [x, _], [a, b]) = colliding([1, 2]);
    let bus = bench.find_bus("line1").unwrap();
    bench.set_line_faults(bus, LineFaults { exception: FaultRule::next(1), ..QUIET });
    bench.send(a, &ASKED);
    bench.run_until(start() + CHARACTER * 2);
    bench.send(b, &ASKED);
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, a), [0; 0]);
    let entries: Vec<String> = bench.received(x).messages().map(|entry| entry.to_string()).collect();
    assert!(entries.iter().all(|entry| !entry.contains("refused")), "{entries:#?}");
}

#[test]
fn delays_spread_between_the_least_and_the_greatest() {
    let (delay, delay_spread) = (Duration::millis(5), Duration::millis(20));
    let (mut bench, _, _, client) =
        line_faults(LineMode::Timed, 1, LineFaults { delay, delay_spread, ..QUIET });
    let mut delays = Vec::new();
    for _ in 0..200 {
        let start = bench.now();
        assert_eq!(exchange(&mut bench, client, &ASKED), ANSWER);
        delays.push(bench.now().since(start));
        bench.run_until(bench.now() + 10.millis());
    }
    let (least, most) = (delays.iter().min().unwrap(), delays.iter().max().unwrap());
    let usual = leaves() + SEVEN;
    assert!(*least >= usual + delay && *least < usual + delay + 1.millis(), "{least:?}");
    let longest = usual + delay + delay_spread;
    assert!(*most <= longest && *most > longest - 1.millis(), "{most:?}");
}

#[test]
fn a_delay_of_a_rule_is_for_its_replies() {
    let delayed = FaultRule::next(1).function(6);
    let delay = Duration::millis(50);
    let (mut bench, _, _, client) = line_faults(LineMode::Timed, 1, LineFaults { delay, delayed, ..QUIET });
    let mut takes = |frame: &[u8]| {
        let start = bench.now();
        assert!(!exchange(&mut bench, client, frame).is_empty());
        let takes = bench.now().since(start);
        bench.run_until(bench.now() + 10.millis());
        takes
    };
    assert!(takes(&ASKED) < delay && takes(&write(1)) > delay && takes(&write(1)) < delay);
}

proptest! {
    /// A rule that covers no frame is as no rule, and the others have the same effect with it (BENCH-10).
    #[test]
    fn rules_without_frames_change_nothing(seed: u64, faults in any_faults(), writes in 1..20_usize) {
        let run = |other: FaultRule| {
            let mut faults = faults;
            faults.duplicate = other;
            let (mut bench, _, _, client) = line_faults(LineMode::Timed, seed, faults);
            let received: Vec<Vec<u8>> = (0..writes)
                .map(|n| exchange(&mut bench, client, if n % 2 == 0 { &ASKED } else { &[1, 3, 0, 0, 0, 2, 0xC4, 0x0B] }))
                .collect();
            (bench.trace().to_text(), received)
        };
        let none = run(FaultRule::NONE);
        prop_assert_eq!(&none, &run(FaultRule::next(0)));
        prop_assert_eq!(&none, &run(FaultRule::next(5).function(16)));
        prop_assert_eq!(&none, &run(FaultRule::ALL.register("Speed")));
    }
}
