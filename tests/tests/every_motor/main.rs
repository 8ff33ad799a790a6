//! Drives that turn a DC motor, on motors of every kind. Each motor reaches its target, or ends at its
//! current limit or at full duty, as the formulas of a DC motor say.
//!
//! The formulas use floating point and are independent of the drives' control. `cargo xtask soak 20000` tries
//! that many random motors of each drive.
#![allow(missing_docs, reason = "a test")]

mod limits;
mod physics;
mod rig;
mod sensors;
mod wild;

use drivetwin_firmware::motor::Parameters;
use proptest::prelude::*;

use physics::{End, Limits, Motor};
use rig::{Drive, Rig};

/// 140 motors: windings from 0.1 to 8 Ω, supplies from 8 to 24 V, 60 to 10,000 rpm.
fn grid() -> impl Iterator<Item = Motor> {
    [8.0, 12.0, 16.0, 20.0, 24.0].into_iter().flat_map(|supply_v| {
        [0.1, 0.3, 0.5, 1.0, 2.1, 4.3, 8.0].into_iter().flat_map(move |resistance| {
            [60.0, 500.0, 3_000.0, 10_000.0]
                .into_iter()
                .map(move |no_load_rpm| Motor::new(supply_v, no_load_rpm, resistance, 0.02, 0.05, 0.0))
        })
    })
}

/// Runs a motor towards a target, prints the result (`--nocapture` shows it) and compares the final state
/// with the formulas. Within 2 % of a limit the states on both sides of the limit are accepted.
fn turns(drive: Drive, motor: Motor, target: f64) -> Result<End, String> {
    let limits = drive.limits();
    let mut rig = Rig::new(drive, motor.parameters());
    rig.rotate(target as i64);
    rig.run(motor.settles(target, &limits));
    let begin = rig.revolutions();
    rig.run(1.0);
    let (rpm, amps) = ((rig.revolutions() - begin) * 60.0, rig.amps());
    let ends = [0.98, 1.0, 1.02].map(|part| motor.end(target * part, &limits));
    println!("{drive:?}: {target} rpm, is {rpm:.1} rpm {amps:.2} A, should be {:?}, {motor:?}", ends[1]);
    let errors = rig.errors();
    // An MDROBOT stops a motor that is far from its reference, or at its limit, for seconds (p. 9).
    let gave_up = drive == Drive::Mdrobot && errors != 0;
    // OVER_LOAD means 4 s at the limit. In this time a load may also turn the motor against its reference.
    let pulled = motor.load > motor.friction;
    let late = if pulled { rig::LIMITED } else { rig::OVER_LOAD };
    if gave_up && errors & late != 0 && motor.seconds_at_limit(target, &limits) > 3.5 {
        return Ok(motor.end(target, &limits));
    }
    let fits = |end: &End| match *end {
        End::Target(_) => (rpm / target - 1.0).abs() <= 0.01,
        End::FullDuty(end) if gave_up => end < target / 2.0 && errors & rig::OVER_LOAD == 0,
        End::FullDuty(end) => (rpm - end).abs() <= 0.01 * end.abs() + 0.5,
        End::CurrentLimit if gave_up => errors & rig::LIMITED != 0,
        // A load that turns the motor backward fast charges the supply, with a current beyond the limit.
        End::CurrentLimit if rpm < -motor.no_load_rpm / 2.0 => amps >= limits.amps - 0.01,
        End::CurrentLimit => (amps - limits.amps).abs() <= 0.01 && rpm < target,
    };
    if !ends.iter().any(fits) {
        return Err(format!("{rpm} rpm and {amps} A for {target} rpm, expected {:?}, of {motor:?}", ends[1]));
    }
    if matches!(ends[1], End::Target(_)) && errors != 0 {
        return Err(format!("errors {errors:#06X} at {target} rpm of {motor:?}"));
    }
    Ok(ends[1])
}

#[test]
fn the_grid() {
    for drive in [Drive::Rs434544, Drive::Mdrobot] {
        let (mut reached, mut failed) = (0, Vec::new());
        for motor in grid() {
            // Half of the motor's greatest speed, within the drive's range. A motor that is slower than that
            // ends at full duty.
            match turns(drive, motor, (motor.no_load_rpm / 2.0).clamp(30.0, 5_000.0)) {
                Ok(End::Target(_)) => reached += 1,
                Ok(_) => {}
                Err(why) => failed.push(why),
            }
        }
        assert!(failed.is_empty(), "{drive:?}: {} of 140: {:#?}", failed.len(), failed);
        assert_eq!(reached, 140, "{drive:?}");
    }
}

