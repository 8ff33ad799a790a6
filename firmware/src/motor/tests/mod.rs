#![expect(clippy::float_arithmetic, reason = "mathematics that is not the code's")]

mod properties;

use core::f64::consts::TAU;
use std::string::String;
use std::vec::Vec;

use super::*;
use crate::device::Duration;

/// The reports of a motor, except its parameters.
#[derive(Default)]
struct Recorder {
    levels: Vec<(Instant, Sensor, bool)>,
    draws: Vec<(Instant, i32)>,
    rotations: Vec<(Instant, Rotation)>,
}

impl Reports for Recorder {
    fn report(&mut self, at: Instant, report: Report<'_>) {
        match report {
            Report::Level(sensor, high) => self.levels.push((at, sensor, high)),
            Report::MotorCurrent(ma) => self.draws.push((at, ma)),
            Report::Rotation(rotation) => self.rotations.push((at, rotation)),
            Report::Motor(_) => {}
        }
    }
}

fn recorder() -> Recorder {
    Recorder::default()
}

/// Handles all deadlines up to `now`.
fn advance(motor: &mut Motor, now: Instant, out: &mut Recorder) {
    while motor.deadline() <= now {
        motor.timeout(motor.deadline(), out);
    }
}

/// A motor just after power-on.
fn motor(parameters: Parameters) -> Motor {
    let mut motor = Motor::new(parameters);
    motor.power_on(Instant::ZERO, &mut recorder());
    motor
}

fn at_ms(ms: u64) -> Instant {
    Instant::from(Duration::millis(ms))
}

fn current(ma: u32) -> Command<'static> {
    Command::CurrentLimit(ma)
}

fn duty(duty: i32) -> Command<'static> {
    Command::Duty(duty)
}

/// Counts of the Hall sensors per turn.
fn counts(parameters: &Parameters) -> f64 {
    2.0 * f64::from(parameters.hall_sensors) * f64::from(parameters.hall_pulses)
}

fn turns_per_second(motor: &Motor, at: Instant) -> f64 {
    motor.shaft(at).unwrap().speed.to_num::<f64>() / counts(motor.parameters())
}

#[test]
fn a_small_current_turns_the_lightest_of_motors_too() {
    // With more current this motor would reach its speed in 8 µs. 20 mA at 0.161 N·m/A accelerate 20 g·cm² by
    // 256 turns/s².
    let light = Parameters {
        supply_mv: 23_362,
        no_load_rpm: 1_387,
        resistance_mohm: 100,
        inertia_gcm2: 20,
        friction_unm: 0,
        ..Parameters::NOMINAL
    };
    let (mut motor, mut out) = (motor(light), recorder());
    motor.command(at_ms(0), current(20), &mut out);
    motor.command(at_ms(0), duty(4_183), &mut out);
    advance(&mut motor, at_ms(1), &mut out);
    assert_eq!((turns_per_second(&motor, at_ms(1)) * 1e3).round(), 256.0);
    assert_eq!(out.draws, [(at_ms(0), 20)]);
}

/// From the last report of the motion, a drive can compute the angle of the shaft at any later instant. At steady
/// speed, new reports therefore come only every 4 ms (250 a second).
#[test]
fn reports_tell_where_the_shaft_is() {
    let load = |load_unm, friction_unm| Parameters { load_unm, friction_unm, ..Parameters::NOMINAL };
    for (parameters, drive, ma) in [
        (load(0, 10_000), 32_768, 20_000),
        (load(200_000, 0), 32_768, 20_000),
        (Parameters { inertia_gcm2: 20_000, ..load(-50_000, 10_000) }, -10_000, 3_000),
        (Parameters { inertia_gcm2: 1, ..load(0, 10_000) }, 20_000, 20_000),
    ] {
        let (mut motor, mut out) = (motor(parameters), recorder());
        motor.command(at_ms(0), duty(drive), &mut out);
        motor.command(at_ms(0), current(ma), &mut out);
        for n in 0..4_000_u64 {
            // Without current the motor coasts, and a load reverses it.
            if n == 2_000 {
                out.rotations.drain(..out.rotations.len() - 1);
                motor.command(at_ms(1_000), current(0), &mut out);
            }
            let at = Instant::ZERO + Duration::micros(500) * n;
            advance(&mut motor, at, &mut out);
            let &(since, report) = out.rotations.last().unwrap();
            let (told, is) = (report.after(at.since(since)), motor.interval.at(at).rotation());
            assert!(told.is_like(is), "{told:?} is not {is:?} at {at:?}");
            if n == 1_999 {
                // The heavy motor still accelerates. The speed of the lightest one is rounded in each step of
                // 50 µs.
                let most = if (100..10_000).contains(&parameters.inertia_gcm2) { 130 } else { 1_000 };
                let late = out.rotations.iter().filter(|(at, _)| *at >= at_ms(500)).count();
                assert!(late <= most, "{late} reports in half a second of {parameters:?}");
            }
        }
    }
}

