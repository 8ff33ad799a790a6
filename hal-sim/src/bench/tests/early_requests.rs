//! Requests without the silence that a line needs (HOST-23).

use super::faults::{ANSWER, ASKED, QUIET, SEVEN, leaves, line_faults};
use super::*;
use crate::line::faults::{Direction, FaultRule};

/// Time at which the answer to a request of `start()` is complete.
fn answered() -> Instant {
    start() + leaves() + SEVEN
}

/// The request for drive 2 on the line, and its answer.
const TO_Y: [u8; 8] = [2, 3, 0, 0, 0, 1, 0x84, 0x39];
const ANSWER_OF_Y: [u8; 7] = [2, 3, 2, 0, 2, 0x7D, 0x85];

/// Verdict and outcome of each message of a drive and its line.
fn outcomes(bench: &Bench, drive: DriveId) -> Vec<(&'static str, String)> {
    let received = bench.received(drive);
    received.messages().map(|message| (message.exchange.verdict.as_str(), message.exchange.outcome)).collect()
}

/// A line, strict or not, on which x has just answered; the client sends `frame` after that `silence`. Returns
/// the answers to it.
fn after_silence(strict: bool, silence: Duration, frame: &[u8]) -> (Bench, [DriveId; 2], Bus, Vec<u8>) {
    let (mut bench, drives, bus, client) = line_faults(LineMode::Timed, 1, QUIET);
    bench.set_strict(bus, strict);
    bench.send(client, &ASKED);
    bench.run_until(answered());
    assert_eq!(received_by(&mut bench, client), ANSWER);
    bench.run_until(answered() + silence);
    bench.send(client, frame);
    bench.run_until(1.secs());
    let answers = received_by(&mut bench, client);
    (bench, drives, bus, answers)
}

#[test]
fn a_request_soon_after_another_drives_reply_is_counted_and_lost_on_a_strict_line() {
    // At 9,600 bit/s, even parity, t3.5 is 38.5 bits: 4.01 ms.
    let silence = 100.micros();
    let (bench, _, bus, answers) = after_silence(false, silence, &TO_Y);
    assert_eq!(answers, ANSWER_OF_Y);
    let early = bench.early_requests(bus);
    assert_eq!((early.count, bench.early_count(), bench.is_strict(bus)), (1, 1, false));
    assert_eq!(early.last.unwrap().to_string(), "sent 0.1 ms after a reply; t3.5 is 4.0 ms");

    // The journal says which request was early.
    let (bench, [x, y], ..) = after_silence(false, silence, &TO_Y);
    let read = ("done", "DeviceAddress = 2; sent 0.1 ms after a reply; t3.5 is 4.0 ms".to_owned());
    assert_eq!(outcomes(&bench, y), [read]);
    assert_eq!(outcomes(&bench, x), [("done", "DeviceAddress = 1".to_owned())]);
    let last = bench.received(y).messages().next().unwrap();
    assert_eq!(last.exchange.reason.as_deref(), Some("sent 0.1 ms after a reply; t3.5 is 4.0 ms"));
    let (bench, [x, y], ..) = after_silence(false, silence, &rtu::write(0, 0x1D, 7));
    let written = ("done", "done; sent 0.1 ms after a reply; t3.5 is 4.0 ms".to_owned());
    assert_eq!(
        (outcomes(&bench, x).pop(), outcomes(&bench, y).pop()),
        (Some(written.clone()), Some(written))
    );
    let (bench, [x, _], ..) = after_silence(false, silence, &rtu::read(9, 0, 1));
    assert_eq!(
        outcomes(&bench, x).pop().unwrap().1,
        "for address 9, nobody here (the drives have 1, 2); sent 0.1 ms after a reply; t3.5 is 4.0 ms"
    );

    let (bench, [x, y], bus, answers) = after_silence(true, silence, &TO_Y);
    assert_eq!((answers, bench.early_requests(bus).count), (vec![], 1));
    assert_eq!(bench.statistics(y, RS485).requests, 0);
    let too_early = ("too early", "sent 0.1 ms after a reply; t3.5 is 4.0 ms".to_owned());
    // The request for y is in the journal of y alone, and one for all in that of the line.
    assert_eq!(outcomes(&bench, y), std::slice::from_ref(&too_early));
    assert_eq!(outcomes(&bench, x), [("done", "DeviceAddress = 1".to_owned())]);
    assert_eq!(bench.received(x).counts().functions.get(&3), Some(&1));
    let (bench, [x, y], ..) = after_silence(true, silence, &rtu::write(0, 0x1D, 7));
    assert_eq!(outcomes(&bench, y), std::slice::from_ref(&too_early));
    assert_eq!(outcomes(&bench, x), [("done", "DeviceAddress = 1".to_owned()), too_early]);
}

