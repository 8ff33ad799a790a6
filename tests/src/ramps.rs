//! Timing error of the worst step of a move, for three algorithms: `StepIterator`, and two that most step generators
//! use. The code of these two follows their publications.
//!
//! Each algorithm starts at the instant 0 and measures time from the instant 0. The calculation assumes that no
//! interrupt is late.

use drivetwin_firmware::device::{Instant, Plan};
use drivetwin_firmware::motion::{Limits, StepIterator};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use fixed::types::{I24F8, U24F8};

use crate::exact::{Jog, Move, TICK};

/// Distance of steps from their exact instants, in ticks.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Error {
    /// Error of the worst step, early or late.
    pub worst: f64,
    /// Error of the last step; negative is early.
    pub last: f64,
}

impl Error {
    /// The errors of steps at `made` that were due at `due`, in ticks.
    ///
    /// # Panics
    ///
    /// If the two have different lengths.
    #[must_use]
    pub fn of(made: &[f64], due: &[f64]) -> Self {
        assert_eq!(made.len(), due.len(), "every step is made, and no other");
        let errors = || made.iter().zip(due).map(|(made, due)| made - due);
        let worst = errors().fold(0.0, |worst: f64, error| worst.max(error.abs()));
        Self { worst, last: errors().next_back().unwrap_or(0.0) }
    }
}

/// A move and its timing errors.
pub struct Row {
    /// Description of the move.
    pub name: &'static str,
    /// Errors of `StepIterator`.
    pub ours: Error,
    /// Errors of `avr446`, which cannot jog.
    pub avr446: Option<Error>,
    /// Errors of `accelstepper`, which cannot jog.
    pub accelstepper: Option<Error>,
}

impl std::fmt::Display for Error {
    /// Prints ticks and µs. Below 100 ticks it prints three decimals.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { worst, last } = self;
        let digits = if *worst < 100.0 { 3 } else { 0 };
        let micros = 1e6 / TICKS_PER_SECOND as f64;
        write!(f, "{worst:.digits$} ({:.digits$} µs), end {last:+.digits$}", worst * micros)
    }
}

/// The rows as a Markdown table, as in docs/explanation/motion.md.
#[must_use]
pub fn table(rows: &[Row]) -> String {
    let mut table = String::from(
        "| error in ticks of 1/16 µs | drivetwin | AVR446 | AccelStepper |\n|---|---|---|---|\n",
    );
    for Row { name, ours, avr446, accelstepper } in rows {
        let [avr446, accelstepper] =
            [avr446, accelstepper].map(|error| error.map_or("-".to_owned(), |error| error.to_string()));
        table += &format!("| {name} | {ours} | {avr446} | {accelstepper} |\n");
    }
    table
}

/// The moves, each with every algorithm that can make it.
#[must_use]
pub fn rows() -> Vec<Row> {
    vec![
        row("10,000 steps, a = 10,000, v = 5,000", 10_000, 10_000, 5_000),
        row("100,000 steps, a = 500,000, v = 40,000", 100_000, 500_000, 40_000),
        row("101 steps, a = 10,000: a triangle", 101, 10_000, 5_000),
        Row { name: "jog 5,000, 20,000, -5,000, a = 10,000", ours: jog(), avr446: None, accelstepper: None },
    ]
}

fn row(name: &'static str, steps: u32, acceleration: u32, speed: u32) -> Row {
    let rates = Limits::even(U24F8::from_num(speed), acceleration);
    let exact = Move::of(steps, rates);
    let due: Vec<f64> = (1..=steps).map(|n| exact.step(n) as f64 / TICK as f64).collect();
    let plan = Plan::profile(Instant::ZERO, 0, steps.cast_signed(), rates);
    let made: Vec<f64> = StepIterator::new(&plan, Instant::ZERO).map(|step| step.at.ticks() as f64).collect();
    Row {
        name,
        ours: Error::of(&made, &due),
        avr446: Some(Error::of(&avr446(steps, acceleration, speed), &due)),
        accelstepper: Some(Error::of(&accelstepper(steps, acceleration, speed), &due)),
    }
}

