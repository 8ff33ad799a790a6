//! Motion that a drive commands.

use drivetwin_control::Motion;
use drivetwin_firmware::device::{Instant, Output, Plan, Shaft};

/// Commands of a drive to its axis.
#[derive(Debug)]
pub(crate) struct Commanded {
    plan: Plan,
    /// Steps made without a plan since the last plan.
    steps: i32,
    ma: u32,
    duty: i32,
}

impl Commanded {
    /// Standstill at `position`, without current.
    pub(crate) fn at_rest(at: Instant, position: i32) -> Self {
        Self { plan: Plan::at_rest(at, position), steps: 0, ma: 0, duty: 0 }
    }

    /// Notes an output.
    pub(crate) fn note(&mut self, output: &Output<'_>) {
        match *output {
            Output::Plan { plan, .. } => (self.plan, self.steps) = (*plan, 0),
            Output::Step { steps, .. } => self.steps = self.steps.wrapping_add(steps),
            Output::CurrentLimit { ma, .. } => self.ma = ma,
            Output::Duty { duty, .. } => self.duty = duty,
            _ => {}
        }
    }

    /// The motion at `at`, with these pulses so far.
    pub(crate) fn motion(&self, at: Instant, pulses: u32) -> Motion {
        Motion {
            position: self.plan.position_at(at).wrapping_add(self.steps),
            speed: self.plan.speed_at(at).to_bits(),
            moving: self.plan.end() > at || self.duty != 0,
            ma: self.ma.cast_signed(),
            duty: self.duty,
            pulses,
        }
    }
}

/// The motion of a shaft, with these pulses so far.
pub(crate) fn of_shaft(shaft: Shaft, pulses: u32) -> Motion {
    let Shaft { position, speed, duty, ma } = shaft;
    Motion { position, speed: speed.to_bits(), moving: speed != 0, ma, duty, pulses }
}
