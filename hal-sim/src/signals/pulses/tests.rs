//! Tests of the edges and their times.

use drivetwin_firmware::motion::Limits;
use drivetwin_protocol::time::Span;
use fixed::types::{I24F8, U24F8};
use proptest::prelude::*;

use super::*;

fn at(micros: u64) -> Instant {
    Instant::from(micros.micros())
}

/// The edges up to `until` as text: `S+ 1000` means that STEP rises at 1000 µs.
fn script(shaper: &mut Shaper, until: Instant) -> Vec<String> {
    let edge = |edge: Edge| {
        let output = if edge.output == StepDir::Step { 'S' } else { 'D' };
        let sign = if edge.high { '+' } else { '-' };
        format!("{output}{sign} {}", edge.at.ticks() as f64 / 16.0)
    };
    std::iter::from_fn(|| shaper.take(until)).map(edge).collect()
}

/// A jog that already has its full speed at `from`, which must not be before 1 ms.
fn jog(from: Instant, steps_per_second: i32) -> Plan {
    let start = from - 1.millis();
    let ramp = Plan::at_rest(start, 0).ramp_to(start, I24F8::from_num(steps_per_second), i32::MAX as u32);
    ramp.continued_from(from, 0)
}

#[test]
fn a_pulse_is_high_for_2_us_and_the_direction_comes_5_us_before() {
    let plan = Plan::profile(at(0), 0, 2, Limits::even(U24F8::from_num(1_000), 200));
    let mut shaper = Shaper::new(at(0), &plan, false);
    assert_eq!(shaper.due(), at(99_995));
    // One step up to full speed in sqrt(2/200) s, one step down to standstill in the same time.
    let expected = ["D+ 99995", "S+ 100000", "S- 100002", "S+ 200000", "S- 200002"];
    assert_eq!(script(&mut shaper, at(1_000_000)), expected);
    assert_eq!(shaper.due(), Instant::NEVER);
}

#[test]
fn a_fast_pulse_is_high_for_half_of_its_interval() {
    // There is a step every 16 ticks.
    let mut shaper = Shaper::new(at(1_000), &jog(at(1_000), 1_000_000), true);
    let edges: Vec<Edge> = std::iter::from_fn(|| shaper.take(Instant::NEVER)).take(20).collect();
    for pair in edges.windows(2) {
        assert_eq!(pair[1].at.since(pair[0].at).ticks(), 8);
    }
}

/// A jog at 250,000 steps/s (a step every 4 µs), advanced to a rising edge of STEP, and the time of that
/// edge.
fn fast() -> (Shaper, Instant) {
    let mut shaper = Shaper::new(at(1_000), &jog(at(1_000), 250_000), true);
    let _ = script(&mut shaper, at(1_100));
    loop {
        let edge = shaper.take(at(1_110)).expect("a step every 4 µs");
        if edge.high {
            return (shaper, edge.at);
        }
    }
}

#[test]
fn a_fast_reversal_changes_direction_half_an_interval_before() {
    let (mut shaper, rise) = fast();
    let back = jog(rise, -250_000);
    let first = StepIterator::new(&back, rise).next().expect("a jog has steps").at;
    let interval = first.since(rise);
    assert!(interval <= 4.micros(), "{interval:?}");
    shaper.plan(rise, &back, Lent::default());
    // Half an interval is at most 2 µs, so the pulse falls at the instant at which DIR changes, and falls
    // first.
    let half = rise + Duration::from_ticks(interval.ticks() / 2);
    let edges: Vec<Edge> = std::iter::from_fn(|| shaper.take(first)).collect();
    let dir = first - Duration::from_ticks(interval.ticks() / 2);
    assert_eq!(
        edges,
        [
            Edge { at: half, output: StepDir::Step, high: false },
            Edge { at: dir, output: StepDir::Dir, high: false },
            Edge { at: first, output: StepDir::Step, high: true },
        ]
    );
}

#[test]
fn nobody_knew_of_a_reversal_before_its_plan() {
    let (mut shaper, rise) = fast();
    // This is later than the middle between the two steps.
    let known = rise + 3.micros();
    while shaper.take(known).is_some() {}
    let back = jog(known, -400_000);
    let first = StepIterator::new(&back, known).next().expect("a jog has steps").at;
    assert!(first <= known + 3.micros(), "{first:?}");
    shaper.plan(known, &back, Lent::default());
    let edges: Vec<Edge> = std::iter::from_fn(|| shaper.take(first)).collect();
    assert_eq!(
        edges,
        [
            Edge { at: known, output: StepDir::Dir, high: false },
            Edge { at: first, output: StepDir::Step, high: true },
        ]
    );
}

#[test]
fn a_new_plan_lets_a_high_pulse_fall_and_makes_no_step_of_its_own_instant() {
    let plan = jog(at(1_000), 1_000);
    let second = StepIterator::new(&plan, at(2_500)).next().expect("a jog has steps").at;
    for after in [Duration::ZERO, Duration::TICK, 1.micros(), 2.micros()] {
        let mut shaper = Shaper::new(at(1_000), &plan, true);
        let change = second + after;
        let made = script(&mut shaper, change);
        assert!(made.iter().any(|edge| *edge == format!("S+ {}", second.ticks() as f64 / 16.0)), "{made:?}");
        shaper.plan(change, &plan.halt(change), Lent::default());
        let rest: Vec<Edge> = std::iter::from_fn(|| shaper.take(Instant::NEVER)).collect();
        let fall = Edge { at: second + 2.micros(), output: StepDir::Step, high: false };
        assert_eq!(rest, if after < 2.micros() { vec![fall] } else { vec![] });
    }
}