#[test]
fn at_full_duty_it_comes_to_its_no_load_speed_but_for_friction() {
    let (mut motor, mut out) = (motor(Parameters { friction_unm: 0, ..Parameters::NOMINAL }), recorder());
    motor.command(at_ms(0), duty(65_536), &mut out);
    motor.command(at_ms(0), current(100_000), &mut out);
    // 24 V at 0.5 Ω.
    assert_eq!(out.draws, [(at_ms(0), 48_000)]);
    advance(&mut motor, at_ms(1_000), &mut out);
    assert!((turns_per_second(&motor, at_ms(1_000)) - 50.0).abs() < 0.001);
    assert_eq!(motor.shaft(at_ms(1_000)).unwrap().ma, 0);
}

#[test]
fn friction_holds_what_is_not_stronger() {
    // The torque constant is 24 V·60/(2π·3,000) = 76.394 mN·m/A. So 10 mN·m are 130.9 mA. At 48 A for 65,536
    // this is a duty of 178.7.
    for (drive, turns) in [(178, false), (179, true), (-178, false), (-179, true)] {
        let (mut motor, mut out) = (motor(Parameters::NOMINAL), recorder());
        motor.command(at_ms(0), duty(drive), &mut out);
        motor.command(at_ms(0), current(20_000), &mut out);
        assert_eq!(motor.deadline() != Instant::NEVER, turns, "{drive}");
    }
}

#[test]
fn a_load_turns_open_terminals_and_is_braked_by_shorted_ones() {
    let (mut motor, mut out) = (motor(Parameters { load_unm: -50_000, ..Parameters::NOMINAL }), recorder());
    motor.set_blocked(at_ms(0), true, &mut out);
    motor.set_blocked(at_ms(0), false, &mut out);
    advance(&mut motor, at_ms(100), &mut out);
    // 40 mN·m accelerate 400 g·cm² by 1,000 rad/s².
    assert!((turns_per_second(&motor, at_ms(100)) - 100.0 / TAU).abs() < 0.001);
    motor.command(at_ms(100), current(20_000), &mut out);
    advance(&mut motor, at_ms(1_000), &mut out);
    // 40 mN·m are 523.6 mA. In 0.5 Ω this is 261.8 mV, or 32.725 rpm.
    assert!((turns_per_second(&motor, at_ms(1_000)) - 32.725 / 60.0).abs() < 0.001);
    assert_eq!(motor.shaft(at_ms(1_000)).unwrap().ma, -524);
}

#[test]
fn what_a_load_turns_faster_than_its_supply_does_charges_it() {
    // Duty and current limit have no effect. The load of 1,000 mN·m less 10 mN·m of friction leaves 990 mN·m, which are
    // 12.959 A. This current needs 6.48 V in the winding of 0.5 Ω, so the motor generates 6.48 V more than the 24 V of
    // the supply.
    for (way, limit, drive) in [(1, 0, 0), (-1, 0, 0), (1, 1_000, 0), (-1, 1_000, 65_536), (1, 1_000, 65_536)]
    {
        let (mut motor, mut out) =
            (motor(Parameters { load_unm: way * -1_000_000, ..Parameters::NOMINAL }), recorder());
        motor.command(at_ms(0), duty(drive), &mut out);
        motor.command(at_ms(0), current(limit), &mut out);
        motor.set_blocked(at_ms(0), true, &mut out);
        motor.set_blocked(at_ms(0), false, &mut out);
        advance(&mut motor, at_ms(500), &mut out);
        let rpm = turns_per_second(&motor, at_ms(500)) * 60.0;
        assert!((rpm - 3_809.9 * f64::from(way)).abs() < 1.0, "{rpm}");
        let ma = motor.shaft(at_ms(500)).unwrap().ma;
        assert!((ma + 12_959 * way).abs() < 10, "{ma}");
    }
    // Without power the motor charges nothing. It reaches the greatest speed, and is braked when power
    // returns.
    let mut motor = motor(Parameters { load_unm: -1_000_000, ..Parameters::NOMINAL });
    motor.set_blocked(at_ms(0), true, &mut recorder());
    motor.set_blocked(at_ms(0), false, &mut recorder());
    assert_eq!(turns_per_second(&motor, at_ms(10_000)), 3_906.25);
    motor.power_on(at_ms(10_000), &mut recorder());
    advance(&mut motor, at_ms(10_100), &mut recorder());
    assert!((turns_per_second(&motor, at_ms(10_100)) * 60.0 - 3_809.9).abs() < 1.0);
}

