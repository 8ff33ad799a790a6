//! Limit switches (p. 7, p. 9; MDROBOT-23). With UI_COM 1 and USE_LIMIT_SW 1 a closed DIR permits CW, and a
//! closed START/STOP permits CCW.

use drivetwin_protocol::time::Span;
use drivetwin_sim::bench::{Closed, PinStimulus};

use crate::pid;
use crate::rig::Rig;

/// Each direction: the switch that permits it, the other switch, and the sign of the speed.
const WAYS: [(&str, &str, i16); 2] = [("START_STOP", "DIR", 1), ("DIR", "START_STOP", -1)];

/// A rig commanded by the bus, with both switches closed.
fn between(settings: &[(u16, u16)]) -> Rig {
    let mut rig = Rig::armed(settings);
    rig.close("DIR");
    rig.close("START_STOP");
    rig
}

#[test]
fn page_7_each_switch_stops_its_own_way() {
    for condition in [0, 1] {
        for (switch, other, sign) in WAYS {
            let mut rig = between(&[(pid::LIMIT_STOP_COND, condition)]);
            rig.velocity(sign * 1_000);
            rig.assert_turns(f64::from(sign) * 1_000.0);
            rig.open(other);
            rig.assert_turns(f64::from(sign) * 1_000.0);
            rig.close(other);
            rig.open(switch);
            rig.after(10.millis());
            // "1: BRAKE (electric braking), 0: natural stop (free)".
            let current = rig.amperes();
            if condition == 1 {
                assert!(current > 1.0, "{current} A");
            } else {
                assert_eq!(current, 0.0);
            }
            rig.after(400.millis());
            let shaft = rig.shaft().abs();
            if condition == 1 {
                assert_eq!(shaft, 0.0);
            } else {
                assert!(shaft > 500.0, "{shaft}");
            }
            rig.after(20.secs());
            rig.assert_stands();
            // A command in the forbidden direction is echoed and does not move the motor.
            let position = rig.position();
            rig.velocity(sign * 500);
            rig.assert_stands();
            assert_eq!((rig.position(), rig.signed(pid::VEL_CMD)), (position, sign * 500));
            // The opposite direction is permitted.
            rig.velocity(sign * -500);
            rig.assert_turns(f64::from(sign) * -500.0);
            rig.write(pid::BRAKE, 0);
            rig.assert_stands();
            // When the switch closes again, the stopped motion does not resume. The next command drives.
            rig.close(switch);
            rig.assert_stands();
            rig.velocity(sign * 500);
            rig.assert_turns(f64::from(sign) * 500.0);
        }
    }
}

/// An open switch drops the reference, so nothing moves when it closes again, until the next command.
#[test]
fn page_7_the_reference_is_dropped() {
    for (switch, _, sign) in WAYS {
        let mut rig = between(&[(pid::LIMIT_STOP_COND, 1)]);
        rig.velocity(sign * 600);
        rig.assert_turns(f64::from(sign) * 600.0);
        rig.open(switch);
        rig.after(500.millis());
        rig.close(switch);
        rig.assert_stands();
        rig.velocity(sign * 600);
        rig.assert_turns(f64::from(sign) * 600.0);
    }
}

/// Limit switches also stop position, open loop and torque commands.
#[test]
fn page_7_other_commands() {
    for (switch, _, sign) in WAYS {
        let mut rig = between(&[(pid::LIMIT_STOP_COND, 1)]);
        rig.write_move(pid::POSI_VEL_CMD, i32::from(sign) * 2_400, 600);
        rig.after(3.secs());
        assert!(rig.position().abs() > 200, "on its way");
        rig.open(switch);
        rig.after(500.millis());
        rig.assert_stands();
        rig.close(switch);
        rig.assert_stands();
        rig.write_long(pid::POSI_CMD, 0);
        rig.after(5.secs());
        assert!(rig.position().abs() <= 1, "{}", rig.position());
        for pid in [pid::OPEN_VEL_CMD, pid::TQ_CMD] {
            rig.write_signed(pid, sign * 500);
            rig.after(300.millis());
            assert!(rig.shaft() * f64::from(sign) > 100.0, "PID {pid}: {}", rig.shaft());
            rig.open(switch);
            rig.after(1.secs());
            assert_eq!(rig.shaft(), 0.0, "PID {pid}");
            rig.close(switch);
            rig.assert_stands();
        }
    }
}

