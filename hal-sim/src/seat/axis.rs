//! Axes of a device: where they are, and who listens to their pulses.

use standin_firmware::device::{AxisSpec, Instant, Level, Pin, Plan};
use standin_firmware::motion::HIGH;

use crate::bench::Motion;
use crate::drives::level_of;
use crate::pulses::{Shaper, StepDir};

/// What is known of an axis.
pub(super) struct AxisState {
    step_dir: Option<(Pin, Pin)>,
    plan: Plan,
    /// Steps made without a plan since the last one.
    steps: i32,
    /// Whether the last step before the plan was forward.
    forward: bool,
    /// Whether the last of `steps` was, if there are any.
    stepped: Option<bool>,
    pub(super) current_ma: u32,
    pub(super) duty: i32,
    /// Makes the pulses for whoever is wired to them.
    pub(super) shaper: Option<Shaper>,
    /// How often the next edge has changed.
    changes: u32,
}

impl AxisState {
    pub(super) fn new(spec: &AxisSpec) -> Self {
        Self {
            step_dir: spec.step_dir,
            plan: Plan::rest(Instant::ZERO, 0),
            steps: 0,
            forward: false,
            stepped: None,
            current_ma: 0,
            duty: 0,
            shaper: None,
            changes: 0,
        }
    }

    pub(super) fn power_on(&mut self, at: Instant) {
        (self.plan, self.steps, self.current_ma, self.duty) = (Plan::rest(at, 0), 0, 0, 0);
        (self.forward, self.stepped) = (false, None);
    }

    pub(super) fn power_off(&mut self, at: Instant) {
        (self.plan, self.current_ma, self.duty) = (self.plan.halt(at), 0, 0);
        // DIR is low then, wherever it went last.
        self.stepped = Some(false);
    }

    /// From `at` on it follows `plan`.
    pub(super) fn follow(&mut self, at: Instant, plan: &Plan) {
        self.forward = self.forward_at(at);
        (self.plan, self.steps, self.stepped) = (*plan, 0, None);
    }

    /// Steps without a plan, signed.
    pub(super) fn step(&mut self, steps: i32) {
        self.steps = self.steps.wrapping_add(steps);
        self.stepped = Some(steps > 0);
    }

    /// What it does.
    pub(super) fn motion(&self, at: Instant) -> Motion {
        Motion {
            position: self.plan.position_at(at).wrapping_add(self.steps),
            speed: self.plan.speed_at(at),
            moving: self.plan.end() > at || self.duty != 0,
            current_ma: self.current_ma,
            duty: self.duty,
        }
    }

    /// Whether a pin is its STEP or DIR.
    pub(super) fn is_at(&self, pin: Pin) -> bool {
        self.step_dir.is_some_and(|(step, dir)| step == pin || dir == pin)
    }

    /// The level of STEP or DIR; `None` for any other pin.
    pub(super) fn level(&self, at: Instant, pin: Pin, powered: bool) -> Option<Level> {
        let (step, _) = self.step_dir.filter(|_| self.is_at(pin))?;
        let mut shaper = match &self.shaper {
            Some(shaper) => shaper.clone(),
            // No pulse is longer.
            None => self.pulses(self.plan.start().max(at - HIGH), powered),
        };
        while shaper.take(at).is_some() {}
        let output = if pin == step { StepDir::Step } else { StepDir::Dir };
        Some(level_of(shaper.is_high(output)))
    }

    /// Somebody is wired to the pulses from now on.
    pub(super) fn listen(&mut self, at: Instant, powered: bool) {
        if self.shaper.is_none() {
            self.shaper = Some(self.pulses(at, powered));
        }
    }

    /// The pulses from `at` on.
    fn pulses(&self, at: Instant, powered: bool) -> Shaper {
        if powered { Shaper::new(at, &self.plan, self.forward_at(at)) } else { Shaper::default() }
    }

    /// When the next edge is due, and a number that tells it from those foreseen earlier.
    pub(super) fn next_edge(&mut self) -> Option<(Instant, u32)> {
        self.changes = self.changes.wrapping_add(1);
        Some((self.shaper.as_ref()?.due(), self.changes))
    }

    /// The edge that was foreseen under that number, if it comes by `until`.
    pub(super) fn take_edge(&mut self, number: u32, until: Instant) -> Option<(Pin, Level)> {
        if self.changes != number {
            return None;
        }
        self.take(until).map(|(pin, _, level)| (pin, level))
    }

    /// The next edge for whoever is wired to the pulses, if it comes by `until`: of which pin, when,
    /// and to which level.
    pub(super) fn take(&mut self, until: Instant) -> Option<(Pin, Instant, Level)> {
        let (step, dir) = self.step_dir?;
        let edge = self.shaper.as_mut()?.take(until)?;
        let pin = if edge.output == StepDir::Step { step } else { dir };
        Some((pin, edge.at, level_of(edge.high)))
    }

    /// Whether the last step by `at` was forward.
    fn forward_at(&self, at: Instant) -> bool {
        let speed = self.plan.speed_at(at);
        let moved = self.plan.position_at(at).wrapping_sub(self.plan.position_at(self.plan.start()));
        match self.stepped {
            _ if speed != 0 => speed > 0,
            Some(forward) => forward,
            None if moved != 0 => moved > 0,
            None => self.forward,
        }
    }
}
