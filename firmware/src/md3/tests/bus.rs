//! Requests and replies on the RS-485 line, and their times (chapter 6, 7.22).

use super::*;

#[test]
fn a_reply_leaves_when_nobody_began_to_speak_for_3_5_characters() {
    let mut dut = ready();
    let end = dut.hear(&rtu::read(1, 0x00, 1));
    dut.run_until(end + JUDGEMENT - Duration::TICK);
    assert!(dut.out.bytes.is_empty());
    dut.run_until(end + JUDGEMENT);
    assert_eq!(dut.sent(), [(dut.now, rtu::frame(1, &[3, 2, 0, 1]))]);
}

#[test]
fn a_gap_of_1_5_characters_is_legal_and_a_tick_more_is_not() {
    // 1.5 · 18,333 = 27,499.5 ticks, rounded up.
    let longest = Duration::from_ticks(27_500);
    for (gap, answered) in [(longest, true), (longest + Duration::TICK, false)] {
        let mut dut = ready();
        let frame = rtu::read(1, 0x00, 1);
        let half = dut.hear(&frame[..4]);
        dut.now = half + gap;
        let end = dut.hear(&frame[4..]);
        dut.run_until(end + JUDGEMENT);
        assert_eq!(dut.out.bytes.len(), usize::from(answered));
        if !answered {
            assert_eq!(dut.out.noted(), [LogEvent::Dropped { port: Port(0), why: DropReason::Gap }]);
        }
        assert_eq!(dut.read(0x00), 1, "the next good frame is answered");
    }
}

#[test]
fn frames_are_3_5_characters_apart_and_a_tick_less_spoils_both() {
    let apart = Duration::from_ticks(64_166);
    for (gap, answers) in [(apart, 2), (apart - Duration::TICK, 0)] {
        let mut dut = ready();
        let frame = rtu::read(1, 0x00, 1);
        dut.now = dut.hear(&frame) + gap;
        let end = dut.hear(&frame);
        dut.run_until(end + JUDGEMENT);
        assert_eq!(dut.out.bytes.len(), answers);
    }
}

/// What is due comes first, whatever tells that the request is over (MODBUS-7).
#[test]
fn a_move_that_is_asked_for_in_the_instant_in_which_the_last_one_ends_starts() {
    let next = Input::Bytes { port: Port(0), bytes: &[2] };
    for over in [None, Some(next), Some(Input::Idle { port: Port(0) })] {
        let mut dut = ready();
        dut.write(0x11, 1);
        let (start, ..) = *dut.out.plans.last().unwrap();
        // 10,000 steps at 5,000 steps/s with ramps of 0.5 s.
        let end = start + 2_500.millis();
        let move_again = rtu::write(1, 0x11, 1);
        dut.run_until(end - JUDGEMENT - CHARACTER * move_again.len() as u64);
        assert_eq!(dut.hear(&move_again) + JUDGEMENT, end);
        assert_eq!((dut.out.plans.len(), dut.control() & 1), (2, 1), "at rest, then the move");
        if let Some(over) = over {
            dut.input(end, over);
        }
        dut.run_until(end);
        assert_eq!((dut.out.plans.len(), dut.control() & 1), (3, 1), "{over:?}");
        dut.run_until(end + 3.secs());
        assert_eq!(dut.position(), 20_000);
    }
}

#[test]
fn above_19200_baud_the_silences_are_fixed() {
    let mut dut = ready();
    dut.write(0x1c, 0x0025); // 115200 8E1
    dut.out.bytes.clear();
    let first = dut.now + 1.millis();
    let frame = rtu::read(1, 0x1c, 1);
    dut.input(first, Input::Bytes { port: Port(0), bytes: &frame });
    // 11 bits at 115,200 are 1,528 ticks; t3.5 is 1.75 ms.
    let reply = first + Duration::from_ticks(7 * 1_528) + 1_750.micros() + Duration::from_ticks(1_528);
    dut.run_until(reply - Duration::TICK);
    assert!(dut.out.bytes.is_empty());
    dut.run_until(reply);
    assert_eq!(dut.sent(), [(reply, rtu::frame(1, &[3, 2, 0x00, 0x25]))]);
}

