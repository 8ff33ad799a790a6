//! Section 6.5, MODE_ROTATION 2 and 3: moves by offset and to positions, exact to a Hall edge.

use drivetwin_protocol::time::Span;
use drivetwin_tests::rs434::{Rig, at};

/// Time longer than any move here takes, in s.
const MOVE: u64 = 30;

fn mover(mode: u16) -> Rig {
    let mut rig = Rig::default();
    rig.write(at::MODE_ROTATION, mode);
    rig
}

#[track_caller]
fn start(rig: &mut Rig) {
    rig.write(at::START, 1);
    rig.after(MOVE.secs());
    assert_eq!(rig.read(at::STATUS), 0, "it has arrived");
}

#[track_caller]
fn assert_at(rig: &mut Rig, position: i32) {
    assert_eq!(rig.read_long(at::CURRENT_POSITION), position);
    assert_eq!(rig.motion().position, position, "the shaft");
    // Ramps of 5,000 rps² may need more current than REF_CURRENT allows, so bit 11 may be set.
    let steep = [at::ACC, at::DEC].iter().any(|&ramp| rig.read(ramp) == 1_000);
    let accepted = if steep { 1 << 11 } else { 0 };
    assert_eq!(rig.read(at::ERROR) & !accepted, 0);
}

/// A move ends exactly, for any distance and ramps. OFFSET is then 0.
#[test]
fn section_6_5_offsets() {
    for (acc, dec, speed) in [(100, 100, 1_000), (10, 1_000, 2_500), (1_000, 10, 2_500), (20, 20, 60)] {
        let mut rig = mover(2);
        for (address, value) in [(at::ACC, acc), (at::DEC, dec), (at::SPEED, speed)] {
            rig.write(address, value);
        }
        let mut position = 0;
        for offset in [1, -1, 2, 7, -16, 100, -333, 400] {
            rig.write_long(at::OFFSET, offset);
            start(&mut rig);
            position += offset;
            assert_at(&mut rig, position);
            assert_eq!(rig.read_long(at::OFFSET), 0);
        }
    }
}

/// RS434-16: only the sign of OFFSET decides the direction. DIRECTION is for continuous rotation.
#[test]
fn section_6_5_offset_and_direction() {
    let mut rig = mover(2);
    rig.write(at::DIRECTION, 2);
    rig.write_long(at::OFFSET, 50);
    rig.write(at::START, 1);
    rig.after(50.millis());
    assert_eq!((rig.read(at::STATUS), rig.read(at::DIRECTION)), (1, 2));
    rig.after(MOVE.secs());
    assert_at(&mut rig, 50);
    rig.write(at::DIRECTION, 1);
    rig.write_long(at::OFFSET, -50);
    rig.write(at::START, 1);
    rig.after(50.millis());
    assert_eq!(rig.read(at::STATUS), 2);
    rig.after(MOVE.secs());
    assert_at(&mut rig, 0);
}

/// "A counter of the remaining movement": the remaining steps and the completed steps always add up to the
/// whole move. OFFSET only decreases.
#[test]
fn section_6_5_offset_counts_down() {
    let mut rig = mover(2);
    rig.write_long(at::OFFSET, 400);
    let [offset, position] =
        ["OFFSET", "CURRENT_POSITION"].map(|name| rig.bench.spec(rig.seat).find(name).expect("it").row);
    rig.write(at::START, 1);
    let (mut before, mut between) = (400, 0);
    for _ in 0..300 {
        rig.after(7.millis());
        let left = rig.bench.peek(rig.seat, offset);
        assert_eq!(left + rig.bench.peek(rig.seat, position), 400);
        assert!(left <= before);
        between += u32::from(left > 0 && left < 400);
        before = left;
    }
    assert!(between > 50, "it was seen on its way {between} times");
    assert_eq!(before, 0);
    assert_at(&mut rig, 400);
}

/// RS434-16: after STOP, OFFSET has the steps that remain after braking. The next START continues with
/// them.
#[test]
fn section_6_5_stop_in_an_offset() {
    let mut rig = mover(2);
    rig.write_long(at::OFFSET, 1_000);
    rig.write(at::START, 1);
    rig.after(1.secs());
    rig.write(at::STOP, 1);
    rig.after(2.secs());
    let (left, done) = (rig.read_long(at::OFFSET), rig.read_long(at::CURRENT_POSITION));
    assert_eq!((left + done, rig.read(at::STATUS)), (1_000, 0));
    assert!(done > 100 && left > 100, "{done} and {left}");
    start(&mut rig);
    assert_at(&mut rig, 1_000);
    // With OFFSET 0 a START moves nothing.
    start(&mut rig);
    assert_at(&mut rig, 1_000);
}

