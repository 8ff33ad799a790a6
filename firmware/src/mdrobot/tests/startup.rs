//! Start-up: for 300 ms the drive receives nothing and does not move.

use super::super::{DIR, RUN_BRAKE, SPEED_IN, START_STOP};
use super::*;

/// A request to read VERSION; its CRC was computed elsewhere by the algorithm of the specification.
const ASK: [u8; 8] = [1, 3, 0, 1, 0, 1, 0xD5, 0xCA];

#[test]
fn it_hears_what_ends_more_than_300_ms_after_power_on() {
    let ready = Instant::from(300.millis());
    for (end_of_first, answered) in [(ready, false), (ready + Duration::TICK, true)] {
        let mut dut = Dut::booting();
        dut.input(end_of_first, Input::Bytes { port: Port(0), bytes: &ASK });
        dut.wait(1.secs());
        let starting = LogEvent::Dropped { port: Port(0), why: DropReason::Starting };
        assert_eq!(dut.out.bytes.len(), usize::from(answered));
        assert_eq!(dut.out.noted().contains(&starting), !answered);
    }
}

#[test]
fn a_frame_behind_what_was_lost_is_answered_however_it_comes() {
    // Three characters of noise and a frame without a gap. The last character of noise ends just before the
    // drive listens.
    let burst = [&[0x55, 0xAA, 0x55][..], &ASK].concat();
    let first = Instant::from(300.millis()) - Duration::TICK - CHARACTER * 2;
    for cut in 0..=burst.len() {
        let mut dut = Dut::booting();
        let (one, two) = burst.split_at(cut);
        if !one.is_empty() {
            dut.input(first, Input::Bytes { port: Port(0), bytes: one });
        }
        if !two.is_empty() {
            dut.input(first + CHARACTER * cut as u64, Input::Bytes { port: Port(0), bytes: two });
        }
        dut.wait(1.secs());
        let replies: Vec<_> = dut.out.bytes.iter().map(|(_, _, reply)| reply[..5].to_vec()).collect();
        assert_eq!(replies, [[1, 3, 2, 0, 81]], "cut at {cut}");
    }
}

#[test]
fn power_tells_the_line_at_once() {
    let dut = Dut::booting();
    assert_eq!(dut.out.lines, [(Instant::ZERO, Port(0), line(19_200))]);
}

#[test]
fn nothing_moves_before_it_is_ready() {
    let mut dut = Dut::booting();
    for pin in [START_STOP, RUN_BRAKE] {
        dut.contact(pin, true);
    }
    dut.feed(Input::Millivolts { pin: SPEED_IN, mv: 5_000 });
    dut.run_until(Instant::from(300.millis()) - Duration::TICK);
    assert_eq!((dut.get(Pid::POSI_DATA), dut.get(Pid::TQ_DATA)), (0, 0));
    dut.run_until(Instant::from(2.secs()));
    assert!(dut.get(Pid::POSI_DATA) > 100, "START/STOP was ON when it became ready");
}

#[test]
fn without_a_delay_it_waits_for_what_is_told_in_the_same_instant() {
    let mut dut = Dut::new();
    dut.set(Pid::TAR_VEL, 500);
    dut.power_on(Boot { fast: true, ..Boot::default() });
    // The inputs arrive before the first deadline, DIR last.
    for pin in [START_STOP, RUN_BRAKE, DIR] {
        dut.contact(pin, true);
    }
    assert_eq!(dut.get(Pid::TQ_DATA), 0);
    dut.run_until(Instant::from(2.secs()));
    assert!((-510..=-490).contains(&dut.rpm()), "{}", dut.rpm());
    assert_eq!(dut.read(1), 81);
}
