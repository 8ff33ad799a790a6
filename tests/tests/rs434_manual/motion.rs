//! Sections 6.2, 6.3 and 6.5: rotation, speed, acceleration, Hall sensors and current.

use drivetwin_protocol::time::{Duration, Span};
use drivetwin_tests::rs434::{Rig, at};

/// Hall edges per turn: 2 sensors with 4 pulses of 2 edges each ("both leading and trailing", 6.3).
const COUNTS: f64 = 16.0;

/// Acceleration in turns/s² for a register value. Section 6.5 prints two points: a value of 10 is 100
/// turns/s², a value of 1,000 is 5,000 turns/s². Between them the acceleration is linear (RS434-14).
fn rps2(value: u16) -> f64 {
    100.0 + (f64::from(value) - 10.0) * (5_000.0 - 100.0) / (1_000.0 - 10.0)
}

/// True speed of the shaft in rpm, signed.
fn rpm(rig: &Rig) -> f64 {
    rig.motion().speed.to_num::<f64>() / COUNTS * 60.0
}

#[track_caller]
fn assert_near(is: f64, should: f64, percent: f64, what: &str) {
    assert!((is - should).abs() <= should.abs() * percent / 100.0, "{what}: {is:.1} is not {should:.1}");
}

/// A drive whose motor turns at SPEED.
fn turning(settings: &[(u16, u16)]) -> Rig {
    let mut rig = Rig::default();
    for &(address, value) in settings {
        rig.write(address, value);
    }
    rig.write(at::START, 1);
    rig.after(5.secs());
    rig
}

/// Section 6.3: STATUS, SPEED_VALID in rpm, and CURRENT_POSITION in Hall edges, in both directions.
#[test]
fn section_6_3_rotation() {
    for (direction, sign) in [(1, 1.0), (2, -1.0)] {
        let mut rig = turning(&[(at::DIRECTION, direction)]);
        assert_eq!(rig.read(at::STATUS), direction);
        assert_near(rpm(&rig), sign * 1_000.0, 2.0, "the shaft");
        assert_near(f64::from(rig.read(at::SPEED_VALID)), 1_000.0, 3.0, "SPEED_VALID");
        let before = rig.read_long(at::CURRENT_POSITION);
        rig.after(6.secs());
        let turned = rig.read_long(at::CURRENT_POSITION) - before;
        assert_near(f64::from(turned), sign * 100.0 * COUNTS, 2.0, "counts of 100 turns");
        assert!(rig.read(at::CURRENT_VALID) > 0, "it draws a current");
        rig.write(at::STOP, 1);
        rig.after(1.secs());
        for (address, rest) in [(at::STATUS, 0), (at::SPEED_VALID, 0), (at::CURRENT_VALID, 0)] {
            assert_eq!(rig.read(address), rest, "{address:04X}h at rest");
        }
        let rests = rig.read_long(at::CURRENT_POSITION);
        rig.after(10.secs());
        assert_eq!(rig.read_long(at::CURRENT_POSITION), rests);
    }
}

/// Speeds from the least that SPEED allows to the greatest that the motor can reach.
#[test]
fn section_6_5_speed() {
    for speed in [30, 100, 500, 1_500, 2_500] {
        let mut rig = turning(&[(at::SPEED, speed)]);
        assert_near(f64::from(rig.read(at::SPEED_VALID)), f64::from(speed), 5.0, "SPEED_VALID");
        let before = rig.read_long(at::CURRENT_POSITION);
        rig.after(20.secs());
        let turns = f64::from(rig.read_long(at::CURRENT_POSITION) - before) / COUNTS;
        assert_near(turns * 3.0, f64::from(speed), 3.0, "turns a minute");
    }
}

/// RS434-19: a higher SPEED is accepted, and the motor turns as fast as it can. The motor gets at most 0.98
/// of the supply (section 3), so this is at most 0.98 of RATED_SPEED.
#[test]
fn section_6_5_more_than_the_motor_can() {
    let rig = turning(&[(at::SPEED, 15_000)]);
    let fast = rpm(&rig);
    assert!(fast > 0.8 * 3_000.0 && fast <= 0.98 * 3_000.0, "{fast}");
    // The model of the motor follows RATED_SPEED.
    let rig = turning(&[(at::RATED_SPEED, 6_000), (at::SPEED, 15_000)]);
    let fast = rpm(&rig);
    assert!(fast > 0.8 * 6_000.0 && fast <= 0.98 * 6_000.0, "{fast}");
}