#[test]
fn without_power_both_are_low_at_once() {
    let (mut shaper, rise) = fast();
    shaper.power_off(rise + Duration::TICK);
    let edges: Vec<Edge> = std::iter::from_fn(|| shaper.take(Instant::NEVER)).collect();
    let off = |output| Edge { at: rise + Duration::TICK, output, high: false };
    assert_eq!(edges, [off(StepDir::Step), off(StepDir::Dir)]);
    assert_eq!(shaper.due(), Instant::NEVER);
}

#[test]
fn steps_without_a_plan_are_passed_through() {
    let mut shaper = Shaper::new(at(0), &Plan::at_rest(at(0), 0), false);
    shaper.steps(at(10), 1);
    assert_eq!(script(&mut shaper, at(20)), ["D+ 10", "S+ 12", "S- 14"]);
    shaper.steps(at(20), -1);
    assert_eq!(script(&mut shaper, at(30)), ["D- 20", "S+ 22", "S- 24"]);
    // Several steps at once, and a step that comes too early, are made one after the other.
    shaper.steps(at(30), -3);
    assert_eq!(script(&mut shaper, at(35)), ["S+ 30", "S- 32", "S+ 34"]);
    shaper.steps(at(35), -1);
    assert_eq!(script(&mut shaper, at(60)), ["S- 36", "S+ 38", "S- 40", "S+ 42", "S- 44"]);
    assert_eq!(shaper.due(), Instant::NEVER);
}

#[test]
fn every_4_us_steps_are_passed_through_as_they_come() {
    let mut shaper = Shaper::new(at(0), &Plan::at_rest(at(0), 0), true);
    for n in 1..1_000 {
        shaper.steps(at(4 * n), 1);
        let edges = script(&mut shaper, at(4 * n + 3));
        assert_eq!(edges, [format!("S+ {}", 4 * n), format!("S- {}", 4 * n + 2)]);
    }
}

#[test]
fn a_direction_that_turns_every_4_us_settles_each_time() {
    let mut shaper = Shaper::new(at(0), &Plan::at_rest(at(0), 0), false);
    for n in 1..1_000 {
        let (now, forward) = (4 * n, n % 2 == 1);
        shaper.steps(at(now), if forward { 1 } else { -1 });
        let mut edges = script(&mut shaper, at(now + 3));
        // The previous pulse ends at this instant.
        edges.retain(|edge| *edge != format!("S- {now}"));
        let sign = if forward { '+' } else { '-' };
        assert_eq!(edges, [format!("D{sign} {now}"), format!("S+ {}", now + 2)]);
    }
}

/// A change of an axis.
#[derive(Clone, Debug)]
enum Act {
    Jog(i32),
    Profile(i32),
    Halt,
    Steps(i32),
}

fn act() -> impl Strategy<Value = Act> {
    prop_oneof![
        3 => (-400_000_i32..400_000).prop_map(Act::Jog),
        2 => (-60_i32..60).prop_map(Act::Profile),
        1 => Just(Act::Halt),
        3 => (-3_i32..4).prop_map(Act::Steps),
    ]
}

proptest! {
    #[test]
    fn pulses_add_up_to_the_way_whatever_happens(
        acts in proptest::collection::vec((1_u64..30_000, act()), 1..20),
        looks in proptest::collection::vec(1_u64..9_000, 1..9),
    ) {
        let mut now = at(1_000);
        let mut plan = Plan::at_rest(now, 0);
        let mut shaper = Shaper::new(now, &plan, false);
        let (mut way, mut edges) = (0, Vec::new());
        // The edges are taken at arbitrary intervals.
        let mut looks = looks.into_iter().cycle();
        let halt = (16_000, Act::Halt);
        for (wait, act) in acts.into_iter().chain([halt]) {
            let change = now + Duration::from_ticks(wait);
            let mut look = now;
            while look < change {
                look = change.min(look + Duration::from_ticks(looks.next().unwrap_or(1)));
                edges.extend(std::iter::from_fn(|| shaper.take(look)));
            }
            let position = plan.position_at(change);
            way += position - plan.position_at(now);
            plan = match act {
                Act::Jog(speed) => plan.ramp_to(change, I24F8::from_num(speed), 2_000_000_000),
                Act::Profile(steps) => {
                    Plan::profile(change, position, steps, Limits::even(U24F8::from_num(90_000), 900_000_000))
                }
                Act::Halt => plan.halt(change),
                Act::Steps(steps) => {
                    way += steps;
                    shaper.steps(change, steps);
                    now = change;
                    continue;
                }
            };
            shaper.plan(change, &plan, Lent::default());
            now = change;
        }
        edges.extend(std::iter::from_fn(|| shaper.take(Instant::NEVER)));

        let (mut pulsed, mut step, mut dir, mut last) = (0, false, false, Instant::ZERO);
        for edge in edges {
            prop_assert!(edge.at >= last, "{edge:?} before {last:?}");
            last = edge.at;
            match edge.output {
                StepDir::Step => {
                    prop_assert_ne!(edge.high, step);
                    step = edge.high;
                    pulsed += if !step { 0 } else if dir { 1 } else { -1 };
                }
                StepDir::Dir => {
                    prop_assert!(edge.high != dir && !step, "{edge:?}");
                    dir = edge.high;
                }
            }
        }
        prop_assert!(!step);
        prop_assert_eq!(pulsed, way);
    }
}
