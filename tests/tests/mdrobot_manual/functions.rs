//! Special functions (p. 17, p. 18; MDROBOT-20).

use drivetwin_protocol::time::{Duration, Span};

use crate::pid;
use crate::rig::Rig;

const SPEED: u16 = 1;
const POSITION: u16 = 2;
const SPEED_MOMENTARY: u16 = 3;
const SPEED_ADD: u16 = 4;

/// 600 rpm for 2.0 s; at the end the brake shows when it came.
fn function(kind: u16) -> Rig {
    let mut rig = Rig::with(&[(pid::FUNC_CMD_TYPE, kind), (pid::STOP_STATUS, 2)]);
    rig.write_words(pid::FUNC_SPEED, &[600, 20]);
    rig
}

/// Asserts that it turns at the function's speed now.
#[track_caller]
fn assert_runs(rig: &mut Rig, rpm: f64) {
    assert!((rig.rpm() - rpm).abs() <= rpm.abs() * 0.03, "{} rpm, not {rpm}", rig.rpm());
}

#[track_caller]
fn assert_rests(rig: &Rig) {
    assert_eq!(rig.shaft(), 0.0, "it rests");
}

/// "Motor moves when the signal is ON from OFF": for its run time from the edge, with any further changes of the
/// signal.
#[test]
fn page_17_speed() {
    for word in [1, 2, 0x0100, 0xFFFF] {
        let mut rig = function(SPEED);
        rig.write(pid::FUNC_CMD, word);
        rig.after(1.secs());
        assert_runs(&mut rig, 600.0);
        rig.write(pid::FUNC_CMD, 0);
        rig.after(300.millis());
        rig.write(pid::FUNC_CMD, word);
        rig.after(690.millis());
        assert_runs(&mut rig, 600.0);
        rig.after(310.millis());
        assert_rests(&rig);
        // It is ON still: no edge. Written again, neither.
        rig.after(2.secs());
        rig.write(pid::FUNC_CMD, word);
        rig.assert_stands();
        rig.write(pid::FUNC_CMD, 0);
        rig.after(1.millis());
        rig.write(pid::FUNC_CMD, word);
        rig.after(1_990.millis());
        assert_runs(&mut rig, 600.0);
        rig.after(310.millis());
        assert_rests(&rig);
    }
}

/// "Delay(run time, 0.1s unit), 10->1s" (p. 16).
#[test]
fn page_17_speed_times() {
    for tenths in [3_u16, 10, 35] {
        let mut rig = function(SPEED);
        rig.write_words(pid::FUNC_SPEED, &[1_000, tenths]);
        rig.write(pid::FUNC_CMD, 1);
        let mut ended = None;
        rig.watch(Duration::millis(100) * u64::from(tenths + 10), 5.millis(), |rig, t| {
            // The brake shorts the windings: no part of the supply.
            if ended.is_none() && t > 50.millis() && rig.motion().duty == 0 {
                ended = Some(t);
            }
        });
        let ended = ended.expect("an end");
        let due = Duration::millis(100) * u64::from(tenths);
        assert!(ended >= due && ended <= due + 20.millis(), "{tenths} tenths lasted {ended:?}");
    }
}

/// "Only applied while on": on time is ignored.
#[test]
fn page_18_speed_momentary() {
    let mut rig = function(SPEED_MOMENTARY);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(5.secs());
    assert_runs(&mut rig, 600.0);
    rig.write(pid::FUNC_CMD, 0);
    rig.after(300.millis());
    assert_rests(&rig);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(500.millis());
    assert_runs(&mut rig, 600.0);
    rig.write(pid::FUNC_CMD, 0);
    rig.after(300.millis());
    assert_rests(&rig);
}

/// "If the signal is ON then motor run continuously regardless of delay": until both are over.
#[test]
fn page_18_speed_add() {
    // OFF first, then the time.
    let mut rig = function(SPEED_ADD);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(500.millis());
    rig.write(pid::FUNC_CMD, 0);
    rig.after(1_490.millis());
    assert_runs(&mut rig, 600.0);
    rig.after(310.millis());
    assert_rests(&rig);
    // The time first, then OFF.
    rig.write(pid::FUNC_CMD, 1);
    rig.after(5.secs());
    assert_runs(&mut rig, 600.0);
    rig.write(pid::FUNC_CMD, 0);
    rig.after(300.millis());
    assert_rests(&rig);
}