#[test]
fn a_silence_of_t3_5_is_enough() {
    let enough = after_silence(true, T3_5, &TO_Y);
    assert_eq!((enough.3, enough.0.early_count()), (ANSWER_OF_Y.to_vec(), 0));
    let missing_a_tick = after_silence(true, T3_5 - Duration::TICK, &TO_Y);
    assert_eq!((missing_a_tick.3, missing_a_tick.0.early_count()), (vec![], 1));
}

#[test]
fn a_request_during_a_reply_is_early() {
    // A client whose time-out begins when its eight characters are on the line sends eight characters earlier here.
    for (before, is_early) in [(EIGHT + Duration::TICK, true), (EIGHT, false), (CHARACTER, false)] {
        let (mut bench, [x, y], bus, client) = line_faults(LineMode::Timed, 1, QUIET);
        bench.set_strict(bus, true);
        bench.send(client, &ASKED);
        bench.run_until(answered() - before);
        bench.send(client, &TO_Y);
        bench.run_until(1.secs());
        let expected = if is_early { ANSWER.to_vec() } else { [ANSWER, ANSWER_OF_Y].concat() };
        assert_eq!(received_by(&mut bench, client), expected);
        let early = ("too early", "sent while the line was in use; t3.5 is 4.0 ms".to_owned());
        assert_eq!(outcomes(&bench, y).last() == Some(&early), is_early);
        assert_eq!(outcomes(&bench, x).len(), 1);
    }
}

#[test]
fn two_frames_in_one_write_are_one_bad_frame_on_a_strict_line() {
    for (strict, answers, count) in [(false, [ANSWER, ANSWER_OF_Y].concat(), 1), (true, vec![], 1)] {
        let (mut bench, [x, _], bus, client) = line_faults(LineMode::Timed, 1, QUIET);
        bench.set_strict(bus, strict);
        bench.send(client, &[ASKED, TO_Y].concat());
        bench.run_until(1.secs());
        assert_eq!((received_by(&mut bench, client), bench.early_count()), (answers, count));
        if strict {
            let first = outcomes(&bench, x).remove(0);
            assert_eq!(
                first,
                ("too early", "the next request follows without silence; t3.5 is 4.0 ms".into())
            );
        }
        // Afterwards the line is as before.
        bench.send(client, &ASKED);
        bench.run_until(2.secs());
        assert_eq!((received_by(&mut bench, client), bench.early_count()), (ANSWER.to_vec(), count));
    }
}

#[test]
fn a_request_after_one_without_a_reply_needs_the_silence_as_well() {
    // The client may believe that its bytes are on the line once it has written them.
    for (after, count) in [(T3_5 - Duration::TICK, 1), (T3_5, 0)] {
        let (mut bench, _, _, client) = line_faults(LineMode::Timed, 1, QUIET);
        // Nobody has address 9.
        bench.send(client, &rtu::read(9, 0, 1));
        bench.run_until(start() + after);
        bench.send(client, &ASKED);
        bench.run_until(1.secs());
        assert_eq!((received_by(&mut bench, client), bench.early_count()), (ANSWER.to_vec(), count));
    }
}

#[test]
fn a_partial_frame_counts_from_when_it_was_sent() {
    // The line passes on a partial frame 20 ms later than the client sent it.
    let (mut bench, _, bus, client) = line_faults(LineMode::Timed, 1, QUIET);
    bench.set_strict(bus, true);
    bench.send(client, &ASKED[..5]);
    bench.run_until(start() + 21.millis());
    bench.send(client, &ASKED);
    bench.run_until(1.secs());
    assert_eq!((received_by(&mut bench, client), bench.early_count()), (ANSWER.to_vec(), 0));
}

