//! Velocity, ramps and stopping (p. 8, p. 12, p. 13; MDROBOT-16 to MDROBOT-18). The tolerances are those of a
//! controller of this size with factory gains, without load, at 24 V.

use drivetwin_protocol::time::{Duration, Span};

use crate::pid;
use crate::rig::Rig;

/// From 2 s after the command every sample is within 1 % or 2 rpm. The counts agree.
#[test]
fn velocity_steady() {
    for (hall_type, poles) in [(0, 4.0), (2, 10.0)] {
        for rpm in [100_i16, 250, 600, 1_000, 1_700, 2_500, -100, -1_000, -2_500] {
            let mut rig = Rig::with_poles(hall_type, poles, &[]);
            rig.velocity(rpm);
            rig.after(2.secs());
            let (from, rpm) = (rig.position(), f64::from(rpm));
            let within = (rpm.abs() / 100.0).max(2.0);
            rig.watch(6.secs(), 7.millis(), |rig, t| {
                assert!((rig.rpm() - rpm).abs() <= within, "{} rpm, not {rpm}, after {t:?}", rig.rpm());
            });
            // 857 samples of 7 ms.
            let counts = rpm / 60.0 * 3.0 * poles * 5.999;
            let counted = f64::from(rig.position() - from);
            assert!(
                (counted - counts).abs() <= counts.abs() * 0.02 + 2.0,
                "{counted} counts, not {counts:.0}"
            );
        }
    }
}

#[test]
fn velocity_slow_and_zero() {
    for (hall_type, poles) in [(0, 4.0), (2, 10.0)] {
        for rpm in [40_i16, -40] {
            let mut rig = Rig::with_poles(hall_type, poles, &[]);
            rig.velocity(rpm);
            rig.after(2.secs());
            rig.watch(10.secs(), 11.millis(), |rig, t| {
                assert!((rig.rpm() - f64::from(rpm)).abs() <= 4.0, "{} rpm after {t:?}", rig.rpm());
            });
            rig.velocity(0);
            rig.after(10.secs());
            rig.assert_stands();
        }
    }
}

/// A step from 0 to 1,000 rpm without a ramp: RPM_DATA is neither immediate nor late, and does not overshoot
/// much.
#[test]
fn velocity_step() {
    for (hall_type, poles) in [(0, 4.0), (2, 10.0)] {
        for sign in [1_i16, -1] {
            let mut rig = Rig::with_poles(hall_type, poles, &[]);
            rig.velocity(sign * 1_000);
            let rpm = |rig: &mut Rig| rig.rpm() * f64::from(sign);
            assert!(rpm(&mut rig) <= 600.0);
            let (mut reached, mut most, mut before) = (None, 0.0_f64, 0.0);
            rig.watch(3.secs(), 2.millis(), |rig, t| {
                let now = rpm(rig);
                assert!(now >= -20.0, "{now} rpm after {t:?}");
                // J = 5,000 g cm², 20 A and 0.06 Nm/A make 2,400 rad/s², 46 rpm in 2 ms. Hall sensors show
                // the change later, in larger steps.
                assert!(rig.shaft().abs() - before <= 60.0, "from {before} to {} rpm in 2 ms", rig.shaft());
                before = rig.shaft().abs();
                most = most.max(now);
                if now >= 900.0 && reached.is_none() {
                    reached = Some(t);
                }
            });
            let reached = reached.expect("900 rpm");
            assert!(reached <= 580.millis(), "{reached:?}");
            assert!(most <= 1_200.0, "{most}");
            assert!((rpm(&mut rig) - 1_000.0).abs() <= 10.0);
        }
    }
}

/// Changes from one speed to another, also through zero.
#[test]
fn velocity_changes() {
    let mut rig = Rig::armed(&[]);
    for rpm in [1_000, 1_500, 300, -300, 2_000, -2_000, 100, 2_500, -2_500, 500] {
        rig.velocity(rpm);
        rig.assert_turns(f64::from(rpm));
    }
    assert_eq!(rig.status(), (0, 0));
}