#[test]
fn nothing_turns_faster_than_the_fastest() {
    // A winding of so much resistance that it does not brake.
    let parameters = Parameters { load_unm: -100_000_000, resistance_mohm: 1_000_000, ..Parameters::NOMINAL };
    let mut motor = motor(parameters);
    motor.command(at_ms(0), current(1), &mut recorder());
    for at in (1..200).map(at_ms) {
        advance(&mut motor, at, &mut recorder());
        assert!(turns_per_second(&motor, at) <= 3_906.25);
    }
    assert_eq!(turns_per_second(&motor, at_ms(199)), 3_906.25);
    // A motor is 3,906 times as fast as its supply would turn it when power returns. It is braked, too.
    let slow =
        Parameters { no_load_rpm: 60, resistance_mohm: 10, load_unm: -1_000_000, ..Parameters::NOMINAL };
    let mut motor = super::Motor::new(slow);
    motor.power_on(at_ms(0), &mut recorder());
    motor.power_on(at_ms(10_000), &mut recorder());
    advance(&mut motor, at_ms(10_100), &mut recorder());
    assert!(turns_per_second(&motor, at_ms(10_100)) < 2.0);
}

#[test]
fn the_lightest_motor_breaks_loose_by_what_is_stronger_than_its_friction() {
    let light = Parameters { inertia_gcm2: 1, resistance_mohm: 10, ..Parameters::NOMINAL };
    // 10 mN·m are 131 mA.
    for (ma, turns) in [(130, false), (132, true)] {
        let mut motor = motor(light);
        motor.command(at_ms(0), duty(32_768), &mut recorder());
        motor.command(at_ms(0), current(ma), &mut recorder());
        assert_eq!(motor.deadline() != Instant::NEVER, turns, "{ma} mA");
    }
}

#[test]
fn a_held_shaft_stands_and_draws_what_the_voltage_gives() {
    let (mut motor, mut out) = (motor(Parameters::NOMINAL), recorder());
    motor.command(at_ms(0), duty(16_384), &mut out);
    motor.command(at_ms(0), current(20_000), &mut out);
    advance(&mut motor, at_ms(100), &mut out);
    motor.set_blocked(at_ms(100), true, &mut out);
    let shaft = motor.shaft(at_ms(100)).unwrap();
    assert_eq!(
        (shaft.speed, shaft.ma, motor.deadline()),
        (fixed::types::I48F16::ZERO, 12_000, Instant::NEVER)
    );
    motor.set_blocked(at_ms(200), false, &mut out);
    advance(&mut motor, at_ms(300), &mut out);
    assert!(turns_per_second(&motor, at_ms(300)) > 10.0);
}

#[test]
fn without_power_it_coasts() {
    let (mut motor, mut out) = (motor(Parameters::NOMINAL), recorder());
    motor.command(at_ms(0), duty(65_536), &mut out);
    motor.command(at_ms(0), current(20_000), &mut out);
    advance(&mut motor, at_ms(1_000), &mut out);
    let fast = turns_per_second(&motor, at_ms(1_000));
    // 10 mN·m on 400 g·cm² are 250 rad/s², or 39.79 turns/s². Up to 1 ms of this is before the motor's last
    // step.
    let slower = turns_per_second(&motor, at_ms(1_500));
    assert!((fast - slower - 19.89).abs() < 0.05, "{fast} {slower}");
    motor.power_on(at_ms(1_500), &mut out);
    assert_eq!(turns_per_second(&motor, at_ms(1_500)), slower);
    motor.power_on(at_ms(10_000), &mut out);
    assert_eq!(motor.deadline(), Instant::NEVER);
}

#[test]
fn without_power_it_coasts_however_long() {
    let spun = |load_unm, friction_unm| {
        let mut motor = motor(Parameters { load_unm, friction_unm, ..Parameters::NOMINAL });
        motor.command(at_ms(0), duty(32_768), &mut recorder());
        motor.command(at_ms(0), current(20_000), &mut recorder());
        advance(&mut motor, at_ms(1_000), &mut recorder());
        motor.command(at_ms(1_000), current(0), &mut recorder());
        motor
    };
    let day = Instant::from(Duration::secs(86_400));
    // No torque brakes the motor: 25 turns a second.
    let motor = spun(0, 0);
    let made = f64::from(motor.shaft(day).unwrap().position - motor.shaft(at_ms(1_000)).unwrap().position);
    assert!((made / (86_399.0 * 25.0 * 16.0) - 1.0).abs() < 1e-6, "{made}");
    // A load accelerates the shaft, or first reverses it, up to the greatest speed of 234,375 rpm.
    for load in [-200_000, 200_000] {
        let mut motor = spun(load, 10_000);
        for at in [day, Instant::from(Duration::from_ticks(1 << 60))] {
            assert_eq!(turns_per_second(&motor, at), -3_906.25 * f64::from(load.signum()));
        }
        motor.power_on(day, &mut recorder());
        assert!(motor.deadline() > day && motor.deadline() <= day + Duration::from_ticks(1 << 16));
    }
    assert_eq!(turns_per_second(&spun(0, 1), day), 0.0);
}

