//! Types of speed inputs (p. 8, p. 10), their limits (p. 14), the internal volume (p. 11), torque (p. 10);
//! MDROBOT-24, MDROBOT-25.

use drivetwin_protocol::time::Span;

use crate::pid;
use crate::rig::Rig;

/// A rig that the pins drive CCW, with an input type.
fn by_pins(input_type: u16, settings: &[(u16, u16)]) -> Rig {
    let mut rig = Rig::with(&[(pid::INPUT_TYPE, input_type), (pid::STOP_STATUS, 2)]);
    rig.set(settings);
    rig.open("START_STOP");
    rig.open("DIR");
    rig.close("RUN_BRAKE");
    rig.close("START_STOP");
    rig
}

/// Asserts a speed within one of 1,023 converter steps and the tolerance of `assert_turns`.
#[track_caller]
fn assert_near(rig: &mut Rig, rpm: f64, full: f64, what: &str) {
    rig.after(2.secs());
    let within = (rpm.abs() * 0.01).max(2.0) + full / 1_023.0;
    assert!((rig.rpm() - rpm).abs() <= within, "{what}: {} rpm, not {rpm:.1}", rig.rpm());
}

/// Type 0: "Analog voltage 0~5VDC, 0~max.", where max. is MAX_RPM.
#[test]
fn page_10_volts() {
    for full in [3_000_u16, 1_000] {
        let mut rig = by_pins(0, &[(pid::MAX_RPM, full)]);
        let full = f64::from(full);
        for volts in [1.0, 2.5, 0.5, 4.0, 0.0] {
            rig.volts("SPEED_IN", volts);
            assert_near(&mut rig, full * volts / 5.0, full, &format!("{volts} V of {full}"));
        }
        rig.close("DIR");
        rig.volts("SPEED_IN", 2.0);
        assert_near(&mut rig, -full * 2.0 / 5.0, full, "the other way");
    }
    let mut rig = by_pins(0, &[(pid::MAX_RPM, 2_000)]);
    for volts in [5.0, 6.0, 12.0] {
        rig.volts("SPEED_IN", volts);
        assert_near(&mut rig, 2_000.0, 2_000.0, "full");
    }
    rig.volts("SPEED_IN", -3.0);
    rig.assert_stands();
}

/// An input without a wire reads 0 V.
#[test]
fn page_10_no_volts() {
    by_pins(0, &[]).assert_stands();
}

/// "Lower than this value is same as zero input", "Higher than HIGH_LIMIT is same to": the speed is linear
/// between the limits (p. 14).
#[test]
fn page_14_speed_limits() {
    for (low, high) in [(100_u16, 900_u16), (512, 1_023), (0, 512), (205, 0)] {
        let mut rig = by_pins(0, &[(pid::MAX_RPM, 2_000), (pid::LOW_SPEED_LIMIT, low)]);
        if high != 0 {
            rig.write(pid::HIGH_SPEED_LIMIT, high);
        }
        let most = if high == 0 { 1_023.0 } else { f64::from(high) };
        let low = f64::from(low);
        for raw in [50.0, 150.0, 300.0, 500.0, 700.0, 950.0, 1_020.0] {
            rig.volts("SPEED_IN", raw / 1_023.0 * 5.0);
            let share = ((raw - low) / (most - low)).clamp(0.0, 1.0);
            // In a narrower range a converter step is a larger part of the speed.
            assert_near(
                &mut rig,
                2_000.0 * share,
                2_000.0 * 1_023.0 / (most - low),
                &format!("{raw} of {low}..{most}"),
            );
        }
    }
}

/// Type 1: "-max.~+max., 2.5VDC, deadzone 2~3VDC".
#[test]
fn page_10_joystick() {
    let mut rig = by_pins(1, &[]);
    for (volts, share) in [
        (2.5, 0.0),
        (3.0, 0.0),
        (2.0, 0.0),
        (2.9, 0.0),
        (4.0, 0.5),
        (1.0, -0.5),
        (3.5, 0.25),
        (0.5, -0.75),
        (2.5, 0.0),
    ] {
        rig.volts("SPEED_IN", volts);
        assert_near(&mut rig, 3_000.0 * share, 3_000.0, &format!("{volts} V"));
    }
    let mut rig = by_pins(1, &[(pid::MAX_RPM, 1_000)]);
    rig.volts("SPEED_IN", 5.0);
    assert_near(&mut rig, 1_000.0, 1_000.0, "5 V");
    rig.volts("SPEED_IN", 0.0);
    assert_near(&mut rig, -1_000.0, 1_000.0, "0 V");
}

/// Type 0: "PWM, duty cycle, 0~max., more than 5Khz".
#[test]
fn page_10_pwm() {
    for (hz, duty) in [(6_000.0, 0.25), (10_000.0, 0.5), (20_000.0, 0.75), (10_000.0, 0.1)] {
        let mut rig = by_pins(0, &[(pid::MAX_RPM, 1_000)]);
        let pin = rig.pin("SPEED_IN");
        rig.bench.pulse_width(rig.seat, pin, (hz * 4.0) as u32, hz, duty).expect("no other train");
        assert_near(&mut rig, 1_000.0 * duty, 1_000.0, &format!("{duty} at {hz} Hz"));
        // After the last pulse the pin is low, which is 0 V.
        rig.after(3.secs());
        rig.assert_stands();
    }
}

