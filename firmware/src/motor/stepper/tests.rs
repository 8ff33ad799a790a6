#![expect(clippy::float_arithmetic, reason = "mathematics that is not the code's")]

use fixed::types::{I24F8, U24F8};
use proptest::prelude::*;
use std::vec::Vec;

use super::*;
use crate::motion::Limits;

fn at_us(us: u64) -> Instant {
    Instant::from(Duration::micros(us))
}

fn tell(motor: &mut StepperMotor, at: Instant, command: Command<'_>) {
    wake_until(motor, at);
    motor.command(at, command, &mut ());
}

fn plan(motor: &mut StepperMotor, at: Instant, plan: &Plan) {
    tell(motor, at, Command::Plan(plan));
}

fn block(motor: &mut StepperMotor, at: Instant, blocked: bool) {
    wake_until(motor, at);
    motor.set_blocked(at, blocked, &mut ());
}

fn step(motor: &mut StepperMotor, at: Instant, steps: i32) {
    tell(motor, at, Command::Step(steps));
}

fn wake_until(motor: &mut StepperMotor, at: Instant) {
    while motor.deadline() < at {
        let due = motor.deadline();
        motor.timeout(due, &mut ());
        assert!(motor.deadline() > due, "it wants to be woken again at once");
    }
}

/// Turns of the shaft at `at`, after all deadlines up to `at`.
fn turns(motor: &mut StepperMotor, at: Instant) -> f64 {
    wake_until(motor, at);
    if motor.deadline() == at {
        motor.timeout(at, &mut ());
    }
    motor.angle_at(at) as f64 / 4_294_967_296.0
}

#[track_caller]
fn assert_turns(motor: &mut StepperMotor, at: Instant, expected: f64) {
    let got = turns(motor, at);
    assert!((got - expected).abs() < 1e-9, "{got} turns at {at:?}, not {expected}");
}

/// A motor of 200 full steps with 8 steps of the drive each: 1,600 steps of the drive per turn.
fn motor(parameters: StepperParameters) -> StepperMotor {
    let mut motor = StepperMotor::new(parameters);
    motor.set_microsteps(Instant::ZERO, 8);
    motor
}

#[test]
fn the_shaft_is_between_the_steps() {
    let mut motor = motor(StepperParameters::NOMINAL);
    let rates = Limits::even(U24F8::from_num(5_000), 10_000);
    plan(&mut motor, Instant::ZERO, &Plan::profile(Instant::ZERO, 0, 10_000, rates));
    for us in (0..2_700_000).step_by(777) {
        let t = us as f64 * 1e-6;
        // 0.5 s of acceleration, 1.5 s at 5,000 steps/s, 0.5 s of deceleration.
        let steps = if t < 0.5 {
            5_000.0 * t * t
        } else if t < 2.0 {
            1_250.0 + 5_000.0 * (t - 0.5)
        } else if t < 2.5 {
            10_000.0 - 5_000.0 * (2.5 - t) * (2.5 - t)
        } else {
            10_000.0
        };
        assert_turns(&mut motor, at_us(us), steps / 1_600.0);
    }
    // 6.25 turns exactly.
    assert_eq!(motor.angle_at(at_us(2_700_000)), 25 << 30);
}

#[test]
fn a_step_without_a_plan_takes_the_time_since_the_last_one_and_a_millisecond_at_most() {
    let mut motor = motor(StepperParameters::NOMINAL);
    step(&mut motor, at_us(10_000), 1);
    for (us, steps) in [(10_000, 0.0), (10_250, 0.25), (11_000, 1.0), (12_000, 1.0)] {
        assert_turns(&mut motor, at_us(us), steps / 1_600.0);
    }
    // The second step is 0.4 ms after the first, of which 0.4 has been made by then.
    step(&mut motor, at_us(20_000), 1);
    step(&mut motor, at_us(20_400), 1);
    for (us, steps) in [(20_400, 1.4), (20_600, 2.2), (20_800, 3.0), (21_500, 3.0)] {
        assert_turns(&mut motor, at_us(us), steps / 1_600.0);
    }
    step(&mut motor, at_us(30_000), -3);
    assert_turns(&mut motor, at_us(30_500), 1.5 / 1_600.0);
    assert_turns(&mut motor, at_us(31_000), 0.0);
}