/// A move starts while the motor still turns the other way. OFFSET grows first, and is not 0 before the end
/// of the move.
#[test]
fn section_6_5_an_offset_against_the_motion() {
    let mut rig = mover(1);
    rig.write(at::DIRECTION, 2);
    rig.write(at::START, 1);
    rig.after(1.secs());
    rig.write(at::STOP, 1);
    rig.after(2.millis());
    rig.write(at::MODE_ROTATION, 2);
    rig.write_long(at::OFFSET, 100);
    let goal = rig.read_long(at::CURRENT_POSITION) + 100;
    rig.write(at::START, 1);
    let mut most = 0;
    while rig.read(at::STATUS) != 0 {
        let left = rig.read_long(at::OFFSET);
        assert_eq!(left + rig.read_long(at::CURRENT_POSITION), goal);
        most = most.max(left);
        rig.after(500.micros());
    }
    assert!(most > 100, "it turned on backward");
    assert_eq!((rig.read_long(at::OFFSET), rig.read_long(at::CURRENT_POSITION)), (0, goal));
}

/// "If the value of the register OFFSET_CONST ≠ 0, it is copied to the register OFFSET at every motor start."
#[test]
fn section_6_5_offset_const() {
    let mut rig = mover(2);
    rig.write_long(at::OFFSET_CONST, -40);
    rig.write_long(at::OFFSET, 1_000);
    for n in 1..=3 {
        start(&mut rig);
        assert_at(&mut rig, -40 * n);
        assert_eq!((rig.read_long(at::OFFSET), rig.read_long(at::OFFSET_CONST)), (0, -40));
    }
    rig.write_long(at::OFFSET_CONST, 0);
    rig.write_long(at::OFFSET, 20);
    start(&mut rig);
    assert_at(&mut rig, -100);
}

/// RS434-15: a START during a move has no effect. A move keeps the settings with which it started.
#[test]
fn section_6_5_writes_and_a_start_during_a_move_do_not_change_it() {
    let mut rig = mover(2);
    rig.write_long(at::OFFSET_CONST, 500);
    rig.write(at::START, 1);
    rig.after(200.millis());
    rig.write(at::START, 1);
    for (address, value) in [(at::SPEED, 30), (at::ACC, 10), (at::DEC, 1_000), (at::DIRECTION, 2)] {
        rig.write(address, value);
    }
    rig.write(at::MODE_ROTATION, 3);
    // 500 counts are 31.25 turns. They take 1.9 s at 1,000 rpm, and more than a minute at 30 rpm.
    rig.after(3.secs());
    assert_eq!(rig.read(at::STATUS), 0);
    assert_at(&mut rig, 500);
}

/// Mode 3: "The position number is specified by the POSITION_N register". The drive copies that position to
/// TARGET_POSITION. The four stored positions do not change.
#[test]
fn section_6_5_positions() {
    let positions = [120, -75, 1, 300];
    let mut rig = mover(3);
    for (n, position) in (0..).zip(positions) {
        rig.write_long(at::TARGET_POSITION1 + 2 * n, position);
    }
    for n in [1, 2, 3, 4, 2, 2, 1] {
        rig.write(at::POSITION_N, n);
        rig.write_long(at::TARGET_POSITION, 12_345);
        start(&mut rig);
        let position = positions[usize::from(n) - 1];
        assert_at(&mut rig, position);
        assert_eq!(rig.read_long(at::TARGET_POSITION), position);
    }
    for (n, position) in (0..).zip(positions) {
        assert_eq!(rig.read_long(at::TARGET_POSITION1 + 2 * n), position);
    }
}

/// The position is copied "before moving", so a write during the move does not change the move.
#[test]
fn section_6_5_a_position_changed_on_the_way() {
    let mut rig = mover(3);
    rig.write_long(at::TARGET_POSITION1, 300);
    rig.write(at::START, 1);
    rig.after(300.millis());
    rig.write_long(at::TARGET_POSITION1, 100);
    rig.write(at::POSITION_N, 2);
    rig.after(MOVE.secs());
    assert_at(&mut rig, 300);
    assert_eq!(rig.read_long(at::TARGET_POSITION), 300);
}

/// After CLR_POSITION positions count from the place where the shaft was then.
#[test]
fn section_6_5_positions_after_clr_position() {
    let mut rig = mover(3);
    rig.write_long(at::TARGET_POSITION1, 100);
    start(&mut rig);
    rig.write(at::CLR_POSITION, 1);
    start(&mut rig);
    assert_eq!(rig.read_long(at::CURRENT_POSITION), 100);
    assert_eq!(rig.motion().position, 200);
}

