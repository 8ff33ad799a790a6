//! The start: 300 ms deaf, nothing moves.

use super::super::{DIR, RUN_BRAKE, SPEED_IN, START_STOP};
use super::*;

/// Reads VERSION; the CRC is that of the specification's algorithm, done elsewhere.
const ASK: [u8; 8] = [1, 3, 0, 1, 0, 1, 0xD5, 0xCA];

#[test]
fn it_hears_what_ends_300_ms_after_power_on() {
    let ready = Instant::from(300.millis());
    for (end_of_first, answered) in [(ready - Duration::TICK, false), (ready, true)] {
        let mut bed = Bed::booting();
        bed.input(end_of_first, Input::Bytes { port: Port(0), bytes: &ASK });
        bed.wait(1.secs());
        let starting = Note::Dropped { port: Port(0), why: Why::Starting };
        assert_eq!(bed.world.sent.len(), usize::from(answered));
        assert_eq!(bed.world.notes.contains(&starting), !answered);
    }
}

#[test]
fn a_frame_behind_what_was_lost_is_answered_however_it_comes() {
    // Three characters of noise, of which the last ends just before the drive listens, and a frame at once.
    let burst = [&[0x55, 0xAA, 0x55][..], &ASK].concat();
    let first = Instant::from(300.millis()) - Duration::TICK - CHARACTER * 2;
    for cut in 0..=burst.len() {
        let mut bed = Bed::booting();
        let (one, two) = burst.split_at(cut);
        if !one.is_empty() {
            bed.input(first, Input::Bytes { port: Port(0), bytes: one });
        }
        if !two.is_empty() {
            bed.input(first + CHARACTER * cut as u64, Input::Bytes { port: Port(0), bytes: two });
        }
        bed.wait(1.secs());
        let replies: Vec<_> = bed.world.sent.iter().map(|(_, reply)| reply[..5].to_vec()).collect();
        assert_eq!(replies, [[1, 3, 2, 0, 81]], "cut at {cut}");
    }
}

#[test]
fn power_tells_the_line_at_once() {
    let bed = Bed::booting();
    assert_eq!(bed.world.lines, [(Instant::ZERO, line(19_200))]);
}

#[test]
fn nothing_moves_before_it_is_ready() {
    let mut bed = Bed::booting();
    for pin in [START_STOP, RUN_BRAKE] {
        bed.contact(pin, true);
    }
    bed.input(bed.now, Input::Millivolts { pin: SPEED_IN, mv: 5_000 });
    bed.run_until(Instant::from(300.millis()) - Duration::TICK);
    assert_eq!((bed.get(Pid::POSI_DATA), bed.get(Pid::TQ_DATA)), (0, 0));
    bed.run_until(Instant::from(2.secs()));
    assert!(bed.get(Pid::POSI_DATA) > 100, "START/STOP was ON when it became ready");
}

#[test]
fn without_a_delay_it_waits_for_what_is_told_in_the_same_instant() {
    let mut bed = Bed::new();
    bed.set(Pid::TAR_VEL, 500);
    bed.drive.power_on(bed.now, Boot { fast: true, ..Boot::default() }, &mut bed.world);
    // Told before the first deadline, DIR last.
    for pin in [START_STOP, RUN_BRAKE, DIR] {
        bed.contact(pin, true);
    }
    assert_eq!(bed.get(Pid::TQ_DATA), 0);
    bed.run_until(Instant::from(2.secs()));
    assert!((-510..=-490).contains(&bed.rpm()), "{}", bed.rpm());
    assert_eq!(bed.read(1), 81);
}