/// A motor and a target speed for it.
fn motors() -> impl Strategy<Value = (Motor, f64)> {
    let spread = |from: f64, to: f64| (from.ln()..to.ln()).prop_map(f64::exp);
    let time_constant = spread(0.000_5, 0.5);
    let motor = (8.0..24.0, spread(60.0, 10_000.0), spread(0.1, 8.0), time_constant, 0.0..0.3, -0.3..1.2);
    (motor, spread(0.02, 1.3))
        .prop_map(|((supply, rpm, resistance, seconds, friction, load), part)| {
            let motor = Motor::new(supply, rpm, resistance, seconds, friction, load);
            (motor, (rpm * part).clamp(30.0, 5_000.0).round())
        })
        // Other motors take too long.
        .prop_filter("it comes to its end within 40 s", |(motor, target)| {
            motor.settles(*target, &SLOWEST) < 40.0
        })
}

/// Limits of both drives combined so that a motor settles most slowly.
const SLOWEST: Limits = Limits { amps: 20.0, duty: 0.98, ramp: 300_000.0 };

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64,
        max_shrink_iters: 100,
        max_global_rejects: 1_000_000,
        max_local_rejects: 1_000_000,
        ..ProptestConfig::default()
    })]

    #[test]
    fn any_motor_of_an_rs_drive_ends_as_its_formulas_say((motor, target) in motors()) {
        turns(Drive::Rs434544, motor, target).map_err(TestCaseError::fail)?;
    }

    #[test]
    fn any_motor_of_an_mdrobot_ends_as_its_formulas_say((motor, target) in motors()) {
        turns(Drive::Mdrobot, motor, target).map_err(TestCaseError::fail)?;
    }

    /// A move ends on its counts, and friction holds the shaft there.
    #[test]
    fn any_motor_ends_its_moves_on_their_counts(
        (motor, target) in motors(), robot in any::<bool>(), back in any::<bool>(), part in 0.0..1.0_f64,
    ) {
        let drive = if robot { Drive::Mdrobot } else { Drive::Rs434544 };
        let motor = Motor { load: motor.load.clamp(-0.8 * motor.friction, 0.8 * motor.friction), ..motor };
        prop_assume!(motor.friction > 0.01 * motor.torque_limit(&drive.limits()));
        let mirrored = Motor { load: if back { -motor.load } else { motor.load }, ..motor };
        prop_assume!(matches!(mirrored.end(target, &drive.limits()), End::Target(_)));
        // An MDROBOT reports a stall if it uses more than half of the supply at standstill for a second
        // (p. 9).
        prop_assume!(!robot || motor.supply_at_rest() < 0.45);
        let mut rig = Rig::new(drive, motor.parameters());
        let size = (200.0_f64.powf(part)).round() as i64;
        let counts = if back { -size } else { size };
        rig.go(counts, target as i64);
        rig.run(rig.longest(counts, target) + 2.0 * motor.settles(target, &drive.limits()));
        prop_assert_eq!(rig.position(), counts, "{:?} at {} rpm", motor, target);
        prop_assert_eq!(rig.is_moving(), false, "{:?} at {} rpm", motor, target);
        rig.run(1.0);
        prop_assert_eq!(rig.position(), counts, "{:?} at {} rpm, later", motor, target);
        prop_assert_eq!(rig.revolutions_in_counts(), counts, "{:?} at {} rpm", motor, target);
    }
}

#[test]
fn the_parameters_are_what_the_formulas_say() {
    // 24 V, 3,000 rpm and 0.5 Ω give 76.4 mN·m/A; with these, 400 g·cm² give a time constant of 3.43 ms.
    let motor = Motor::new(24.0, 3_000.0, 0.5, 0.003_427, 0.0, 0.0);
    let Parameters { inertia_gcm2, .. } = motor.parameters();
    assert!((399..=401).contains(&inertia_gcm2), "{inertia_gcm2}");
}