/// Switches have no effect without USE_LIMIT_SW, without UI_COM, or without a wire.
#[test]
fn page_7_where_they_do_not_act() {
    for (switch, _, sign) in WAYS {
        let mut rig = between(&[(pid::USE_LIMIT_SW, 0)]);
        rig.velocity(sign * 500);
        rig.open(switch);
        rig.assert_turns(f64::from(sign) * 500.0);
        // USE_LIMIT_SW is set while the switch is open, so the motion is forbidden.
        rig.set(&[(pid::LIMIT_STOP_COND, 1), (pid::USE_LIMIT_SW, 1)]);
        rig.after(500.millis());
        rig.assert_stands();
        // First the wire is removed, then there is a rig that never had one.
        let mut rig = between(&[]);
        rig.velocity(sign * 500);
        rig.drive(switch, PinStimulus::Open);
        rig.assert_turns(f64::from(sign) * 500.0);
        let mut rig = Rig::armed(&[]);
        rig.velocity(sign * 500);
        rig.assert_turns(f64::from(sign) * 500.0);
    }
}

/// The switch is already open when the command is given.
#[test]
fn page_7_open_from_the_beginning() {
    for (switch, _, sign) in WAYS {
        let mut rig = between(&[]);
        rig.open(switch);
        rig.velocity(sign * 500);
        rig.assert_stands();
        assert_eq!(rig.position(), 0);
        rig.write_move(pid::INC_POSI_VEL_CMD, i32::from(sign) * 60, 300);
        rig.assert_stands();
        assert_eq!(rig.position(), 0);
        rig.write_move(pid::INC_POSI_VEL_CMD, i32::from(sign) * -60, 300);
        rig.after(4.secs());
        assert!(rig.position().abs_diff(i32::from(sign) * -60) <= 1, "{}", rig.position());
    }
}

/// A load of 0.3 Nm pulls the shaft past its switch, while MAX_LOAD allows 1.2 Nm. Commands away from the
/// switch drive the shaft back, with any SLOW_DOWN. Commands further past it are echoed and dropped.
#[test]
fn page_7_a_load_that_pulls_past_a_switch() {
    let orders: [fn(&mut Rig, i16); 2] =
        [|rig, sign| rig.velocity(sign * -500), |rig, _| rig.write_move(pid::POSI_VEL_CMD, 0, 500)];
    for condition in [0, 1] {
        for (switch, other, sign) in WAYS {
            for (which, order) in orders.into_iter().enumerate() {
                let settings = [(pid::LIMIT_STOP_COND, condition), (pid::SLOW_DOWN, 1_023)];
                // A negative load pulls forward, which is CCW.
                let (mut rig, motor) =
                    Rig::turning(&settings, |motor| motor.load_unm = i32::from(sign) * -300_000);
                let closed = if sign > 0 {
                    Closed { above_rev: None, below_rev: Some(2.0) }
                } else {
                    Closed { above_rev: Some(-2.0), below_rev: None }
                };
                let pin = (rig.seat, rig.pin(switch));
                rig.bench.switch(motor, closed, pin);
                rig.close(other);
                rig.velocity(sign * 300);
                rig.after(1.secs());
                let (shaft, past) = (rig.shaft() * f64::from(sign), rig.position());
                assert!(shaft > 100.0 && past.abs() > 24, "the load pulls on: {shaft} rpm, {past} counts");
                // These commands are echoed but not executed.
                rig.velocity(sign * 500);
                rig.velocity(0);
                rig.after(10.millis());
                assert!(rig.shaft() * f64::from(sign) >= 0.9 * shaft, "{}", rig.shaft());
                let past = rig.position();
                order(&mut rig, sign);
                rig.after(2.secs());
                let on = (rig.position() - past) * i32::from(sign);
                // The shaft stops after at most 0.4 s, from about 4,000 rpm: 0.9 Nm on 5e-4 kg m2 are 17,000
                // rpm/s.
                assert!(on < 12 * 20, "{which}: {on} counts further");
                rig.after(30.secs());
                let at = rig.position() * i32::from(sign);
                if which == 0 {
                    assert!(at < -12, "{at} counts: past the switch and further back");
                } else {
                    assert!(at.abs() <= 1, "{at}");
                }
                assert_eq!(rig.status(), (0, 0));
            }
        }
    }
}

/// The direction of the shaft decides which switch counts, so INV_SIGN_CMD makes no difference.
#[test]
fn page_7_with_inv_sign() {
    for (switch, other, sign) in WAYS {
        let mut rig = between(&[(pid::INV_SIGN_CMD, 1), (pid::LIMIT_STOP_COND, 1)]);
        rig.velocity(sign * -500);
        rig.assert_turns(f64::from(sign) * 500.0);
        rig.open(other);
        rig.assert_turns(f64::from(sign) * 500.0);
        rig.open(switch);
        rig.after(500.millis());
        rig.assert_stands();
    }
}