/// SLOW_START and SLOW_DOWN: 0 to 1,023 are 0 to 15 s for MAX_RPM (p. 13). The speed is always within 8 % of
/// the step, and settles within half a second. The motor counts as at rest when no edge was received for a
/// second.
#[test]
fn ramps() {
    for (max_rpm, slow_start, slow_down) in
        [(3_000, 205, 205), (3_000, 205, 137), (3_000, 137, 205), (1_500, 205, 205), (3_000, 1_023, 512)]
    {
        let per_rpm = |slow: u16| 15.0 * f64::from(slow) / 1_023.0 / f64::from(max_rpm);
        let ramps = Ramps { up: per_rpm(slow_start), down: per_rpm(slow_down) };
        let settings = [(pid::MAX_RPM, max_rpm), (pid::SLOW_START, slow_start), (pid::SLOW_DOWN, slow_down)];
        for sign in [1.0, -1.0] {
            let mut rig = Rig::armed(&settings);
            rig.write(pid::STOP_STATUS, 1);
            let mut from = 0.0;
            for to in [1_400.0, 600.0, 1_200.0, 0.0, 900.0, -1_200.0, 500.0] {
                ramps.assert_followed(&mut rig, from * sign, to * sign);
                from = to;
            }
        }
    }
}

/// Durations of the ramps, in seconds per rpm.
struct Ramps {
    up: f64,
    down: f64,
}

impl Ramps {
    /// The reference `t` seconds after the command, and the total duration of its ramps. Ramps apply to the
    /// magnitude, so a reversal goes down by SLOW_DOWN and then up by SLOW_START (MDROBOT-16).
    fn reference(&self, from: f64, to: f64, t: f64) -> (f64, f64) {
        let way = (to - from).signum();
        if from * to < 0.0 {
            let first = from.abs() * self.down;
            let second = to.abs() * self.up;
            let at = if t < first { from + way * t / self.down } else { way * (t - first) / self.up };
            return (if t < first + second { at } else { to }, first + second);
        }
        let per_rpm = if to.abs() > from.abs() { self.up } else { self.down };
        let seconds = (to - from).abs() * per_rpm;
        (if t < seconds { from + way * t / per_rpm } else { to }, seconds)
    }

    /// Below this speed RPM_DATA may be anything down to zero: a motor that starts has no measured speed
    /// before its second Hall edge, and v² = 2 a x.
    fn unseen(&self, rig: &Rig) -> f64 {
        let rpm_a_second = 1.0 / self.up.min(self.down);
        let counts = 2.0 / (3.0 * rig.poles);
        (2.0 * rpm_a_second / 60.0 * counts).sqrt() * 60.0
    }

    /// Commands the speed `to`, and compares the speed of the shaft and RPM_DATA with the reference.
    #[track_caller]
    fn assert_followed(&self, rig: &mut Rig, from: f64, to: f64) {
        rig.velocity(to as i16);
        let (_, seconds) = self.reference(from, to, 0.0);
        let step = (to - from).abs() * 0.08;
        let unseen = self.unseen(rig);
        // A shaft without an edge for a second counts as at rest.
        let settles = if to == 0.0 { 1.2 } else { 0.5 };
        let mut seen = 0;
        rig.watch(Duration::from_ticks(((seconds + 1.5) * 16e6) as u64), 20.millis(), |rig, t| {
            let t = t.ticks() as f64 / 16e6;
            let (want, _) = self.reference(from, to, t);
            let (shown, shaft) = (rig.rpm(), rig.shaft());
            let when = format!("{t:.2} s of {seconds:.2}, {from} to {to}");
            if t > seconds + settles {
                let within = (to.abs() * 0.01).max(2.0) + 2.0;
                assert!((shown - want).abs() <= within, "{shown} rpm, not {want:.0}, {when}");
            } else {
                assert!((shaft - want).abs() <= step, "the shaft is at {shaft:.0}, not {want:.0}, {when}");
                let within = if want.abs() < unseen + step { unseen.max(step) } else { step };
                assert!((shown - want).abs() <= within, "{shown} rpm, not {want:.0}, {when}");
            }
            seen += 1;
        });
        assert!(seen > 50);
    }
}