/// "A value of 10 corresponds to 100 rps², and a value of 1000 corresponds to 5000 rps²": checks the speed at
/// each quarter of the ramp up and of the ramp down.
#[test]
fn section_6_5_acc_and_dec() {
    for (acc, dec, rpm_set, rated) in
        [(10, 10, 6_000, 15_000), (30, 10, 6_000, 15_000), (10, 50, 6_000, 15_000), (100, 100, 9_000, 15_000)]
    {
        let mut rig = Rig::default();
        let settings = [(at::RATED_SPEED, rated), (at::SPEED, rpm_set), (at::ACC, acc), (at::DEC, dec)];
        for (address, value) in settings {
            rig.write(address, value);
        }
        let full = f64::from(rpm_set);
        let quarter = |value: u16| {
            let seconds = full / 60.0 / rps2(value) / 4.0;
            Duration::from_ticks((seconds * 16e6) as u64)
        };
        rig.write(at::START, 1);
        for n in 1..4 {
            rig.after(quarter(acc));
            let should = full * f64::from(n) / 4.0;
            assert_near(rpm(&rig), should, 5.0, &format!("the shaft, ACC {acc}, quarter {n}"));
            let shown = f64::from(rig.read(at::SPEED_VALID));
            assert_near(shown, should, 8.0, &format!("SPEED_VALID, ACC {acc}, quarter {n}"));
        }
        rig.after(3.secs());
        assert_near(rpm(&rig), full, 2.0, "at speed");
        rig.write(at::STOP, 1);
        for n in 1..4 {
            rig.after(quarter(dec));
            let should = full * f64::from(4 - n) / 4.0;
            assert_near(rpm(&rig), should, 6.0, &format!("the shaft, DEC {dec}, quarter {n}"));
            let shown = f64::from(rig.read(at::SPEED_VALID));
            assert_near(shown, should, 9.0, &format!("SPEED_VALID, DEC {dec}, quarter {n}"));
        }
        rig.after(quarter(dec) + 300.millis());
        assert_eq!(rig.read(at::STATUS), 0);
    }
}

/// RS434-15: SPEED and DIRECTION take effect at once. A reversal goes through 0.
#[test]
fn section_6_5_changes_on_the_way() {
    let mut rig = turning(&[(at::ACC, 10), (at::DEC, 10)]);
    rig.write(at::SPEED, 2_000);
    rig.after(2.secs());
    assert_near(rpm(&rig), 2_000.0, 2.0, "faster");
    rig.write(at::SPEED, 300);
    rig.after(2.secs());
    assert_near(rpm(&rig), 300.0, 4.0, "slower");
    rig.write(at::SPEED, 1_000);
    rig.after(2.secs());
    // 16.7 rps at 100 rps² are 167 ms to 0, and as long again to 1,000 rpm backward.
    rig.write(at::DIRECTION, 2);
    rig.after(83.millis());
    assert_near(rpm(&rig), 500.0, 15.0, "on its way to 0");
    rig.after(167.millis());
    assert_near(rpm(&rig), -500.0, 15.0, "on its way backward");
    rig.after(1.secs());
    assert_near(rpm(&rig), -1_000.0, 2.0, "backward");
    assert_eq!(rig.read(at::STATUS), 2);
    // RS434-15: a START while the motor turns has no effect.
    rig.write(at::START, 1);
    rig.after(10.millis());
    assert_near(rpm(&rig), -1_000.0, 2.0, "still backward");
}