/// "Motor moves to the target position when the signal is ON from OFF": by an increment, signed (MDROBOT-20).
#[test]
fn page_18_position() {
    let mut rig = Rig::with(&[(pid::FUNC_CMD_TYPE, POSITION)]);
    let mut goal = 0;
    for (counts, rpm) in [(240_i16, 600), (240, 600), (-100, 600), (-600, 1_000), (12, 100)] {
        rig.write_words(pid::FUNC_POSI, &[rpm, counts.cast_unsigned()]);
        rig.write(pid::FUNC_CMD, 1);
        let from = rig.position();
        let mut fastest = 0.0_f64;
        rig.watch(8.secs(), 10.millis(), |rig, _| fastest = fastest.max(rig.shaft().abs()));
        goal += i32::from(counts);
        assert!(
            rig.position().abs_diff(from + i32::from(counts)) <= 1,
            "{} after {counts} from {from}",
            rig.position()
        );
        assert!(rig.position().abs_diff(goal) <= 5);
        assert!(fastest <= f64::from(rpm) * 1.15, "{fastest}");
        rig.write(pid::FUNC_CMD, 0);
        rig.after(500.millis());
        assert!(rig.position().abs_diff(from + i32::from(counts)) <= 1, "it is held");
    }
}

/// MAX_RPM limits the speed of functions, too (MDROBOT-18).
#[test]
fn page_16_function_speeds_and_max_rpm() {
    let mut rig = Rig::with(&[(pid::FUNC_CMD_TYPE, POSITION), (pid::MAX_RPM, 500)]);
    rig.write_words(pid::FUNC_POSI, &[2_000, 600]);
    rig.write(pid::FUNC_CMD, 1);
    let mut fastest = 0.0_f64;
    rig.watch(10.secs(), 10.millis(), |rig, _| fastest = fastest.max(rig.shaft()));
    assert!((450.0..=575.0).contains(&fastest), "{fastest}");
    assert_eq!(rig.words(pid::FUNC_POSI, 2), [2_000, 600]);
    rig.write(pid::FUNC_CMD, 0);
    rig.write(pid::FUNC_CMD_TYPE, SPEED_MOMENTARY);
    rig.write_words(pid::FUNC_SPEED, &[2_000, 20]);
    rig.write(pid::FUNC_CMD, 1);
    rig.assert_turns(500.0);
}

/// The factory's: 240 counts, 20 turns of a motor of four poles, at 1,500 rpm.
#[test]
fn page_17_factory_functions() {
    let mut rig = Rig::with(&[(pid::FUNC_CMD_TYPE, POSITION)]);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(5.secs());
    assert!(rig.position().abs_diff(240) <= 1, "{}", rig.position());
    // 1,000 rpm for a second.
    let mut rig = Rig::with(&[(pid::FUNC_CMD_TYPE, SPEED), (pid::STOP_STATUS, 2)]);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(990.millis());
    assert_runs(&mut rig, 1_000.0);
    rig.after(310.millis());
    assert_rests(&rig);
}

/// START/STOP does as FUNC_CMD, while the pins command (p. 17); its inversion holds, too.
#[test]
fn page_17_start_stop() {
    for inverted in [false, true] {
        let mut rig = function(SPEED_MOMENTARY);
        rig.write(pid::START_INV_SIGN, inverted.into());
        let on = |rig: &mut Rig, on: bool| {
            if on == inverted { rig.open("START_STOP") } else { rig.close("START_STOP") }
        };
        on(&mut rig, false);
        rig.assert_stands();
        on(&mut rig, true);
        rig.after(1.secs());
        assert_runs(&mut rig, 600.0);
        on(&mut rig, false);
        rig.after(300.millis());
        assert_rests(&rig);
        // With UI_COM the pin is a limit switch at most.
        rig.set(&[(pid::USE_LIMIT_SW, 0), (pid::UI_COM, 1)]);
        on(&mut rig, true);
        rig.assert_stands();
        rig.write(pid::FUNC_CMD, 1);
        rig.after(1.secs());
        assert_runs(&mut rig, 600.0);
    }
    let mut rig = function(SPEED);
    rig.close("START_STOP");
    rig.after(100.millis());
    rig.open("START_STOP");
    rig.after(1_890.millis());
    assert_runs(&mut rig, 600.0);
    rig.after(310.millis());
    assert_rests(&rig);
}