#[test]
fn an_encoder_tells_the_same_turns_and_an_index_each() {
    let parameters = Parameters { encoder_cycles: 100, ..Parameters::NOMINAL };
    let (mut motor, mut out) = (motor(parameters), recorder());
    motor.command(at_ms(0), duty(65_536), &mut out);
    motor.command(at_ms(0), current(20_000), &mut out);
    advance(&mut motor, at_ms(1_000), &mut out);
    let count = |of: &[Sensor]| out.levels.iter().filter(|(_, sensor, _)| of.contains(sensor)).count() as i64;
    let (halls, encoder) =
        (count(&[Sensor::Hall(0), Sensor::Hall(1)]), count(&[Sensor::EncoderA, Sensor::EncoderB]));
    assert!(halls > 500 && (encoder - halls * 400 / 16).abs() <= 25, "{halls} {encoder}");
    assert!((count(&[Sensor::Index]) - encoder / 200).abs() <= 1);
}

/// A level as the manuals print it.
fn digit(high: bool) -> char {
    if high { '1' } else { '0' }
}

/// States of a motor's Hall sensors in sequence while the motor turns for 100 ms.
fn shown(parameters: Parameters, drive: i32) -> Vec<String> {
    let (mut motor, mut out) = (Motor::new(parameters), recorder());
    motor.power_on(Instant::ZERO, &mut out);
    motor.command(at_ms(0), duty(drive), &mut out);
    motor.command(at_ms(0), current(20_000), &mut out);
    advance(&mut motor, at_ms(100), &mut out);
    let mut levels = [None; 3];
    let mut shown = Vec::new();
    for (at, sensor, high) in out.levels {
        let Sensor::Hall(hall) = sensor else { panic!("it has no encoder") };
        levels[usize::from(hall)] = Some(high);
        // At the start the sensors report their levels one after another.
        if at > Instant::ZERO || hall == parameters.hall_sensors - 1 {
            shown.push(levels.into_iter().flatten().map(digit).collect());
        }
    }
    shown
}

#[test]
fn hall_sensors_go_through_their_states_one_by_one() {
    let mut three = ["101", "100", "110", "010", "011", "001"];
    let mut two = ["11", "01", "00", "10"];
    for drive in [65_536, -65_536] {
        for (hall_sensors, states) in [(3, three.as_slice()), (2, &two)] {
            let shown = shown(Parameters { hall_sensors, ..Parameters::NOMINAL }, drive);
            assert!(shown.len() > 20, "{shown:?}");
            for (state, expected) in shown.iter().zip(states.iter().cycle()) {
                assert_eq!(state, expected, "{drive}: {shown:?}");
            }
        }
        // Backward the sequence starts with the same state and is reversed.
        three[1..].reverse();
        two[1..].reverse();
    }
}

#[test]
fn another_motor_is_at_the_same_count() {
    let (mut motor, mut out) = (motor(Parameters::NOMINAL), recorder());
    motor.command(at_ms(0), duty(-65_536), &mut out);
    motor.command(at_ms(0), current(20_000), &mut out);
    advance(&mut motor, at_ms(300), &mut out);
    let before = motor.shaft(at_ms(300)).unwrap().position;
    let edges = out.levels.len();
    for hall_pulses in [1, 12, 5, 4] {
        motor.set_parameters(at_ms(300), Parameters { hall_pulses, ..Parameters::NOMINAL }, &mut out);
        assert_eq!(motor.shaft(at_ms(300)).unwrap().position, before);
    }
    assert_eq!(out.levels.len(), edges);
    // With one more sensor the count is still the same, and each sensor reports its level.
    motor.set_parameters(at_ms(300), Parameters { hall_sensors: 3, ..Parameters::NOMINAL }, &mut out);
    assert_eq!(motor.shaft(at_ms(300)).unwrap().position, before);
    let states = ["101", "100", "110", "010", "011", "001"];
    let state: String = out.levels[edges..].iter().map(|&(.., level)| digit(level)).collect();
    assert_eq!(state, states[before.rem_euclid(6) as usize]);
}
