//! Cost of a step in a ramp and in a cruise, with the step iterator called as by an interrupt.
//!
//! The time is the shortest of many runs. valgrind counts the instructions.

#[path = "support/count.rs"]
mod count;
#[path = "support/mod.rs"]
mod support;

use std::hint::black_box;

use drivetwin_firmware::device::{Instant, Plan};
use drivetwin_firmware::motion::StepIterator;
use fixed::types::I24F8;

use support::{line, took};

/// Measured parts of a motion, each with its name, first step and last step.
const STRETCHES: [(&str, u64, u64); 3] =
    [("ramp, first 100 steps", 0, 100), ("ramp", 1_000, 80_000), ("cruise", 1_000, 101_000)];

/// Iterates over the first `steps` steps of the motion with the part `name`.
fn walk(name: &str, steps: u64) {
    // The ramp has 80,000 steps, or one for the cruise.
    let acceleration = if name == "cruise" { 800_000_000 } else { 10_000 };
    let plan = Plan::at_rest(Instant::ZERO, 0).ramp_to(Instant::ZERO, I24F8::from_num(40_000), acceleration);
    let mut walker = black_box(StepIterator::new(&plan, Instant::ZERO));
    let mut last = None;
    for _ in 0..steps {
        last = black_box(walker.next());
    }
    let made = last.map_or(0, |step| u64::from(plan.position_at(step.at).cast_unsigned()));
    assert_eq!(made, steps, "the steps that are measured are made");
}

fn main() {
    if let Some((name, steps)) = count::wanted() {
        walk(&name, steps);
        return;
    }
    println!("one step");
    let mut all_counted = true;
    for (name, from, to) in STRETCHES {
        let least = |steps| (0..200).map(|_| took(|| walk(name, steps))).min().unwrap_or_default();
        let ns = (least(to).as_nanos() as f64 - least(from).as_nanos() as f64) / (to - from) as f64;
        let instructions = count::instructions(name, from, to);
        all_counted &= instructions.is_some();
        line(name, &format!("{ns:.1} ns, {}", count::counted(instructions)));
    }
    count::warn_unless(all_counted);
}