#[test]
fn what_a_ramp_leaves_between_two_steps_is_turned_back_in_a_millisecond() {
    let mut motor = motor(StepperParameters::NOMINAL);
    let jog = Plan::at_rest(Instant::ZERO, 0).ramp_to(Instant::ZERO, I24F8::from_num(1_000), 10_000);
    plan(&mut motor, Instant::ZERO, &jog);
    // 100 ms of acceleration are 50 steps. The plan is at 150.25 steps at 200.25 ms and stops at 200.25
    // steps.
    let stops = at_us(200_250);
    plan(&mut motor, stops, &jog.ramp_to(stops, I24F8::ZERO, 10_000));
    assert_turns(&mut motor, at_us(300_249), (200.25 - 0.5 * 10_000.0 * 1e-12) / 1_600.0);
    assert_turns(&mut motor, at_us(300_250), 200.25 / 1_600.0);
    assert_turns(&mut motor, at_us(300_750), 200.125 / 1_600.0);
    assert_turns(&mut motor, at_us(301_250), 200.0 / 1_600.0);
}

#[test]
fn power_comes_and_the_shaft_is_where_it_was() {
    let mut motor = motor(StepperParameters::NOMINAL);
    step(&mut motor, at_us(1_000), 3);
    // A drive counts from 0 again after power-on.
    plan(&mut motor, at_us(5_000), &Plan::at_rest(at_us(5_000), 0));
    assert_turns(&mut motor, at_us(9_000), 3.0 / 1_600.0);
    step(&mut motor, at_us(10_000), 1);
    assert_turns(&mut motor, at_us(11_000), 4.0 / 1_600.0);
}

/// The result does not depend on the number of units of phase per turn: 200 full steps of 8, and the greatest
/// possible number.
#[test]
fn the_shaft_is_short_of_any_angle_that_is_far() {
    for (steps_per_rev, microsteps) in [(200, 8), (StepperParameters::MOST.steps_per_rev, u16::MAX)] {
        let mut motor = StepperMotor::new(StepperParameters { steps_per_rev, ..StepperParameters::NOMINAL });
        motor.set_microsteps(Instant::ZERO, microsteps);
        for angle in [1, 1 << 32, 1 << 57, i64::MAX] {
            assert!(!motor.is_at_least(Instant::ZERO, angle), "{angle}");
            assert!(motor.is_at_least(Instant::ZERO, -angle), "-{angle}");
        }
        assert!(motor.is_at_least(Instant::ZERO, 0));
    }
}

#[test]
fn another_size_of_a_step_holds_from_where_the_shaft_is() {
    let mut motor = motor(StepperParameters::NOMINAL);
    step(&mut motor, at_us(1_000), 4);
    motor.set_microsteps(at_us(5_000), 1);
    assert_turns(&mut motor, at_us(5_000), 4.0 / 1_600.0);
    step(&mut motor, at_us(10_000), 2);
    assert_turns(&mut motor, at_us(11_000), 4.0 / 1_600.0 + 2.0 / 200.0);
}

/// Computed by hand for 0.5 A of 1 A, which gives 200,000 µN·m. 600 rpm are 16,000 steps/s at 1,600 steps per
/// turn.
const LOADED: StepperParameters = StepperParameters {
    holding_unm: 400_000,
    rated_ma: 1_000,
    pull_out_rpm: 600,
    inertia_gcm2: 1_000,
    friction_unm: 20_000,
    load_unm: 30_000,
    ..StepperParameters::NOMINAL
};

fn loaded() -> StepperMotor {
    let mut motor = motor(LOADED);
    tell(&mut motor, Instant::ZERO, Command::CurrentLimit(500));
    motor
}

/// A ramp of 8,000 steps/s². This is 5 turns/s² = 31.416 rad/s². It needs 3,141.59 µN·m with 10⁻⁴ kg·m².
fn ramp(at: Instant, speed: i32) -> Plan {
    Plan::at_rest(at, 0).ramp_to(at, I24F8::from_num(speed), 8_000)
}

