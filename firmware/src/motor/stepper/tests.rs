#![expect(clippy::float_arithmetic, reason = "mathematics that is not the code's")]

use fixed::types::{I24F8, U24F8};
use proptest::prelude::*;
use std::vec::Vec;

use super::*;
use crate::device::{Axis, Output};
use crate::motion::Rates;

const AXIS: Axis = Axis(0);

/// A stepper motor puts nothing.
struct Nowhere;

impl Sink for Nowhere {
    fn put(&mut self, _at: Instant, output: Output<'_>) {
        panic!("a stepper motor does not put {output:?}");
    }

    fn memory(&self) -> &[u8] {
        &[]
    }
}

fn at_us(us: u64) -> Instant {
    Instant::from(Duration::micros(us))
}

fn tell(motor: &mut Stepper, at: Instant, input: Input<'_>) {
    wake_until(motor, at);
    motor.input(at, input, &mut Nowhere);
}

fn plan(motor: &mut Stepper, at: Instant, plan: &Plan) {
    tell(motor, at, Input::Plan { axis: AXIS, plan });
}

fn step(motor: &mut Stepper, at: Instant, steps: i32) {
    tell(motor, at, Input::Step { axis: AXIS, steps });
}

fn wake_until(motor: &mut Stepper, at: Instant) {
    while motor.deadline() < at {
        let due = motor.deadline();
        motor.timeout(due, &mut Nowhere);
        assert!(motor.deadline() > due, "it wants to be woken again at once");
    }
}

/// Turns at an instant, behind all that is due by then.
fn turns(motor: &mut Stepper, at: Instant) -> f64 {
    wake_until(motor, at);
    if motor.deadline() == at {
        motor.timeout(at, &mut Nowhere);
    }
    motor.angle_at(at) as f64 / 4_294_967_296.0
}

#[track_caller]
fn assert_turns(motor: &mut Stepper, at: Instant, expected: f64) {
    let got = turns(motor, at);
    assert!((got - expected).abs() < 1e-9, "{got} turns at {at:?}, not {expected}");
}

/// 200 full steps of 8, 1,600 steps of the drive in a turn.
fn motor(parameters: Parameters) -> Stepper {
    let mut motor = Stepper::new(parameters);
    motor.set_microsteps(Instant::ZERO, 8);
    motor
}