/// A fault hides the end of an exchange only if it acts on it, and if it changes the times.
#[test]
fn a_strict_line_judges_what_faults_leave_provable() {
    let (all, none) = (FaultRule::ALL, FaultRule::next(0));
    let reply = all.direction(Direction::Reply);
    let elsewhere = all.function(16);
    let late = LineFaults { delay: 1.millis(), ..QUIET };
    for (faults, early) in [
        (late, 0),
        (LineFaults { duplicate: reply, ..QUIET }, 0),
        (LineFaults { noise: reply, ..QUIET }, 0),
        (LineFaults { drop: reply, ..QUIET }, 0),
        (LineFaults { mute: all, ..QUIET }, 0),
        (LineFaults { truncate: reply, ..QUIET }, 0),
        // The last frame of a count is disturbed as the others.
        (LineFaults { delayed: FaultRule::next(1), ..late }, 0),
        (LineFaults { baud: Some(9_600), ..QUIET }, 0),
        (LineFaults { drop: none, noise: none, duplicate: none, delayed: none, ..late }, 1),
        (
            LineFaults {
                drop: elsewhere,
                noise: elsewhere,
                duplicate: elsewhere,
                delayed: elsewhere,
                ..late
            },
            1,
        ),
        (LineFaults { corrupt: reply, ..QUIET }, 1),
        (LineFaults { wrong_address: all, ..QUIET }, 1),
        (LineFaults { exception: all, ..QUIET }, 1),
    ] {
        let (mut bench, _, bus, client) = line_faults(LineMode::Timed, 1, faults);
        bench.set_strict(bus, true);
        bench.send(client, &ASKED);
        bench.run_until_idle();
        bench.send(client, &TO_Y);
        bench.run_until(1.secs());
        assert_eq!(bench.early_requests(bus).count, early, "{faults:?}");
        // Two frames in one write are early, whatever the replies are.
        let before = bench.early_requests(bus).count;
        bench.send(client, &[ASKED, TO_Y].concat());
        bench.run_until(2.secs());
        let in_one_write = if faults.baud.is_some() { 0 } else { 1 };
        assert_eq!(bench.early_requests(bus).count - before, in_one_write, "{faults:?}");
    }
}

#[test]
fn a_client_that_cannot_know_is_not_judged() {
    let two = [ASKED, ASKED].concat();
    // Characters that take no time.
    let (mut bench, _, bus, client) = line_faults(LineMode::Fast, 1, QUIET);
    bench.set_strict(bus, true);
    bench.send(client, &two);
    bench.run_until(1.secs());
    assert_eq!((received_by(&mut bench, client), bench.early_count()), (ANSWER.repeat(2), 0));
    // Another client, a port that times characters itself, time that stands still, and a jump of the clock.
    let cases: [fn(&mut Bench, Client, Bus) -> Client; 4] = [
        |bench, _, bus| bench.connect(bus),
        |bench, client, _| {
            bench.set_self_paced(client);
            client
        },
        |bench, client, _| {
            bench.judge_silence(false);
            client
        },
        |bench, client, _| {
            bench.forget_silence();
            client
        },
    ];
    for (number, change) in cases.into_iter().enumerate() {
        let (mut bench, _, bus, client) = line_faults(LineMode::Timed, 1, QUIET);
        bench.set_strict(bus, true);
        bench.send(client, &ASKED);
        bench.run_until(answered());
        let _ = received_by(&mut bench, client);
        let client = change(&mut bench, client, bus);
        bench.send(client, &TO_Y);
        bench.run_until(1.secs());
        assert_eq!(
            (received_by(&mut bench, client), bench.early_count()),
            (ANSWER_OF_Y.to_vec(), 0),
            "{number}"
        );
    }
}

#[test]
fn bytes_may_have_been_sent_later_than_the_bench_knows() {
    let (mut bench, _, bus, client) = line_faults(LineMode::Timed, 1, QUIET);
    bench.set_strict(bus, true);
    bench.send(client, &ASKED);
    bench.run_until(answered());
    let _ = received_by(&mut bench, client);
    bench.set_arrived_by(answered() + T3_5);
    bench.send(client, &TO_Y);
    bench.run_until(1.secs());
    assert_eq!((received_by(&mut bench, client), bench.early_count()), (ANSWER_OF_Y.to_vec(), 0));
}

#[test]
fn two_frames_in_one_write_are_counted_in_manual_time_too() {
    for judged in [true, false] {
        let (mut bench, _, bus, client) = line_faults(LineMode::Timed, 1, QUIET);
        bench.judge_silence(judged);
        bench.send(client, &[ASKED, TO_Y].concat());
        bench.run_until(1.secs());
        let early = bench.early_requests(bus);
        assert_eq!((received_by(&mut bench, client), early.count), ([ANSWER, ANSWER_OF_Y].concat(), 1));
        assert_eq!(
            early.last.unwrap().to_string(),
            "sent in one write with the request before it; t3.5 is 4.0 ms"
        );
        // Two writes.
        for frame in [ASKED, TO_Y] {
            bench.send(client, &frame);
            bench.run_until(bench.now() + 1.secs());
        }
        assert_eq!(bench.early_requests(bus).count, 1);
    }
}

#[test]
fn the_shortest_silence_after_a_reply() {
    let (bench, _, bus, _) = after_silence(false, 5.millis(), &TO_Y);
    let statistics = bench.request_statistics(bus);
    assert_eq!((statistics.requests, statistics.early), (2, 0));
    assert_eq!(statistics.shortest_silence, Some(5.millis()));
    let (bench, _, bus, _) = after_silence(false, 100.micros(), &TO_Y);
    let statistics = bench.request_statistics(bus);
    assert_eq!((statistics.early, statistics.shortest_silence), (1, Some(100.micros())));
}