/// Time of the first stall before `until`.
fn stalls(motor: &mut StepperMotor, until: Instant) -> Option<Instant> {
    while motor.deadline() < until {
        let due = motor.deadline();
        assert!(!motor.stalled());
        motor.timeout(due, &mut ());
        if motor.stalled() {
            return Some(due);
        }
    }
    None
}

#[test]
fn the_torque_fails_at_the_speed_where_it_does() {
    // The ramp needs 53,141.59 of 200,000 µN·m. The motor has this torque up to 16,000·(1 − 0.265708) =
    // 11,748.673 steps/s, which takes 1.468584 s.
    let mut motor = loaded();
    plan(&mut motor, Instant::ZERO, &ramp(Instant::ZERO, 15_000));
    let at = stalls(&mut motor, at_us(5_000_000)).unwrap();
    assert!(at.ticks().abs_diff(23_497_345) <= 2, "{at:?}");
    // There the shaft stops, after 8,000/2·1.468584² steps, within a tick.
    let stops = turns(&mut motor, at);
    assert!((stops * 1_600.0 - 4_000.0 * 1.468_584_07 * 1.468_584_07).abs() < 0.001, "{stops}");
    // The load exceeds friction by 10,000 µN·m. It turns the shaft back with 100 rad/s², up to 600 rpm.
    let slides = slid(100.0, 10.0, 4.0 - 1.468_584_07);
    assert!((turns(&mut motor, at_us(4_000_000)) - stops + slides).abs() < 1e-4);
}

#[test]
fn backward_the_load_helps_and_a_cruise_needs_less() {
    // The backward ramp needs −3,141.59 + 30,000 − 20,000 = 6,858.41 µN·m, which the motor has up to
    // 16,000·(1 − 0.034292) = 15,451.3 steps/s. After the ramp it needs 10,000, which it has up to 15,200.
    // Forward it needs 53,141.59, up to 11,748.7, and then 50,000, up to 12,000.
    let ends = |speed: f64| (speed / 8_000.0 * 16e6) as u64;
    for (speed, fails) in [
        (-15_190, None),
        (-15_210, Some(ends(15_210.0))),
        (-15_460, Some(ends(15_451.3))),
        (11_748, None),
        (11_750, Some(ends(11_748.673))),
    ] {
        let mut motor = loaded();
        plan(&mut motor, Instant::ZERO, &ramp(Instant::ZERO, speed));
        let stalled = stalls(&mut motor, at_us(5_000_000)).map(Instant::ticks);
        let near = |(a, b): (u64, u64)| a.abs_diff(b) < 100;
        assert_eq!(stalled.is_some(), fails.is_some(), "{speed}");
        assert!(stalled.zip(fails).is_none_or(near), "{speed}: {stalled:?}, not {fails:?}");
    }
}

#[test]
fn less_current_stalls_at_once() {
    // 0.12 A hold 48,000 µN·m, which is less than load and friction together.
    let mut motor = loaded();
    plan(&mut motor, Instant::ZERO, &ramp(Instant::ZERO, 4_000));
    tell(&mut motor, at_us(2_000_000), Command::CurrentLimit(120));
    assert!(motor.stalled());
    // 48,000 µN·m bring 10⁻⁴ kg·m² to 7.77 rad/s, or 1,978 steps/s, within two full steps. The field is
    // faster: 4,000 steps/s. So its mean torque is zero, and the load turns the shaft back.
    let stops = turns(&mut motor, at_us(2_000_000));
    let back = stops - turns(&mut motor, at_us(3_000_000));
    assert!((back - slid(100.0, 10.0, 1.0)).abs() < 1e-4, "{back}");
}

/// Turns made in `seconds` with an acceleration of `rad_per_s2`, at most `fastest` turns/s.
fn slid(rad_per_s2: f64, fastest: f64, seconds: f64) -> f64 {
    let by = rad_per_s2 / (2.0 * core::f64::consts::PI);
    let speeds_up = fastest / by;
    if seconds < speeds_up { 0.5 * by * seconds * seconds } else { fastest * (seconds - speeds_up / 2.0) }
}

