//! Motion on its own, without the rest of the drive.

#![expect(clippy::float_arithmetic, reason = "mathematics that is not the code's")]

mod closed;
mod currents;
mod follow;
mod home;
mod limits;
mod model;
mod moves;
mod wild;

use std::vec::Vec;

use drivetwin_protocol::time::Span;

use super::{Contact, Event, Motion, Order, Settings};
use crate::device::{Axis, Context, Duration, Instant, Output, Plan};
use crate::mdrive::error::Error;
use crate::motor::stepper::StepperParameters;
use crate::testing::{Recorder, Treatment};

/// The factory's settings (FB 5).
const FACTORY: Settings = Settings {
    start: 1_000,
    speed: 768_000,
    up: 1_000_000,
    down: 1_000_000,
    microsteps: 256,
    settle_ms: 0,
    hold_delay_ms: 500,
    run_percent: 25,
    hold_percent: 5,
    enabled: true,
    response: u32::MAX,
    keeps_field: false,
    limit_mode: 1,
    home_debounce_ms: 0,
    jogs: false,
    follows_clock: false,
    ratio: 1_000,
    closed: false,
    lines: 512,
    deadband: 10,
    stall_factor: 15,
    goes_on_stalled: false,
    maintains: false,
    machine: StepperParameters::NOMINAL,
};

/// Slow settings, whose steps are easy to compute: 10,000 steps/s² from 1,000 to 5,000 steps/s, which take
/// 400 ms and 1,200 steps.
const SLOW: Settings = Settings { speed: 5_000, up: 10_000, down: 10_000, ..FACTORY };

const AXIS: Axis = Axis(0);

/// 1 ms.
const MS: Duration = Duration::millis(1);

/// The motion with its outputs.
struct Bench {
    motion: Motion,
    now: Instant,
    out: Recorder,
    events: Vec<(Instant, Event)>,
    /// Edges that a remote encoder has made.
    edges: i32,
}

/// Recorder of plans, currents and steps. The motion may make no other output.
fn recorder() -> Recorder {
    Recorder::default().ruled(|output| match output {
        Output::Plan { .. } | Output::CurrentLimit { .. } | Output::Step { .. } => Treatment::Keep,
        _ => Treatment::Refuse,
    })
}

impl Motion {
    /// Returns true if motion is paused: the waiting task waits for RS.
    pub(in crate::mdrive) fn is_paused(&self) -> bool {
        self.queue.is_paused()
    }
}

impl Bench {
    fn new(settings: Settings) -> Self {
        let mut bench = Self {
            motion: Motion::new(FACTORY),
            now: Instant::ZERO,
            out: recorder(),
            events: Vec::new(),
            edges: 0,
        };
        bench.feed(|motion, at, out| motion.power_on(at, settings, out));
        bench
    }

    /// Calls a method of the motion at the present time.
    fn feed<T>(&mut self, does: impl FnOnce(&mut Motion, Instant, &mut dyn Context) -> T) -> T {
        let before = self.out.plans.len();
        let answer = does(&mut self.motion, self.now, &mut self.out);
        for (at, _, plan) in &self.out.plans[before..] {
            assert_eq!(plan.start(), *at);
        }
        while let Some(event) = self.motion.next_event() {
            self.events.push((self.now, event));
        }
        answer
    }

    /// Lets time pass.
    fn run(&mut self, time: Duration) {
        self.run_to(self.now + time);
    }

    fn run_to(&mut self, until: Instant) {
        let mut calls = 0;
        while self.motion.deadline() <= until && self.motion.deadline() != Instant::NEVER {
            let due = self.motion.deadline();
            calls = if due == self.now { calls + 1 } else { 0 };
            assert!(calls < 20, "it does not get on: {:?}", self.motion.activity);
            assert!(due >= self.now);
            self.now = due;
            self.feed(|motion, at, out| motion.timeout(at, out));
        }
        self.now = until;
    }

    /// Runs until the motor is at rest, for a minute at most.
    fn run_out(&mut self) {
        let end = self.now + 60.secs();
        while self.is_moving() {
            let due = self.motion.deadline();
            assert!(due <= end, "it goes on and on: {:?}", self.motion.activity);
            self.run_to(due);
        }
    }

    fn order(&mut self, order: Order) -> Result<(), Error> {
        self.feed(|motion, at, out| motion.order(at, order, out)).map(|_| ())
    }

    fn does(&mut self, order: Order) {
        assert_eq!(self.order(order), Ok(()), "{order:?}");
    }

    fn contact(&mut self, contact: Contact, active: bool) {
        self.feed(|motion, at, out| motion.contact(at, contact, active, out));
    }

    fn set(&mut self, settings: Settings) {
        self.feed(|motion, at, out| motion.set(at, settings, out));
    }

    fn hold(&mut self, held: bool) {
        self.feed(|motion, at, out| motion.block_shaft(at, held, out));
    }

    /// C1. The methods below read C2, V, MV, MP and VC.
    fn c1(&self) -> i32 {
        self.motion.shaft().steps(self.now)
    }

    fn c2(&self) -> i32 {
        self.motion.shaft().counts(self.now)
    }

    fn v(&self) -> i32 {
        self.motion.velocity(self.now)
    }

    fn is_moving(&self) -> bool {
        self.motion.is_moving()
    }

    fn is_positioning(&self) -> bool {
        self.motion.is_positioning()
    }

    fn is_changing(&self) -> bool {
        self.motion.is_changing(self.now)
    }

    /// Errors that the motion has reported.
    fn errors(&self) -> Vec<Error> {
        let errors = self.events.iter().filter_map(|(_, event)| match event {
            Event::Failed(error) => Some(*error),
            _ => None,
        });
        errors.collect()
    }

    fn ms(&self) -> u64 {
        self.now.since(Instant::ZERO) / MS
    }
}

fn to(position: i32) -> Order {
    Order::To { position, notify_on_end: false, continuous: false }
}

fn by(distance: i32) -> Order {
    Order::By { distance, notify_on_end: false, continuous: false }
}