/// Ramps apply only to velocity commands, not to open loop, torque and positions (MDROBOT-16).
#[test]
fn page_13_commands_without_a_ramp() {
    let settings = [(pid::SLOW_START, 1_023), (pid::SLOW_DOWN, 1_023)];
    for pid in [pid::OPEN_VEL_CMD, pid::TQ_CMD] {
        let mut rig = Rig::armed(&settings);
        rig.write(pid, 500);
        rig.after(300.millis());
        assert!(rig.shaft() > 500.0, "PID {pid}: {}", rig.shaft());
    }
    let mut rig = Rig::armed(&settings);
    rig.write_move(pid::POSI_VEL_CMD, 1_200, 1_000);
    rig.after(500.millis());
    assert!(rig.shaft() > 850.0, "{}", rig.shaft());
    rig.after(9.secs());
    assert!(rig.position().abs_diff(1_200) <= 1);
}

/// "Control zero speed (like a servo lock)": the shaft stays where it stopped.
#[test]
fn page_8_servo_lock() {
    for rpm in [1_000, -300] {
        let mut rig = Rig::armed(&[(pid::STOP_STATUS, 1)]);
        rig.velocity(rpm);
        rig.assert_turns(f64::from(rpm));
        rig.velocity(0);
        rig.after(2.secs());
        let from = rig.position();
        rig.after(120.secs());
        assert!(rig.position().abs_diff(from) <= 1, "{} counts in two minutes", rig.position() - from);
    }
}

/// "Set the stop status" (p. 8, MDROBOT-17), after a ramp and without one.
#[test]
fn page_8_stop_status() {
    for status in 0..=3 {
        // A SLOW_DOWN of 683 is a ramp of 3.34 s from 1,000 rpm.
        for slow_down in [0, 683] {
            let mut rig = Rig::armed(&[(pid::STOP_STATUS, status), (pid::SLOW_DOWN, slow_down)]);
            rig.velocity(1_000);
            rig.assert_turns(1_000.0);
            rig.velocity(0);
            rig.after(10.millis());
            let free = rig.motion().current_ma == 0 && rig.motion().duty == 0;
            match (status, slow_down) {
                // The output is off at once.
                (3, _) | (0, 0) => assert!(free && rig.shaft() > 900.0, "{status}"),
                // The motor follows the ramp.
                (_, 683) => {
                    rig.after(1_660.millis());
                    assert!((rig.rpm() - 500.0).abs() <= 80.0, "{status}: {} rpm", rig.rpm());
                    rig.after(2_200.millis());
                    assert!(rig.shaft().abs() <= 10.0, "{status}: {} rpm", rig.shaft());
                }
                _ => {
                    rig.after(500.millis());
                    assert!(rig.shaft().abs() <= 10.0, "{status}: {} rpm", rig.shaft());
                }
            }
            rig.after(10.secs());
            rig.assert_stands();
        }
    }
}

/// STOP_STATUS at zero speed: 0 and 3 leave the shaft free. 1 controls the speed and so holds against a load.
/// 2 brakes, so the load turns the shaft slowly.
#[test]
fn page_8_at_rest_against_a_load() {
    let turned = |status: u16| {
        // A load of 0.05 Nm against forward, and 0.01 Nm of friction. Unless the shaft is held, it turns
        // backward. At 0.06 Nm/A, 0.8 A hold it.
        let (mut rig, _) = Rig::turning(&[(pid::STOP_STATUS, status)], |motor| motor.load_unm = 50_000);
        rig.velocity(200);
        rig.after(2.secs());
        rig.velocity(0);
        rig.after(1.secs());
        let from = rig.position();
        rig.after(2.secs());
        f64::from(rig.position() - from)
    };
    let [free, servo, brake, free_at_once] = [0, 1, 2, 3].map(turned);
    assert!(servo.abs() <= 2.0, "servo lock turned {servo} counts");
    // Brake: 0.67 A through 0.3 Ω is 0.2 V, which is 3.3 rad/s: 13 counts in 2 s.
    assert!(brake < -6.0 && brake > -30.0, "brake turned {brake} counts");
    assert!(free < -100.0 && free_at_once < -100.0, "free turned {free} and {free_at_once} counts");
}