#[test]
fn it_falls_in_whole_periods_from_where_it_should_be() {
    // Friction holds this load where the shaft stalls.
    let parameters = StepperParameters { friction_unm: 30_000, load_unm: 20_000, ..LOADED };
    let mut motor = motor(parameters);
    tell(&mut motor, Instant::ZERO, Command::CurrentLimit(500));
    let rates = Limits::even(U24F8::from_num(15_000), 8_000);
    let end = Plan::profile(Instant::ZERO, 0, 30_000, rates).end();
    plan(&mut motor, Instant::ZERO, &Plan::profile(Instant::ZERO, 0, 30_000, rates));
    // The shaft stalls after 8,626.957 steps (as above), and rests while the field slows down. At the speed v
    // the torque is 200,000·(1 − v/16,000) − 50,000 µN·m. The shaft falls into step when this torque
    // accelerates 10⁻⁴ kg·m² to v within two full steps: at 3,023.7 steps/s, 378 ms before the end.
    let falls_in = Instant::from_ticks(end.ticks() - 378 * 16_000);
    let stands = turns(&mut motor, Instant::from_ticks(falls_in.ticks() - 2 * 16_000)) * 1_600.0;
    assert!((stands - 8_626.957).abs() < 0.002, "{stands}");
    assert!(motor.stalled());
    // 571.4 steps before the end the field is at 29,428.6. The shaft falls into step 20,800 steps (650
    // periods of four full steps) behind, at 8,628.6.
    turns(&mut motor, falls_in + Duration::millis(2));
    assert!(!motor.stalled());
    assert_turns(&mut motor, end, (30_000.0 - 20_800.0) / 1_600.0);
    step(&mut motor, end + Duration::millis(10), 1);
    assert_turns(&mut motor, end + Duration::millis(11), 9_201.0 / 1_600.0);
}

#[test]
fn a_held_shaft_stands_until_it_is_let_go() {
    let mut motor = motor(StepperParameters::NOMINAL);
    block(&mut motor, at_us(500), true);
    step(&mut motor, at_us(1_000), 15);
    assert_turns(&mut motor, at_us(5_000), 0.0);
    assert!(motor.stalled());
    // A period is 32 steps. 15 steps are less than half a period, 17 are more.
    block(&mut motor, at_us(6_000), false);
    assert_turns(&mut motor, at_us(7_000), 15.0 / 1_600.0);
    block(&mut motor, at_us(8_000), true);
    step(&mut motor, at_us(9_000), 17);
    block(&mut motor, at_us(20_000), false);
    assert_turns(&mut motor, at_us(21_000), 0.0);
}

#[test]
fn a_motor_that_follows_whatever_its_load_is_does_not_without_current() {
    let parameters = StepperParameters { load_unm: -30_000, holding_unm: 0, ..LOADED };
    let mut motor = motor(parameters);
    step(&mut motor, at_us(1_000), 4);
    assert_turns(&mut motor, at_us(5_000), 4.0 / 1_600.0);
    tell(&mut motor, at_us(10_000), Command::CurrentLimit(0));
    assert!(!motor.stalled());
    let slides = slid(100.0, 10.0, 0.09) * 1_600.0;
    assert!((turns(&mut motor, at_us(100_000)) * 1_600.0 - 4.0 - slides).abs() < 1e-3);
    // The shaft is at 103.1 steps. The nearest position is a multiple of 32 from 4.
    tell(&mut motor, at_us(100_000), Command::CurrentLimit(1));
    assert_turns(&mut motor, at_us(101_000), 100.0 / 1_600.0);
}

/// Currents in mA (`None`: not reported), each with the load in µN·m that a shaft at rest just holds. The
/// motor has 400,000 µN·m at 1 A and friction of 20,000.
const RELEASES: &[(Option<u32>, i32)] =
    &[(None, 420_000), (Some(1_000), 420_000), (Some(500), 220_000), (Some(50), 40_000), (Some(0), 20_000)];