#[test]
fn what_is_no_frame_for_it_is_met_with_silence() {
    let mut dut = ready();
    let mut wrong = rtu::write(1, 0x1d, 7);
    wrong[6] ^= 1;
    assert!(dut.ask(&wrong).is_empty());
    assert!(dut.ask(&rtu::write(2, 0x1d, 7)).is_empty());
    assert!(dut.ask(&[1]).is_empty());
    assert!(dut.ask(&rtu::frame(1, &[3, 0, 0, 0])).is_empty());
    assert!(dut.ask(&[0x55; 300]).is_empty());
    let end = dut.now + CHARACTER;
    dut.input(end, Input::RxError { port: Port(0) });
    dut.run_until(end + JUDGEMENT);
    let why: Vec<_> = dut
        .out
        .notes
        .iter()
        .map(|(_, note)| match note {
            LogEvent::Dropped { why, .. } => *why,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(
        why,
        [
            DropReason::Crc,
            DropReason::Address,
            DropReason::Crc,
            DropReason::Length,
            DropReason::Length,
            DropReason::RxError
        ]
    );
    assert_eq!(dut.read(0x1d), 0, "nothing was written");
}

#[test]
fn another_slaves_reply_is_not_for_it() {
    let mut dut = ready();
    // The reply of slave 1 to a read looks like a request to slave 1 of another length.
    assert!(dut.ask(&rtu::frame(1, &[3, 4, 0, 1, 0, 2])).is_empty());
    assert_eq!(dut.read(0x00), 1);
}

#[test]
fn functions_other_than_3_and_6_are_exception_1() {
    let mut dut = ready();
    for function in [1_u8, 2, 4, 5, 8, 15, 16, 23, 43, 0x7F] {
        let reply = dut.ask(&rtu::frame(1, &[function, 0, 0, 0, 1]));
        assert_eq!(reply, exception(function, 1));
    }
}

#[test]
fn addresses_and_values_it_does_not_have_are_exception_2() {
    let mut dut = ready();
    for (first, count) in [(0x00, 0), (0x00, 33), (0x1f, 2), (0x20, 1), (0xFFFF, 1), (0x00, 0xFFFF)] {
        assert_eq!(dut.ask(&rtu::read(1, first, count)), exception(3, 2));
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
        assert_eq!(dut.ask(&rtu::write(1, address, value)), exception(6, 2));
    }
    assert_eq!(dut.read(0x00), 1, "the address is still 1");
}

#[test]
fn a_broadcast_is_obeyed_and_not_answered() {
    let mut dut = ready();
    assert!(dut.ask(&rtu::write(0, 0x1d, 0x1234)).is_empty());
    assert!(dut.ask(&rtu::read(0, 0x1d, 1)).is_empty());
    assert!(dut.ask(&rtu::write(0, 0x40, 1)).is_empty());
    assert_eq!(dut.read(0x1d), 0x1234);
}

#[test]
fn a_new_address_holds_from_the_next_frame() {
    let mut dut = ready();
    dut.write(0x00, 7);
    assert!(dut.ask(&rtu::read(1, 0, 1)).is_empty());
    assert_eq!(dut.ask(&rtu::read(7, 0, 1)), rtu::frame(7, &[3, 2, 0, 7]));
}

#[test]
fn a_new_line_holds_after_the_reply_has_left_with_the_old_one() {
    let mut dut = ready();
    dut.out.lines.clear();
    dut.write(0x1c, 0x0000); // 4800 8N1
    let (left, reply) = dut.sent()[0].clone();
    let line = Line::new(4_800, 8, drivetwin_protocol::line::Parity::None, 1);
    assert_eq!(dut.out.lines, [(left + CHARACTER * reply.len() as u64, Port(0), line)]);
}

#[test]
fn the_manuals_lines() {
    use drivetwin_protocol::line::Parity::{Even, None, Odd};
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
        assert_eq!(crate::md3::line(configuration), line);
    }
}

#[test]
fn a_drive_that_is_ready_at_0_listens_at_0() {
    let mut dut = ready();
    dut.input(Instant::ZERO, Input::Bytes { port: Port(0), bytes: &rtu::read(1, 0, 1) });
    dut.input(Instant::ZERO, Input::Idle { port: Port(0) });
    assert_eq!(dut.sent(), [(Instant::ZERO, rtu::frame(1, &[3, 2, 0, 1]))]);
}