#[test]
fn a_retry_repeats_a_request_that_got_no_answer() {
    let (mut bench, _, bus, client) = line_faults(LineMode::Timed, 1, QUIET);
    let retries = |bench: &mut Bench, frame: &[u8], faults: LineFaults| {
        bench.set_line_faults(bus, faults);
        bench.send(client, frame);
        bench.run_until(bench.now() + 1.secs());
        bench.request_statistics(bus).retries
    };
    let lost = LineFaults { drop: 1.0.into(), ..QUIET };
    let corrupt = LineFaults { corrupt: 1.0.into(), ..QUIET };
    assert_eq!(retries(&mut bench, &ASKED, QUIET), 0);
    // A poll repeats a request that was answered.
    assert_eq!(retries(&mut bench, &ASKED, lost), 0);
    assert_eq!(retries(&mut bench, &ASKED, corrupt), 1);
    assert_eq!(retries(&mut bench, &ASKED, QUIET), 2);
    assert_eq!(retries(&mut bench, &TO_Y, lost), 2);
    assert_eq!(retries(&mut bench, &ASKED, QUIET), 2);
    // A broadcast has no answer, and nobody has address 9.
    for (address, all) in [(0, 2), (9, 3)] {
        let write = rtu::write(address, 0x1D, 7);
        retries(&mut bench, &write, QUIET);
        assert_eq!(retries(&mut bench, &write, QUIET), all, "{address}");
    }
}

/// The second of two requests in one write has no silence before it, whatever a fault of the line hides.
#[test]
fn two_requests_in_one_write_are_too_early_with_faults_too() {
    let noise = |direction| LineFaults { noise: FaultRule::ALL.direction(direction), ..QUIET };
    let twice = LineFaults { duplicate: FaultRule::ALL.direction(Direction::Reply), ..QUIET };
    let delay = LineFaults { delay: 50.millis(), ..QUIET };
    for faults in [noise(Direction::Reply), noise(Direction::Request), twice, delay] {
        let (mut bench, [x, y], bus, client) = line_faults(LineMode::Timed, 1, faults);
        bench.set_strict(bus, true);
        bench.send(client, &[ASKED, TO_Y].concat());
        bench.run_until(1.secs());
        let followed = ("too early", "the next request follows without silence; t3.5 is 4.0 ms".to_owned());
        let one_write =
            ("too early", "sent in one write with the request before it; t3.5 is 4.0 ms".to_owned());
        assert_eq!((outcomes(&bench, x), outcomes(&bench, y)), (vec![followed], vec![one_write]));
    }
}

/// Characters without silence that are no chain of whole frames are one bad frame on a real line, and no request that is
/// too early.
#[test]
fn characters_without_silence_that_are_no_frames_are_one_bad_frame_on_a_strict_line() {
    let overlong = [&[1, 3][..], &[0; 300]].concat();
    let junk: Vec<u8> = (0..600_u32).map(|n| (n * 7 % 251) as u8).collect();
    for (text, left) in [
        (overlong, None),
        (junk, None),
        ([&ASKED[..], &[0]].concat(), Some(&[0][..])),
        ([&ASKED[..], &TO_Y[..5]].concat(), Some(&TO_Y[..5])),
        ([&ASKED[..], &TO_Y, &[7; 30]].concat(), None),
        ([&[0][..], &ASKED].concat(), None),
    ] {
        let (mut bench, [x, y], bus, client) = line_faults(LineMode::Timed, 1, QUIET);
        bench.set_strict(bus, true);
        bench.send(client, &text);
        bench.run_until(3.secs());
        for drive in [x, y] {
            let received = bench.received(drive);
            let messages: Vec<_> = received.messages().collect();
            let kept = &text[..text.len().min(1_024)];
            assert_eq!(messages.iter().map(|message| &message.bytes[..]).collect::<Vec<_>>(), [kept]);
            assert_eq!(messages[0].exchange.verdict.as_str(), "bad frame");
        }
        assert_eq!((received_by(&mut bench, client), bench.early_count()), (vec![], 0));
        // Afterwards the line is as before.
        bench.send(client, &ASKED);
        bench.run_until(4.secs());
        assert_eq!((received_by(&mut bench, client), bench.early_count()), (ANSWER.to_vec(), 0));
        // A line that is not strict delivers the request, and what is left is no request.
        let Some(left) = left else { continue };
        let (mut bench, [x, _], _, client) = line_faults(LineMode::Timed, 1, QUIET);
        bench.send(client, &text);
        bench.run_until(3.secs());
        assert_eq!((received_by(&mut bench, client), bench.early_count()), (ANSWER.to_vec(), 0));
        let received = bench.received(x);
        assert_eq!(received.messages().map(|message| message.bytes).collect::<Vec<_>>(), [&ASKED[..], left]);
    }
}
