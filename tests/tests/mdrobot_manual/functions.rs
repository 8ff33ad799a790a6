//! Special functions (p. 17, p. 18; MDROBOT-20).

use drivetwin_protocol::time::{Duration, Span};

use crate::pid;
use crate::rig::Rig;

const SPEED: u16 = 1;
const POSITION: u16 = 2;
const SPEED_MOMENTARY: u16 = 3;
const SPEED_ADD: u16 = 4;

/// A rig with a function of 600 rpm for 2.0 s. The function ends with the brake, so that its end is visible.
fn function(kind: u16) -> Rig {
    let mut rig = Rig::with(&[(pid::FUNC_CMD_TYPE, kind), (pid::STOP_STATUS, 2)]);
    rig.write_words(pid::FUNC_SPEED, &[600, 20]);
    rig
}

/// Asserts that the motor now turns at the speed of the function.
#[track_caller]
fn assert_runs(rig: &mut Rig, rpm: f64) {
    assert!((rig.rpm() - rpm).abs() <= rpm.abs() * 0.03, "{} rpm, not {rpm}", rig.rpm());
}

#[track_caller]
fn assert_rests(rig: &Rig) {
    assert_eq!(rig.shaft(), 0.0, "it rests");
}

/// "Motor moves when the signal is ON from OFF": the motor turns for the run time, counted from the rising
/// edge. Later changes of the signal have no effect.
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
        // The signal is still ON, so there is no edge. Writing the same word again makes no edge either.
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
            // The brake shorts the windings, so the duty is 0.
            if ended.is_none() && t > 50.millis() && rig.motion().duty == 0 {
                ended = Some(t);
            }
        });
        let ended = ended.expect("an end");
        let due = Duration::millis(100) * u64::from(tenths);
        assert!(ended >= due && ended <= due + 20.millis(), "{tenths} tenths lasted {ended:?}");
    }
}

/// "Only applied while on": the run time is ignored.
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

/// "If the signal is ON then motor run continuously regardless of delay": the motor turns until the signal is
/// OFF and the run time is over.
#[test]
fn page_18_speed_add() {
    // The signal goes OFF before the run time ends.
    let mut rig = function(SPEED_ADD);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(500.millis());
    rig.write(pid::FUNC_CMD, 0);
    rig.after(1_490.millis());
    assert_runs(&mut rig, 600.0);
    rig.after(310.millis());
    assert_rests(&rig);
    // The run time ends before the signal goes OFF.
    rig.write(pid::FUNC_CMD, 1);
    rig.after(5.secs());
    assert_runs(&mut rig, 600.0);
    rig.write(pid::FUNC_CMD, 0);
    rig.after(300.millis());
    assert_rests(&rig);
}

/// "Motor moves to the target position when the signal is ON from OFF". FUNC_POSI is a signed increment
/// (MDROBOT-20).
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

/// Factory values: 240 counts, which are 20 turns of a motor with four poles, at 1,500 rpm.
#[test]
fn page_17_factory_functions() {
    let mut rig = Rig::with(&[(pid::FUNC_CMD_TYPE, POSITION)]);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(5.secs());
    assert!(rig.position().abs_diff(240) <= 1, "{}", rig.position());
    // The factory values of the speed function are 1,000 rpm for 1 s.
    let mut rig = Rig::with(&[(pid::FUNC_CMD_TYPE, SPEED), (pid::STOP_STATUS, 2)]);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(990.millis());
    assert_runs(&mut rig, 1_000.0);
    rig.after(310.millis());
    assert_rests(&rig);
}

/// While the pins command, START/STOP acts like FUNC_CMD (p. 17). START_INV_SIGN inverts it, too.
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
        // With UI_COM 1 the pin can only be a limit switch.
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

/// If FUNC_CMD_TYPE is set, the motor is "used by start/stop only" (p. 15). Other commands are answered but
/// do not move it.
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
    // If FUNC_CMD_TYPE is 0, FUNC_CMD does not move the motor.
    let mut rig = Rig::armed(&[]);
    rig.write(pid::FUNC_CMD, 1);
    rig.assert_stands();
    assert_eq!(rig.position(), 0);
}

/// A change of FUNC_CMD_TYPE, also to 0, ends the running function (MDROBOT-20).
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

/// Negative speeds, INV_SIGN_CMD, SLOW_START and SLOW_DOWN apply to functions (MDROBOT-15, MDROBOT-16).
#[test]
fn page_17_direction_and_ramps() {
    let mut rig = function(SPEED_MOMENTARY);
    rig.write_words(pid::FUNC_SPEED, &[(-600_i16).cast_unsigned(), 20]);
    rig.write(pid::FUNC_CMD, 1);
    rig.after(1.secs());
    assert_runs(&mut rig, -600.0);
    rig.write(pid::FUNC_CMD, 0);
    rig.after(300.millis());
    // 682 of 1,023 is 10 s for 3,000 rpm, and so 2 s for 600 rpm.
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

/// TQ_OFF and BRAKE end a function. The next edge starts another.
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