/// "Abrupt emergency stop": HARD_STOP has no ramp, unlike STOP. It sets no ERROR bit, and START works again
/// (RS434-20).
#[test]
fn section_6_2_stop_and_hard_stop() {
    let slow = [(at::DEC, 10), (at::SPEED, 2_500)];
    let mut ramp = turning(&slow);
    let mut hard = turning(&slow);
    ramp.write(at::STOP, 1);
    hard.write(at::HARD_STOP, 1);
    // 41.7 rps at 100 rps² are 417 ms.
    ramp.after(200.millis());
    hard.after(200.millis());
    assert_near(rpm(&ramp), 2_500.0 * (1.0 - 0.2 / 0.4167), 6.0, "with DEC");
    assert!(rpm(&hard) < rpm(&ramp) / 2.0, "{} and {}", rpm(&hard), rpm(&ramp));
    hard.after(1.secs());
    assert_eq!([at::STATUS, at::ERROR].map(|address| hard.read(address)), [0, 0]);
    hard.write(at::START, 1);
    hard.after(1.secs());
    assert_eq!(hard.read(at::STATUS), 1);
}

/// CLR_POSITION, at rest and while the motor turns.
#[test]
fn section_6_2_clr_position() {
    let mut rig = turning(&[]);
    assert!(rig.read_long(at::CURRENT_POSITION) > 1_000);
    rig.write(at::CLR_POSITION, 1);
    assert!(rig.read_long(at::CURRENT_POSITION) <= 1);
    rig.after(6.secs());
    assert_near(f64::from(rig.read_long(at::CURRENT_POSITION)), 100.0 * COUNTS, 2.0, "counts of 100 turns");
    rig.write(at::STOP, 1);
    rig.after(1.secs());
    rig.write(at::CLR_POSITION, 1);
    assert_eq!(rig.read_long(at::CURRENT_POSITION), 0);
}

/// "Number of pulses per revolution from one Hall sensor", and "both leading and trailing edges are taken
/// into account" (6.3): counts per turn with different numbers of pulses, and with one or two sensors.
#[test]
fn section_6_5_pulses_and_sensors() {
    for (pulses, halls, counts) in
        [(1, 2, 4.0), (4, 2, 16.0), (12, 2, 48.0), (1, 1, 2.0), (4, 1, 8.0), (12, 1, 24.0)]
    {
        let mut rig = turning(&[(at::PULSES, pulses), (at::USE_HALL, halls)]);
        let before = rig.read_long(at::CURRENT_POSITION);
        rig.after(30.secs());
        let turned = f64::from(rig.read_long(at::CURRENT_POSITION) - before);
        assert_near(turned, 500.0 * counts, 3.0, &format!("{pulses} pulses, {halls} sensors"));
        assert_near(f64::from(rig.read(at::SPEED_VALID)), 1_000.0, 4.0, "SPEED_VALID");
    }
}

/// RS434-18: with one Hall sensor the drive counts in the commanded direction.
#[test]
fn section_6_5_one_sensor_backward() {
    let mut rig = turning(&[(at::USE_HALL, 1), (at::DIRECTION, 2)]);
    assert_eq!(rig.read(at::STATUS), 2);
    let before = rig.read_long(at::CURRENT_POSITION);
    rig.after(30.secs());
    let turned = f64::from(rig.read_long(at::CURRENT_POSITION) - before);
    assert_near(turned, -500.0 * 8.0, 3.0, "backward");
}

/// RS434-18: without sensors duty = SPEED / RATED_SPEED, at most 0.98. The position does not change, and
/// SPEED_VALID shows the computed speed.
#[test]
fn section_6_5_without_sensors() {
    for (speed, rated, duty) in [(1_000, 3_000, 1.0 / 3.0), (1_500, 6_000, 0.25), (15_000, 3_000, 0.98)] {
        let mut rig = turning(&[(at::USE_HALL, 0), (at::RATED_SPEED, rated), (at::SPEED, speed)]);
        assert_near(f64::from(rig.motion().duty) / 65_536.0, duty, 1.0, "duty");
        assert_eq!((rig.read(at::STATUS), rig.read_long(at::CURRENT_POSITION)), (1, 0));
        let computed = duty * f64::from(rated);
        assert_near(f64::from(rig.read(at::SPEED_VALID)), computed, 2.0, "SPEED_VALID");
        assert!(rpm(&rig) > 0.7 * computed && rpm(&rig) <= 1.01 * computed, "{}", rpm(&rig));
        rig.write(at::STOP, 1);
        rig.after(2.secs());
        assert_eq!((rig.motion().duty, rig.read(at::STATUS)), (0, 0));
    }
}