/// Type 2: "5~500kpps, 0~max."
#[test]
fn page_10_pulses() {
    for (kpps, share) in [(104.0, 0.2), (252.5, 0.5), (5.0, 0.0), (500.0, 1.0)] {
        let mut rig = by_pins(2, &[(pid::MAX_RPM, 1_000)]);
        let pin = rig.pin("PULSE_IN");
        rig.bench.pulse(rig.seat, pin, (kpps * 2_200.0) as u32, kpps * 1_000.0).expect("no other train");
        assert_near(&mut rig, 1_000.0 * share, 1_000.0, &format!("{kpps} kpps"));
        // The pulses have ended.
        rig.after(1.secs());
        rig.assert_stands();
    }
}

/// Type 3: "1.05~1.95ms, min-center-max, 1.5ms, deadzone: 1.4~1.6ms".
#[test]
fn page_10_rc() {
    for (ms, share) in [
        (1.5, 0.0),
        (1.41, 0.0),
        (1.59, 0.0),
        (1.95, 1.0),
        (1.05, -1.0),
        (1.775, 0.5),
        (1.225, -0.5),
        (1.6875, 0.25),
        (2.0, 1.0),
    ] {
        let mut rig = by_pins(3, &[(pid::MAX_RPM, 1_000)]);
        let pin = rig.pin("PULSE_IN");
        let hz = 300.0;
        rig.bench.pulse_width(rig.seat, pin, 800, hz, ms / 1_000.0 * hz).expect("no other train");
        assert_near(&mut rig, 1_000.0 * share, 1_000.0, &format!("{ms} ms"));
        rig.after(2.secs());
        rig.assert_stands();
    }
}

/// Type 5: INT_SPEED, RUN/BRAKE and START/STOP select seven steps. The speeds are multiples of a seventh,
/// rounded down (MDROBOT-24); those of 400 rpm were seen on a real controller.
#[test]
fn page_10_steps() {
    let of_400 = [0.0, 57.0, 114.0, 171.0, 228.0, 285.0, 342.0, 400.0];
    for full in [400_u16, 1_400, 3_000] {
        let mut rig = Rig::with(&[(pid::INPUT_TYPE, 5), (pid::MAX_RPM, full), (pid::STOP_STATUS, 2)]);
        for name in ["INT_SPEED", "RUN_BRAKE", "START_STOP", "DIR"] {
            rig.open(name);
        }
        rig.assert_stands();
        for (step, of_400) in (0_u16..).zip(of_400) {
            for (bit, name) in ["INT_SPEED", "RUN_BRAKE", "START_STOP"].into_iter().enumerate() {
                if step >> bit & 1 == 1 { rig.close(name) } else { rig.open(name) }
            }
            let rpm = if full == 400 { of_400 } else { (f64::from(step) * f64::from(full) / 7.0).floor() };
            rig.assert_turns(rpm);
        }
        rig.close("DIR");
        rig.assert_turns(-f64::from(full));
        for name in ["INT_SPEED", "RUN_BRAKE", "START_STOP"] {
            rig.open(name);
        }
        rig.assert_stands();
    }
}

/// "INT_SPEED (Speed input by internal VR)" (p. 11): while INT_SPEED is ON, the volume replaces SPEED_IN.
/// TAR_VEL takes precedence over both.
#[test]
fn page_11_internal_volume() {
    let mut rig = by_pins(0, &[(pid::MAX_RPM, 1_000)]);
    rig.volume(512);
    rig.volts("SPEED_IN", 1.0);
    rig.assert_turns(200.0);
    rig.close("INT_SPEED");
    assert_near(&mut rig, 1_000.0 * 512.0 / 1_023.0, 1_000.0, "the volume");
    rig.volume(1_023);
    rig.assert_turns(1_000.0);
    rig.write(pid::TAR_VEL, 300);
    rig.assert_turns(300.0);
    rig.write(pid::TAR_VEL, 0);
    rig.volume(0);
    rig.assert_stands();
    rig.open("INT_SPEED");
    rig.assert_turns(200.0);
}

/// A change of MAX_RPM takes effect at once, while the motor turns.
#[test]
fn page_16_max_rpm_while_it_turns() {
    let mut rig = by_pins(0, &[]);
    rig.volts("SPEED_IN", 2.0);
    rig.assert_turns(1_200.0);
    rig.write(pid::MAX_RPM, 1_000);
    rig.assert_turns(400.0);
    rig.write(pid::MAX_RPM, 2_000);
    rig.assert_turns(800.0);
}

/// TQ_CTRL 1: "current control (torque)": full scale is MAX_LOAD (MDROBOT-25).
#[test]
fn page_10_tq_ctrl() {
    let mut rig = by_pins(0, &[(pid::TQ_CTRL, 1), (pid::MAX_LOAD, 40)]);
    rig.fault("stall", true);
    for (volts, tenths) in [(2.5, 20), (1.0, 8), (4.0, 32), (0.0, 0)] {
        rig.volts("SPEED_IN", volts);
        rig.after(100.millis());
        assert!(rig.signed(pid::TQ_DATA).abs_diff(tenths) <= 1, "{volts} V: {}", rig.signed(pid::TQ_DATA));
        assert!((rig.amperes() - f64::from(tenths) / 10.0).abs() <= 0.1, "{volts} V: {} A", rig.amperes());
    }
    rig.close("DIR");
    rig.volts("SPEED_IN", 2.5);
    rig.after(100.millis());
    assert!(rig.signed(pid::TQ_DATA).abs_diff(-20) <= 1, "{}", rig.signed(pid::TQ_DATA));
    // With TQ_CTRL 0 the input is a speed again, and the shaft is no longer blocked.
    rig.fault("stall", false);
    rig.set(&[(pid::TQ_CTRL, 0)]);
    rig.open("START_STOP");
    rig.after(20.secs());
    rig.close("START_STOP");
    assert_near(&mut rig, -1_500.0, 3_000.0, "a speed again");
}