#[test]
fn a_load_turns_a_shaft_at_rest_when_it_exceeds_what_holds_it() {
    for &(ma, holds) in RELEASES {
        for (load_unm, turns_it) in [
            (holds - 1, false),
            (holds + 1, true),
            (2 * holds, true),
            (-(holds - 1), false),
            (-(holds + 1), true),
            (-2 * holds, true),
        ] {
            let mut motor = motor(StepperParameters { load_unm: 0, ..LOADED });
            if let Some(ma) = ma {
                tell(&mut motor, Instant::ZERO, Command::CurrentLimit(ma));
            }
            motor.load(at_us(1_000), StepperParameters { load_unm, ..LOADED });
            // 1 µN·m accelerates 10⁻⁴ kg·m² by 0.01 rad/s². A step/s² is about 1/256 rad/s².
            let by = f64::from(load_unm.abs() - holds) * 0.01;
            let slides = if turns_it { slid(by, 10.0, 1.0) } else { 0.0 };
            let turned = -f64::from(load_unm.signum()) * turns(&mut motor, at_us(1_001_000));
            // Accelerations are rounded to whole steps/s².
            assert!((turned - slides).abs() <= 0.5 / 1_600.0, "{ma:?} {load_unm}: {turned}, not {slides}");
            assert_eq!(motor.stalled(), turns_it && ma != Some(0));
        }
    }
}

#[test]
fn current_brakes_a_shaft_and_holds_it() {
    for way in [1, -1] {
        let mut motor = motor(StepperParameters { load_unm: way * 30_000, ..LOADED });
        tell(&mut motor, Instant::ZERO, Command::CurrentLimit(0));
        // 100 rad/s² for 0.2 s are 20 rad/s and 2 rad. 100,000 + 20,000 − 30,000 µN·m brake with 900 rad/s²:
        // 0.2222 rad in 22.2 ms.
        tell(&mut motor, at_us(200_000), Command::CurrentLimit(250));
        assert!(motor.stalled());
        let stops = turns(&mut motor, at_us(222_300)) * 1_600.0;
        let slid = -f64::from(way) * 2.222_222 / (2.0 * core::f64::consts::PI) * 1_600.0;
        assert!((stops - slid).abs() < 2.0, "{stops}, not {slid}");
        assert!(!motor.stalled());
        // The shaft moves to the nearest multiple of four full steps, and then follows.
        let near = (slid / 32.0).round() * 32.0;
        assert_turns(&mut motor, at_us(230_000), near / 1_600.0);
        step(&mut motor, at_us(300_000), way);
        assert_turns(&mut motor, at_us(301_000), (near + f64::from(way)) / 1_600.0);
    }
}

#[test]
fn a_load_never_turns_a_shaft_faster_than_pull_out() {
    let pull_out = 600.0;
    for load_unm in [StepperParameters::LEAST.load_unm, StepperParameters::MOST.load_unm] {
        for inertia_gcm2 in [StepperParameters::LEAST.inertia_gcm2, StepperParameters::MOST.inertia_gcm2] {
            let mut motor = motor(StepperParameters { load_unm, inertia_gcm2, ..LOADED });
            tell(&mut motor, Instant::ZERO, Command::CurrentLimit(0));
            let mut last = 0.0;
            for hour in 1..100 {
                let now = turns(&mut motor, at_us(hour * 3_600_000_000));
                let rpm = (now - last) / 60.0 * -f64::from(load_unm.signum());
                assert!((0.99 * pull_out..=1.000_001 * pull_out).contains(&rpm), "hour {hour}: {rpm} rpm");
                last = now;
            }
        }
    }
}

#[test]
fn a_load_that_goes_or_turns_round_lets_friction_brake_the_shaft() {
    let mut motor = motor(StepperParameters { load_unm: -30_000, ..LOADED });
    tell(&mut motor, Instant::ZERO, Command::CurrentLimit(0));
    // The shaft is at 2 rad with 20 rad/s. Friction alone brakes with 200 rad/s², friction and a load of
    // 20,000 µN·m against the motion with 400.
    let rad = 1.0 / (2.0 * core::f64::consts::PI);
    for (load_unm, stops) in [(0, 2.0 + 1.0), (20_000, 2.0 + 0.5)] {
        let mut motor = motor.clone();
        wake_until(&mut motor, at_us(200_000));
        motor.load(at_us(200_000), StepperParameters { load_unm, ..LOADED });
        let got = turns(&mut motor, at_us(1_000_000));
        assert!((got - stops * rad).abs() < 0.001, "{load_unm}: {got}, not {}", stops * rad);
    }
}