/// REF_CURRENT limits the current of a blocked shaft. Bit 11 is a warning and does not stop the motor
/// (RS434-23 and RS434-24).
#[test]
fn section_6_5_ref_current() {
    for limit in [1_000, 3_000] {
        let mut rig = Rig::default();
        rig.write(at::REF_CURRENT, limit);
        rig.write(at::USE_HALL, 0);
        rig.write(at::SPEED, 2_900);
        rig.fault("stall", true);
        rig.write(at::START, 1);
        rig.after(500.millis());
        let drawn = f64::from(rig.read(at::CURRENT_VALID));
        assert!(drawn > 0.0 && drawn <= f64::from(limit) * 1.05, "{drawn} mA of {limit}");
        assert_eq!(rig.read(at::ERROR) & 1 << 11, 1 << 11);
        rig.fault("stall", false);
        rig.after(5.secs());
        assert_eq!(rig.read(at::STATUS), 1, "it goes on");
        rig.write(at::ERROR, 0);
        assert_eq!(rig.read(at::ERROR), 0);
    }
}

/// "The current consumed by the motor from the power supply": the current of the motor, times the part of the
/// time in which the supply drives it. Shorted terminals draw no current from the supply.
#[test]
fn section_6_3_current_of_the_supply() {
    for direction in [1, 2] {
        let mut rig = Rig::default();
        rig.write(at::DIRECTION, direction);
        rig.write(at::USE_HALL, 0);
        rig.fault("stall", true);
        rig.write(at::START, 1);
        rig.after(1.secs());
        // A blocked shaft makes no voltage of its own. With a third of the supply voltage the motor has a
        // third of its full current, and draws it from the supply for a third of the time.
        let motion = rig.motion();
        let supply = f64::from(motion.current_ma) * f64::from(motion.duty.abs()) / 65_536.0;
        assert!(motion.current_ma > 10_000 && supply < 0.4 * f64::from(motion.current_ma), "{motion:?}");
        assert_near(f64::from(rig.read(at::CURRENT_VALID)), supply, 0.1, "CURRENT_VALID");
        rig.fault("stall", false);
        rig.after(1.secs());
        rig.write(at::HARD_STOP, 1);
        rig.after(1.millis());
        assert!(rig.motion().current_ma > 1_000, "it brakes");
        assert_eq!(rig.read(at::CURRENT_VALID), 0);
    }
}

/// The current of a motor without load is far below the limit.
#[test]
fn section_6_5_no_warning_in_normal_use() {
    let mut rig = turning(&[(at::SPEED, 2_500)]);
    rig.write(at::DIRECTION, 2);
    rig.after(1.secs());
    rig.write(at::STOP, 1);
    rig.after(1.secs());
    assert_eq!(rig.read(at::ERROR), 0);
    for address in [at::TEMPERATURE_MCU, at::TEMPERATURE_MOSFET, at::TEMPERATURE_BRAKE] {
        // In units of 0.1 °C. The ambient temperature is 25 °C.
        assert!((250..600).contains(&rig.read(address)), "{address:04X}h");
    }
}

/// "The instantaneous value of the rotation speed" (6.3). After a restart the terminals are open and the
/// shaft coasts. It counts as at rest when there was no edge for a second.
#[test]
fn section_6_3_speed_of_a_shaft_that_has_coasted() {
    let mut rig = turning(&[(at::SPEED, 2_800)]);
    rig.restart();
    assert!(rpm(&rig) > 1_000.0, "it coasts: {}", rpm(&rig));
    assert!(rig.read(at::SPEED_VALID) > 1_000, "and shows it");
    while rpm(&rig) != 0.0 {
        rig.after(10.millis());
    }
    rig.after(1.secs());
    assert_eq!(rig.read(at::SPEED_VALID), 0);
}