/// With a type the motor is "used by start/stop only" (p. 15): other commands are answered.
#[test]
fn page_15_nothing_else_drives() {
    for kind in [SPEED, POSITION, SPEED_MOMENTARY, SPEED_ADD] {
        let mut rig = Rig::armed(&[(pid::FUNC_CMD_TYPE, kind)]);
        rig.velocity(600);
        rig.set(&[(pid::COM_TAR_SPEED, 600), (pid::OPEN_VEL_CMD, 600), (pid::TQ_CMD, 600)]);
        rig.write_long(pid::POSI_CMD, 600);
        rig.assert_stands();
        assert_eq!((rig.position(), rig.read(pid::VEL_CMD)), (0, 600), "type {kind}");
    }
    // And without one FUNC_CMD does not.
    let mut rig = Rig::armed(&[]);
    rig.write(pid::FUNC_CMD, 1);
    rig.assert_stands();
    assert_eq!(rig.position(), 0);
}

/// Another type, or none, ends the running function (MDROBOT-20).
#[test]
fn page_17_another_type() {
    for (from, to) in [(SPEED, 0), (SPEED_MOMENTARY, 0), (SPEED_ADD, SPEED), (SPEED_MOMENTARY, POSITION)] {
        let mut rig = function(from);
        rig.write_words(pid::FUNC_SPEED, &[600, 100]);
        rig.write(pid::FUNC_CMD, 1);
        rig.after(1.secs());
        assert_runs(&mut rig, 600.0);
        rig.write(pid::FUNC_CMD_TYPE, to);
        rig.after(500.millis());
        assert_rests(&rig);
        rig.assert_stands();
    }
}

/// Negative speeds, INV_SIGN, SLOW_START and SLOW_DOWN hold for them (MDROBOT-15, MDROBOT-16).
#[test]
fn page_17_direction_and_ramps() {
    let mut rig = function(SPEED_MOMENTARY);
    rig.write_words(pid::FUNC_SPEED, &[(-600_i16).cast_unsigned(), 20]);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(1.secs());
    assert_runs(&mut rig, -600.0);
    rig.write(pid::FUNC_CMD, 0);
    rig.after(300.millis());
    // 682 of 1,023 are 10 s for 3,000 rpm: 2 s for 600.
    rig.set(&[(pid::INV_SIGN_CMD, 1), (pid::SLOW_START, 682), (pid::SLOW_DOWN, 682)]);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(1.secs());
    assert!((rig.rpm() - 300.0).abs() <= 48.0, "{}", rig.rpm());
    rig.after(1_500.millis());
    assert_runs(&mut rig, 600.0);
    rig.write(pid::FUNC_CMD, 0);
    rig.after(1.secs());
    assert!((rig.rpm() - 300.0).abs() <= 48.0, "{}", rig.rpm());
    rig.after(1_500.millis());
    assert_rests(&rig);
}

/// TQ_OFF and BRAKE end a function; the next edge starts one.
#[test]
fn page_17_tq_off() {
    for code in [2, 4] {
        let mut rig = function(SPEED);
        rig.write_words(pid::FUNC_SPEED, &[600, 100]);
        rig.write(pid::FUNC_CMD, 1);
        rig.after(1.secs());
        rig.command(code);
        rig.after(20.secs());
        rig.assert_stands();
        rig.write(pid::FUNC_CMD, 0);
        rig.after(10.millis());
        rig.write(pid::FUNC_CMD, 1);
        rig.after(1.secs());
        assert_runs(&mut rig, 600.0);
    }
}