#[test]
fn a_field_that_is_kept_beside_the_shaft_holds_a_load_that_it_cannot_move() {
    // 200,000 µN·m (500 mA) cannot move 190,000 µN·m and friction forward. A field that runs away from the
    // shaft cannot hold them, either.
    for keeps in [false, true] {
        let mut motor = motor(StepperParameters { load_unm: 190_000, ..LOADED });
        tell(&mut motor, Instant::ZERO, Command::CurrentLimit(500));
        motor.keep_field(Instant::ZERO, keeps);
        plan(&mut motor, at_us(1_000), &ramp(at_us(1_000), 15_000));
        let turned = turns(&mut motor, at_us(1_500_000));
        assert_eq!((motor.stalled(), turned < -1.0, turned.abs() < 0.001), (true, !keeps, keeps), "{turned}");
    }
}

#[test]
fn other_full_steps_begin_where_the_shaft_is() {
    let mut motor = motor(StepperParameters::NOMINAL);
    step(&mut motor, at_us(1_000), 4);
    assert_turns(&mut motor, at_us(5_000), 4.0 / 1_600.0);
    motor.load(at_us(5_000), StepperParameters { steps_per_rev: 400, ..StepperParameters::NOMINAL });
    assert_turns(&mut motor, at_us(6_000), 4.0 / 1_600.0);
    step(&mut motor, at_us(7_000), -16);
    assert_turns(&mut motor, at_us(9_000), 4.0 / 1_600.0 - 16.0 / 3_200.0);
}

proptest! {
    /// For any orders of its drive, the shaft never jumps, does not reverse inside an interval, agrees with
    /// the comparison of its angle, and stops at a whole step of its drive.
    #[test]
    fn the_shaft_never_jumps(
        orders in proptest::collection::vec((1_u64..3_000_000, -20_000..20_000_i32, 0..4_u8), 1..12),
        samples in proptest::collection::vec(any::<u64>(), 4),
    ) {
        let mut motor = motor(StepperParameters::NOMINAL);
        let mut course = Plan::at_rest(Instant::ZERO, 0);
        let mut now = Instant::ZERO;
        let mut last = 0;
        let mut seen: Vec<i64> = Vec::new();
        for (wait, number, what) in orders.into_iter().chain([(1, 0, 3), (100_000_000, 0, 9)]) {
            let then = now + Duration::from_ticks(wait);
            while now < then {
                let until = motor.until().min(then);
                let length = until.since(now).ticks();
                let mut instants: Vec<u64> = samples.iter().map(|n| n % length).collect();
                instants.extend([0, length - 1]);
                instants.sort_unstable();
                seen.clear();
                seen.extend(instants.iter().map(|&n| motor.angle_at(now + Duration::from_ticks(n))));
                // The limit is the distance in one tick at 40,000 steps/s, plus a step that the shaft catches
                // up with in one tick.
                prop_assert!((seen[0] - last).abs() < (1 << 32) / 1_600 * 2, "{:?} {} {}", now, seen[0], last);
                prop_assert!(seen.is_sorted() || seen.is_sorted_by(|a, b| a >= b), "{:?}", seen);
                for &n in &instants {
                    let at = now + Duration::from_ticks(n);
                    let angle = motor.angle_at(at);
                    prop_assert!(motor.is_at_least(at, angle) && !motor.is_at_least(at, angle + 1));
                }
                last = seen[seen.len() - 1];
                now = until;
                if motor.deadline() == now {
                    motor.timeout(now, &mut ());
                }
            }
            let rests = course.end() <= now;
            course = match what {
                0 if rests => Plan::profile(now, 5, number / 10, Limits::even(U24F8::from_num(9_000), 70_000)),
                0 | 1 => course.ramp_to(now, I24F8::from_num(number), 300_000),
                2 => {
                    if rests {
                        motor.command(now, Command::Step(number.signum()), &mut ());
                    }
                    continue;
                }
                3 => course.halt(now),
                _ => continue,
            };
            motor.command(now, Command::Plan(&course), &mut ());
        }
        let steps = turns(&mut motor, now) * 1_600.0;
        prop_assert!((steps - steps.round()).abs() < 1e-5, "{}", steps);
    }
}