#[test]
fn the_shaft_is_between_the_steps() {
    let mut motor = motor(Parameters::NOMINAL);
    let rates = Rates::even(U24F8::from_num(5_000), 10_000);
    plan(&mut motor, Instant::ZERO, &Plan::profile(Instant::ZERO, 0, 10_000, rates));
    for us in (0..2_700_000).step_by(777) {
        let t = us as f64 * 1e-6;
        // Half a second up, a second and a half at 5,000 steps/s, half a second down.
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
    // 6.25 turns, to the last bit.
    assert_eq!(motor.angle_at(at_us(2_700_000)), 25 << 30);
}

#[test]
fn a_step_without_a_plan_takes_the_time_since_the_last_one_and_a_millisecond_at_most() {
    let mut motor = motor(Parameters::NOMINAL);
    step(&mut motor, at_us(10_000), 1);
    for (us, steps) in [(10_000, 0.0), (10_250, 0.25), (11_000, 1.0), (12_000, 1.0)] {
        assert_turns(&mut motor, at_us(us), steps / 1_600.0);
    }
    // 0.4 ms behind the one before, which has been made by 0.4.
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
    let mut motor = motor(Parameters::NOMINAL);
    let jog = Plan::rest(Instant::ZERO, 0).towards(Instant::ZERO, I24F8::from_num(1_000), 10_000);
    plan(&mut motor, Instant::ZERO, &jog);
    // 100 ms up are 50 steps; 150.25 steps at 200.25 ms, 200.25 where it stands.
    let stops = at_us(200_250);
    plan(&mut motor, stops, &jog.towards(stops, I24F8::ZERO, 10_000));
    assert_turns(&mut motor, at_us(300_249), (200.25 - 0.5 * 10_000.0 * 1e-12) / 1_600.0);
    assert_turns(&mut motor, at_us(300_250), 200.25 / 1_600.0);
    assert_turns(&mut motor, at_us(300_750), 200.125 / 1_600.0);
    assert_turns(&mut motor, at_us(301_250), 200.0 / 1_600.0);
}

#[test]
fn power_comes_and_the_shaft_is_where_it_was() {
    let mut motor = motor(Parameters::NOMINAL);
    step(&mut motor, at_us(1_000), 3);
    // A drive begins to count at 0 again.
    plan(&mut motor, at_us(5_000), &Plan::rest(at_us(5_000), 0));
    assert_turns(&mut motor, at_us(9_000), 3.0 / 1_600.0);
    step(&mut motor, at_us(10_000), 1);
    assert_turns(&mut motor, at_us(11_000), 4.0 / 1_600.0);
}

/// However many units of phase a turn has: 200 full steps of 8, and the most that there are.
#[test]
fn the_shaft_is_short_of_any_angle_that_is_far() {
    for (steps_per_rev, microsteps) in [(200, 8), (Parameters::MOST.steps_per_rev, u16::MAX)] {
        let mut motor = Stepper::new(Parameters { steps_per_rev, ..Parameters::NOMINAL });
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
    let mut motor = motor(Parameters::NOMINAL);
    step(&mut motor, at_us(1_000), 4);
    motor.set_microsteps(at_us(5_000), 1);
    assert_turns(&mut motor, at_us(5_000), 4.0 / 1_600.0);
    step(&mut motor, at_us(10_000), 2);
    assert_turns(&mut motor, at_us(11_000), 4.0 / 1_600.0 + 2.0 / 200.0);
}

/// By hand, at 0.5 A of 1 A, that is 200,000 µN·m; 600 rpm are 16,000 steps/s of 1,600 in a turn.
const LOADED: Parameters = Parameters {
    holding_unm: 400_000,
    rated_ma: 1_000,
    pull_out_rpm: 600,
    inertia_gcm2: 1_000,
    friction_unm: 20_000,
    load_unm: 30_000,
    ..Parameters::NOMINAL
};

fn loaded() -> Stepper {
    let mut motor = motor(LOADED);
    tell(&mut motor, Instant::ZERO, Input::Current { axis: AXIS, ma: 500 });
    motor
}

/// A ramp of 8,000 steps/s², which is 5 turns/s² = 31.416 rad/s², with 10⁻⁴ kg·m² 3,141.59 µN·m.
fn ramp(at: Instant, speed: i32) -> Plan {
    Plan::rest(at, 0).towards(at, I24F8::from_num(speed), 8_000)
}

/// When it stalls first.
fn stalls(motor: &mut Stepper, until: Instant) -> Option<Instant> {
    while motor.deadline() < until {
        let due = motor.deadline();
        assert!(!motor.stalled());
        motor.timeout(due, &mut Nowhere);
        if motor.stalled() {
            return Some(due);
        }
    }
    None
}

#[test]
fn the_torque_fails_at_the_speed_where_it_does() {
    // 53,141.59 of 200,000 µN·m are left at 16,000·(1 − 0.265708) = 11,748.673 steps/s, which takes 1.468584 s.
    let mut motor = loaded();
    plan(&mut motor, Instant::ZERO, &ramp(Instant::ZERO, 15_000));
    let at = stalls(&mut motor, at_us(5_000_000)).unwrap();
    assert!(at.ticks().abs_diff(23_497_345) <= 2, "{at:?}");
    // There it stands: 8,000/2·1.468584² steps, and a tick's way.
    let stands = turns(&mut motor, at_us(4_000_000));
    assert!((stands * 1_600.0 - 4_000.0 * 1.468_584_07 * 1.468_584_07).abs() < 0.001, "{stands}");
}

#[test]
fn backward_the_load_helps_and_a_cruise_needs_less() {
    // −3,141.59 + 30,000 − 20,000 µN·m are 6,858.41: good for 16,000·(1 − 0.034292) = 15,451.3 steps/s. Then the cruise
    // needs 10,000: good for 15,200. Forward they are 53,141.59 up to 11,748.7, and 50,000 up to 12,000.
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
    // 0.12 A hold 48,000 µN·m, less than load and friction.
    let mut motor = loaded();
    plan(&mut motor, Instant::ZERO, &ramp(Instant::ZERO, 4_000));
    tell(&mut motor, at_us(2_000_000), Input::Current { axis: AXIS, ma: 120 });
    assert!(motor.stalled());
    let stands = turns(&mut motor, at_us(2_000_000));
    assert_turns(&mut motor, at_us(3_000_000), stands);
}

#[test]
fn it_falls_in_whole_periods_from_where_it_should_be() {
    let mut motor = loaded();
    let rates = Rates::even(U24F8::from_num(15_000), 8_000);
    let end = Plan::profile(Instant::ZERO, 0, 30_000, rates).end();
    plan(&mut motor, Instant::ZERO, &Plan::profile(Instant::ZERO, 0, 30_000, rates));
    // It stalls after 8,626.957 steps (above). Four full steps are 32 of the drive, and 30,000 are 16 beyond a whole
    // number of them, as 8,624 are; 8,656 would be further.
    let stands = turns(&mut motor, end - Duration::TICK) * 1_600.0;
    assert!((stands - 8_626.957).abs() < 0.002, "{stands}");
    assert!(motor.stalled());
    assert_turns(&mut motor, end + Duration::millis(1), 8_624.0 / 1_600.0);
    assert!(!motor.stalled());
    // And follows again.
    step(&mut motor, end + Duration::millis(10), 1);
    assert_turns(&mut motor, end + Duration::millis(11), 8_625.0 / 1_600.0);
}

#[test]
fn a_held_shaft_stands_until_it_is_let_go() {
    let mut motor = motor(Parameters::NOMINAL);
    tell(&mut motor, at_us(500), Input::Fault { fault: STALL, on: true });
    step(&mut motor, at_us(1_000), 15);
    assert_turns(&mut motor, at_us(5_000), 0.0);
    assert!(motor.stalled());
    // 15 steps are less than half a period away, 17 more.
    tell(&mut motor, at_us(6_000), Input::Fault { fault: STALL, on: false });
    assert_turns(&mut motor, at_us(7_000), 15.0 / 1_600.0);
    tell(&mut motor, at_us(8_000), Input::Fault { fault: STALL, on: true });
    step(&mut motor, at_us(9_000), 17);
    tell(&mut motor, at_us(20_000), Input::Fault { fault: STALL, on: false });
    assert_turns(&mut motor, at_us(21_000), 0.0);
}

#[test]
fn without_current_it_stands() {
    let mut motor = loaded();
    tell(&mut motor, at_us(500), Input::Current { axis: AXIS, ma: 0 });
    step(&mut motor, at_us(1_000), 4);
    assert_turns(&mut motor, at_us(5_000), 0.0);
    assert!(!motor.stalled());
    tell(&mut motor, at_us(6_000), Input::Current { axis: AXIS, ma: 500 });
    assert_turns(&mut motor, at_us(7_000), 4.0 / 1_600.0);
}

proptest! {
    /// Whatever its drive does, the shaft never jumps, does not turn round inside a stretch, is where its angle is
    /// compared, and stands at a whole step of its drive in the end.
    #[test]
    fn the_shaft_never_jumps(
        orders in proptest::collection::vec((1_u64..3_000_000, -20_000..20_000_i32, 0..4_u8), 1..12),
        samples in proptest::collection::vec(any::<u64>(), 4),
    ) {
        let mut motor = motor(Parameters::NOMINAL);
        let mut course = Plan::rest(Instant::ZERO, 0);
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
                // A tick of 40,000 steps/s and of a step caught up with in a tick.
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
                    motor.timeout(now, &mut Nowhere);
                }
            }
            let rests = course.end() <= now;
            course = match what {
                0 if rests => Plan::profile(now, 5, number / 10, Rates::even(U24F8::from_num(9_000), 70_000)),
                0 | 1 => course.towards(now, I24F8::from_num(number), 300_000),
                2 => {
                    if rests {
                        motor.input(now, Input::Step { axis: AXIS, steps: number.signum() }, &mut Nowhere);
                    }
                    continue;
                }
                3 => course.halt(now),
                _ => continue,
            };
            motor.input(now, Input::Plan { axis: AXIS, plan: &course }, &mut Nowhere);
        }
        let steps = turns(&mut motor, now) * 1_600.0;
        prop_assert!((steps - steps.round()).abs() < 1e-5, "{}", steps);
    }
}
