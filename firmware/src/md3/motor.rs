//! The drive's outputs to its motor: steps along a plan while there is current, or a duty cycle.

use core::num::NonZeroU64;

use fixed::types::{I24F8, I48F16};

use super::AXIS;
use super::registers::Pwm;
use crate::device::{Context, Instant, Output, Plan};
use crate::motion::Limits;

/// Duty of a motor that is always on.
const FULL: i32 = 1 << 16;

/// A stepper motor, or the brush motor on phase B.
///
/// The plan continues even if the motor does not follow it (7.8, INHIBIT): without current the motor does not
/// move, and the steps of that time are lost. For a brush motor the plan's speed is the duty in counts, and
/// no steps are made (MD3-28).
#[derive(Clone, Debug)]
pub(super) struct Motor {
    plan: Plan,
    /// Number of steps outside the plan since the plan was made.
    step_offset: i32,
    /// Position at which the motor stands while it does not follow the plan; `None` while it follows.
    held_position: Option<i32>,
    has_current: bool,
    pwm: Option<Pwm>,
    /// Duty of the brush motor, in 1/65536 of full on, signed.
    duty: i32,
    /// Duty in counts at the end of the plan.
    target_counts: I24F8,
    /// Start of the next PWM period with another duty.
    next_period: Instant,
}

impl Motor {
    pub(super) fn new(at: Instant) -> Self {
        Self {
            plan: Plan::at_rest(at, 0),
            step_offset: 0,
            held_position: Some(0),
            has_current: false,
            pwm: None,
            duty: 0,
            target_counts: I24F8::ZERO,
            next_period: Instant::NEVER,
        }
    }

    /// Power-on: puts the first plan.
    pub(super) fn begin(&self, at: Instant, out: &mut dyn Context) {
        out.put(at, Output::Plan { axis: AXIS, plan: &self.plan });
    }

    /// End of the plan.
    pub(super) fn end(&self) -> Instant {
        self.plan.end()
    }

    /// Returns true if the motor is a brush motor.
    pub(super) fn is_dc(&self) -> bool {
        self.pwm.is_some()
    }

    /// PWM of a brush motor; `None` for a stepper.
    pub(super) fn pwm(&self) -> Option<Pwm> {
        self.pwm
    }

    /// Returns true if a brush motor has a duty other than 0.
    pub(super) fn is_driven(&self) -> bool {
        self.duty != 0
    }

    /// Selects a stepper (`None`), or a brush motor with this PWM. Counts refer to the new range from the
    /// next PWM period on. The caller has stopped the motor before a change of the motor type.
    pub(super) fn set_pwm(&mut self, at: Instant, pwm: Option<Pwm>, out: &mut dyn Context) {
        self.pwm = pwm;
        self.update_output(at, out);
    }

    /// Switches the motor's current on or off.
    pub(super) fn energize(&mut self, at: Instant, on: bool, out: &mut dyn Context) {
        if self.has_current != on {
            self.has_current = on;
            self.update_output(at, out);
        }
    }

    /// Starts a profile move of `steps` steps from standstill.
    pub(super) fn profile(&mut self, at: Instant, steps: i32, rates: Limits, out: &mut dyn Context) {
        let from = self.planned(at);
        self.start(at, Plan::profile(at, from, steps, rates), out);
    }

    /// Ramps to the signed `speed` and keeps that speed. Returns true if the ramp takes any time.
    pub(super) fn ramp_to(
        &mut self,
        at: Instant,
        speed: I24F8,
        acceleration: u32,
        out: &mut dyn Context,
    ) -> bool {
        let plan = self.plan.continued_from(at, self.planned(at)).ramp_to(at, speed, acceleration);
        self.target_counts = speed;
        self.start(at, plan, out);
        self.end() > at
    }

    /// Stops at once.
    pub(super) fn halt(&mut self, at: Instant, out: &mut dyn Context) {
        self.target_counts = I24F8::ZERO;
        self.set_duty(at, 0, out);
        let position = self.planned(at);
        self.start(at, Plan::at_rest(at, position), out);
    }

    /// The plan has ended. A brush motor gets the final duty now, before the end of the PWM period.
    pub(super) fn finish(&mut self, at: Instant, out: &mut dyn Context) {
        self.set_duty(at, self.duty_of(self.target_counts.into()), out);
        self.schedule(at);
    }

    /// A step without a ramp.
    pub(super) fn step(&mut self, at: Instant, steps: i32, out: &mut dyn Context) {
        if self.held_position.is_none() {
            self.step_offset = self.step_offset.wrapping_add(steps);
            out.put(at, Output::Step { axis: AXIS, steps });
        }
    }

    /// A board has made `steps` more steps than the plan has.
    pub(super) fn correct_steps(&mut self, steps: i32) {
        self.step_offset = self.step_offset.wrapping_add(steps);
    }

    pub(super) fn deadline(&self) -> Instant {
        self.next_period
    }

    /// Sets the duty at the start of a PWM period.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.next_period <= at {
            let duty = self.duty_of(self.plan.speed_at(at));
            self.set_duty(at, duty, out);
            self.schedule(at);
        }
    }

    /// Position of the plan, plus the steps made without it.
    fn planned(&self, at: Instant) -> i32 {
        self.plan.position_at(at).wrapping_add(self.step_offset)
    }

    fn start(&mut self, at: Instant, plan: Plan, out: &mut dyn Context) {
        (self.plan, self.step_offset) = (plan, 0);
        if self.held_position.is_none() {
            out.put(at, Output::Plan { axis: AXIS, plan: &self.plan });
        }
        self.schedule(at);
    }

    /// Starts or stops to follow the plan, as the current and the motor type require.
    fn update_output(&mut self, at: Instant, out: &mut dyn Context) {
        let is_held = !self.has_current || self.pwm.is_some();
        let is_over = self.end() <= at;
        match self.held_position {
            None if is_held => {
                let position = self.planned(at);
                self.held_position = Some(position);
                if !is_over {
                    out.put(at, Output::Plan { axis: AXIS, plan: &Plan::at_rest(at, position) });
                }
            }
            Some(position) if !is_held => {
                self.held_position = None;
                if is_over {
                    (self.plan, self.step_offset) = (Plan::at_rest(at, position), 0);
                } else {
                    self.start(at, self.plan.continued_from(at, position), out);
                }
            }
            _ => {}
        }
        if !self.has_current {
            self.set_duty(at, 0, out);
        }
        self.schedule(at);
    }

    /// Schedules the next change of the duty: at the start of a PWM period, never within one (MD3-32).
    fn schedule(&mut self, at: Instant) {
        self.next_period = match self.pwm {
            Some(Pwm { period, .. })
                if self.has_current && self.duty != self.duty_of(self.target_counts.into()) =>
            {
                let begun = at.since(Instant::ZERO) / period;
                Instant::ZERO + period * (begun + 1)
            }
            _ => Instant::NEVER,
        };
    }

    /// The duty for `counts`, in 1/65536 of full on.
    fn duty_of(&self, counts: I48F16) -> i32 {
        let Some(Pwm { range, .. }) = self.pwm else { return 0 };
        let duty = counts.to_bits().unsigned_abs() / NonZeroU64::from(range);
        let duty = i32::try_from(duty).unwrap_or(FULL).min(FULL);
        if counts < 0 { -duty } else { duty }
    }

    fn set_duty(&mut self, at: Instant, duty: i32, out: &mut dyn Context) {
        if self.duty != duty {
            self.duty = duty;
            out.put(at, Output::Duty { axis: AXIS, duty });
        }
    }
}