/// A jog of 8 s: forward, faster from 1 s, backwards from 4 s.
fn jog() -> Error {
    let acceleration = 10_000;
    let (mut made, mut due) = (Vec::new(), Vec::new());
    let (mut plan, mut exact) = (Plan::at_rest(Instant::ZERO, 0), Jog::default());
    for (speed, from, until) in [(5_000, 0, 1), (20_000, 1, 4), (-5_000, 4, 8)] {
        let [from, until] = [from, until].map(|seconds| Instant::from_ticks(seconds * TICKS_PER_SECOND));
        plan = plan.ramp_to(from, I24F8::from_num(speed), acceleration);
        made.extend(StepIterator::new(&plan, from).take_while(|step| step.at <= until));
        exact.order(I24F8::from_num(speed), acceleration);
        exact.walk(until.ticks(), &mut due);
    }
    assert!(made.iter().map(|step| step.forward).eq(due.iter().map(|due| due.1)), "the same directions");
    let made: Vec<f64> = made.iter().map(|step| step.at.ticks() as f64).collect();
    let due: Vec<f64> = due.iter().map(|due| due.0).collect();
    Error::of(&made, &due)
}

/// Steps of the application note AVR446, "Linear speed control of stepper motor", after D. Austin, in
/// integers, with a timer at the rate of a tick. The first interval is 0.676·√(2/a), so that the recurrence
/// for the others ends at the right speed. The ramp down begins v²/2a before the end, or at half the
/// distance.
fn avr446(steps: u32, acceleration: u32, speed: u32) -> Vec<f64> {
    let (steps, a, v) = (i64::from(steps), f64::from(acceleration), f64::from(speed));
    let rate = TICKS_PER_SECOND as f64;
    let fastest = TICKS_PER_SECOND.cast_signed() / i64::from(speed);
    let to_speed = (v * v / (2.0 * a)) as i64;
    // The note gives the odd step to the ramp down.
    let ramp = if steps / 2 <= to_speed { steps - steps / 2 } else { to_speed };
    let mut interval = (0.676 * rate * (2.0 / a).sqrt()) as i64;
    // Negative in the ramp down, where the recurrence runs backwards.
    let mut count = 0;
    let mut left_over = 0;
    let mut last_of_ramp = None;
    let mut now = 0;
    let mut made = Vec::new();
    for n in 1..=steps {
        now += interval;
        made.push(now as f64);
        match last_of_ramp {
            Some(last) if n == steps - ramp => interval = last,
            Some(_) if n < steps - ramp => interval = fastest,
            _ => {
                count += 1;
                let (number, by) = (2 * interval + left_over, 4 * count + 1);
                interval -= number / by;
                left_over = number % by;
            }
        }
        if n == steps - ramp {
            count = -ramp;
        } else if n < steps - ramp && last_of_ramp.is_none() && interval <= fastest {
            last_of_ramp = Some(interval);
            (interval, left_over) = (fastest, 0);
        }
    }
    made
}

/// Times of the steps that the library `AccelStepper` makes, in ticks. It computes with single floats, and
/// its intervals are whole microseconds. After each step it compares the braking distance v²/2a with the
/// remaining distance.
fn accelstepper(steps: u32, acceleration: u32, speed: u32) -> Vec<f64> {
    let a = acceleration as f32;
    let first = 0.676 * (2.0 / a).sqrt() * 1e6;
    let least = 1e6 / speed as f32;
    let mut interval = first;
    let mut count = 1_i64;
    let mut micros = 0_u64;
    let mut made = Vec::new();
    for left in (0..i64::from(steps)).rev() {
        micros += interval as u64;
        made.push(micros as f64 * (TICKS_PER_SECOND as f64 / 1e6));
        let speed = 1e6 / interval;
        let to_stop = (speed * speed / (2.0 * a)) as i64;
        if count > 0 && to_stop >= left {
            count = -to_stop;
        } else if count < 0 && to_stop < left {
            count = -count;
        }
        if count == 0 {
            interval = first;
        } else {
            interval = (interval - 2.0 * interval / (4.0 * count as f32 + 1.0)).max(least);
        }
        count += 1;
    }
    made
}