/// An event of a motor.
#[derive(Clone, Copy, Debug)]
enum Happens {
    Slews(i32),
    Steps(i32),
    Halts,
    Current(u32),
    Held(bool),
    Load(StepperParameters),
    Keeps(bool),
    Catches,
    Microsteps(u16),
}

fn anything() -> impl Strategy<Value = Happens> {
    let (least, most) = (StepperParameters::LEAST, StepperParameters::MOST);
    let load = (4..=most.steps_per_rev, 0..=most.holding_unm, 1..=most.rated_ma, 1..=most.pull_out_rpm)
        .prop_flat_map(move |(steps_per_rev, holding_unm, rated_ma, pull_out_rpm)| {
            let others = (0..=most.friction_unm, least.load_unm..=most.load_unm, 0..=23_u32);
            others.prop_map(move |(friction_unm, load_unm, inertia)| StepperParameters {
                steps_per_rev,
                holding_unm: if holding_unm % 4 == 0 { 0 } else { holding_unm },
                rated_ma,
                pull_out_rpm,
                inertia_gcm2: 1 << inertia,
                friction_unm,
                load_unm,
            })
        });
    prop_oneof![
        any::<i32>().prop_map(Happens::Slews),
        (-500..500).prop_map(Happens::Steps),
        Just(Happens::Halts),
        prop_oneof![Just(0), 1..100_000_u32].prop_map(Happens::Current),
        any::<bool>().prop_map(Happens::Held),
        load.prop_map(Happens::Load),
        any::<bool>().prop_map(Happens::Keeps),
        Just(Happens::Catches),
        (1..=256_u16).prop_map(Happens::Microsteps),
    ]
}

proptest! {
    /// For any motor and any sequence of events the shaft does not jump, deadlines are not too frequent, and
    /// the load turns the shaft no faster than the pull-out speed.
    #[test]
    fn anything_turns_it_evenly(all in proptest::collection::vec((0_u64..400_000_000, anything()), 1..40)) {
        let mut motor = motor(LOADED);
        let mut course = Plan::at_rest(Instant::ZERO, 0);
        let mut now = Instant::ZERO;
        for (wait, happens) in all {
            let then = now + Duration::from_ticks(wait);
            let mut wakes = 0;
            while motor.deadline() <= then {
                now = motor.deadline();
                let before = motor.angle_at(now);
                motor.timeout(now, &mut ());
                prop_assert!(motor.deadline() > now, "it wants to be woken again at once");
                prop_assert!(motor.angle_at(now).abs_diff(before) <= 4, "it jumps by {}", motor.angle_at(now) - before);
                wakes += 1;
                prop_assert!(wakes < 30_000, "it never rests");
                let Kinematics { half_speed, turn, .. } = motor.kinematics();
                if motor.is_loose {
                    let rpm = 2.0 * half_speed as f64 / turn as f64 * 16e6 * 60.0;
                    prop_assert!(rpm.abs() <= f64::from(motor.parameters.pull_out_rpm) * 1.001 + 0.1, "{} rpm", rpm);
                }
            }
            now = then;
            let before = motor.angle_at(now);
            match happens {
                Happens::Slews(speed) => course = course.ramp_to(now, I24F8::from_bits(speed), 300_000),
                Happens::Halts => course = course.halt(now),
                Happens::Steps(steps) => motor.command(now, Command::Step(steps), &mut ()),
                Happens::Current(ma) => motor.command(now, Command::CurrentLimit(ma), &mut ()),
                Happens::Held(on) => motor.set_blocked(now, on, &mut ()),
                Happens::Load(parameters) => motor.load(now, parameters),
                Happens::Keeps(keeps) => motor.keep_field(now, keeps),
                Happens::Catches => motor.resynchronise(now),
                Happens::Microsteps(microsteps) => motor.set_microsteps(now, microsteps),
            }
            if let Happens::Slews(_) | Happens::Halts = happens {
                motor.command(now, Command::Plan(&course), &mut ());
            }
            prop_assert!(motor.deadline() > now);
            // The phase of a new plan is between two steps of the plan before it.
            prop_assert!(motor.angle_at(now).abs_diff(before) <= 4, "{:?}: it jumps by {}", happens, motor.angle_at(now) - before);
        }
    }
}