/// RS434-17: OFFSET_COMPENSATION extends a move in its direction. OFFSET still ends at 0.
#[test]
fn section_6_5_offset_compensation() {
    for (offset, compensation, end) in
        [(200, -15, 185), (200, 15, 215), (-200, -15, -185), (-200, 15, -215), (200, 0, 200)]
    {
        let mut rig = mover(2);
        rig.write(at::OFFSET_COMPENSATION, i16::cast_unsigned(compensation));
        rig.write_long(at::OFFSET, offset);
        start(&mut rig);
        assert_eq!(rig.read_long(at::CURRENT_POSITION), end, "{offset} and {compensation}");
        assert_eq!(rig.read_long(at::OFFSET), 0);
    }
}

/// If a negative OFFSET_COMPENSATION is longer than the move, the motor does not move.
#[test]
fn section_6_5_more_compensation_than_way() {
    for offset in [10, -10] {
        let mut rig = mover(2);
        rig.write(at::OFFSET_COMPENSATION, i16::cast_unsigned(-15));
        rig.write_long(at::OFFSET, offset);
        rig.write(at::START, 1);
        assert_eq!(rig.read(at::STATUS), 0);
        rig.after(1.secs());
        assert_at(&mut rig, 0);
        assert_eq!(rig.read_long(at::OFFSET), 0);
    }
}

/// RS434-15: a move keeps its speed if PULSES_PER_REVOLUTION is changed during the move.
#[test]
fn section_6_5_other_pulses_in_a_move() {
    for pulses in [1, 12] {
        let mut rig = mover(2);
        rig.write_long(at::OFFSET, 2_000);
        rig.write(at::START, 1);
        rig.after(1.secs());
        rig.write(at::PULSES, pulses);
        rig.after(1.secs());
        let speed = rig.read(at::SPEED_VALID);
        assert!((950..=1_050).contains(&speed), "{pulses} pulses: {speed} rpm instead of 1,000");
        rig.after(30.secs());
        assert_eq!((rig.read(at::STATUS), rig.read(at::ERROR)), (0, 0));
        assert_at(&mut rig, 2_000);
    }
}

/// ERROR bit 15: "using positioning mode with less than two Hall sensors". The motor does not move
/// (RS434-18).
#[test]
fn section_6_5_moves_want_two_sensors() {
    for mode in [2, 3] {
        for halls in [0, 1] {
            let mut rig = mover(mode);
            rig.write(at::USE_HALL, halls);
            rig.write_long(at::OFFSET, 100);
            rig.write_long(at::TARGET_POSITION1, 100);
            start(&mut rig);
            assert_eq!((rig.motion().position, rig.read(at::ERROR)), (0, 1 << 15));
            rig.write(at::ERROR, 0);
            assert_eq!(rig.read(at::ERROR), 0);
        }
    }
}

/// RS434-15: if USE_HALL is reduced during a move, the move ends, and ERROR bit 15 is set.
#[test]
fn section_6_5_a_move_that_loses_its_sensors() {
    for mode in [2, 3] {
        for halls in [0, 1] {
            let mut rig = mover(mode);
            rig.write_long(at::OFFSET, 1_000);
            rig.write_long(at::TARGET_POSITION1, 1_000);
            rig.write(at::START, 1);
            rig.after(1.secs());
            assert_eq!(rig.read(at::STATUS), 1);
            // 1,000 rpm are 267 counts/s. A ramp of about 30 ms adds 4 counts.
            let before = rig.motion().position;
            rig.write(at::USE_HALL, halls);
            assert_eq!(rig.read(at::ERROR), 1 << 15, "{halls} sensors");
            rig.after(2.secs());
            let case = format!("MODE_ROTATION {mode}, {halls} sensors");
            assert_eq!((rig.read(at::STATUS), rig.motion().speed.to_num::<f64>()), (0, 0.0), "{case}");
            // The motor brakes with DEC, or without a speed signal. It stops within half of the move.
            let on = rig.motion().position - before;
            assert!((0..500).contains(&on), "{case}: {on} counts more");
        }
    }
}

/// The other model, with another number of pulses and a higher current: a move ends exactly, too.
#[test]
fn section_6_5_moves_of_the_other_model() {
    let mut rig = Rig::ready("rs434546");
    rig.write(at::PULSES, 12);
    rig.write(at::RATED_SPEED, 6_000);
    rig.write(at::SPEED, 4_000);
    rig.write(at::MODE_ROTATION, 2);
    rig.write_long(at::OFFSET, 50_000);
    start(&mut rig);
    assert_at(&mut rig, 50_000);
}
