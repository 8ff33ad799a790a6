//! The drive's side of the motor: steps along a plan while there is current, or a duty cycle.

use core::num::NonZeroU64;

use fixed::types::{I24F8, I48F16};

use super::AXIS;
use super::registers::Pwm;
use crate::device::{Context, Instant, Output, Plan};
use crate::motion::Limits;

/// The duty cycle that means always on.
const FULL: i32 = 1 << 16;

/// A stepper motor, or the brush motor on its phase B.
///
/// A plan runs on whether or not the motor follows it (7.8, INHIBIT; MD3-28): while it has no current the
/// motor stands, and what went by is lost. Of a brush motor the plan's speed is the duty in counts,
/// and the steps never move.
#[derive(Clone, Debug)]
pub(super) struct Motor {
    plan: Plan,
    /// Steps made beside the plan since it was made.
    beside: i32,
    /// Position of the motor while it does not follow the plan.
    stands: Option<i32>,
    has_current: bool,
    pwm: Option<Pwm>,
    /// Duty of the brush motor, in 1/65536 of full on, signed.
    duty: i32,
    /// The counts that it will have in the end.
    aim: I24F8,
    /// Start of the next period with another duty.
    next_period: Instant,
}

impl Motor {
    pub(super) fn new(at: Instant) -> Self {
        Self {
            plan: Plan::rest(at, 0),
            beside: 0,
            stands: Some(0),
            has_current: false,
            pwm: None,
            duty: 0,
            aim: I24F8::ZERO,
            next_period: Instant::NEVER,
        }
    }

    /// Power comes.
    pub(super) fn begin(&self, at: Instant, out: &mut dyn Context) {
        out.put(at, Output::Plan { axis: AXIS, plan: &self.plan });
    }

    /// Time at which the plan stands.
    pub(super) fn end(&self) -> Instant {
        self.plan.end()
    }

    /// Returns whether it is a brush motor.
    pub(super) fn is_dc(&self) -> bool {
        self.pwm.is_some()
    }

    /// PWM of a brush motor; `None` for a stepper.
    pub(super) fn pwm(&self) -> Option<Pwm> {
        self.pwm
    }

    /// Returns whether a brush motor is driven.
    pub(super) fn is_driven(&self) -> bool {
        self.duty != 0
    }

    /// A stepper, or a brush motor with these periods: its counts are of the new range from the next
    /// period on. The drive has stopped what was the other.
    pub(super) fn set_pwm(&mut self, at: Instant, pwm: Option<Pwm>, out: &mut dyn Context) {
        self.pwm = pwm;
        self.follow(at, out);
    }

    /// Takes its current, or gives it again.
    pub(super) fn energize(&mut self, at: Instant, on: bool, out: &mut dyn Context) {
        if self.has_current != on {
            self.has_current = on;
            self.follow(at, out);
        }
    }

    /// From standstill `steps` steps.
    pub(super) fn profile(&mut self, at: Instant, steps: i32, rates: Limits, out: &mut dyn Context) {
        let from = self.planned(at);
        self.go(at, Plan::profile(at, from, steps, rates), out);
    }

    /// A ramp to the signed `speed`, and on; whether that goes beyond this instant.
    pub(super) fn towards(
        &mut self,
        at: Instant,
        speed: I24F8,
        acceleration: u32,
        out: &mut dyn Context,
    ) -> bool {
        let plan = self.plan.resumed(at, self.planned(at)).towards(at, speed, acceleration);
        self.aim = speed;
        self.go(at, plan, out);
        self.end() > at
    }

    /// Stops at once.
    pub(super) fn halt(&mut self, at: Instant, out: &mut dyn Context) {
        self.aim = I24F8::ZERO;
        self.set_duty(at, 0, out);
        let position = self.planned(at);
        self.go(at, Plan::rest(at, position), out);
    }

    /// The plan has come to its end: so does a brush motor's duty, before its period is over.
    pub(super) fn over(&mut self, at: Instant, out: &mut dyn Context) {
        self.set_duty(at, self.duty_of(self.aim.into()), out);
        self.schedule(at);
    }

    /// A step without a ramp.
    pub(super) fn step(&mut self, at: Instant, steps: i32, out: &mut dyn Context) {
        if self.stands.is_none() {
            self.beside = self.beside.wrapping_add(steps);
            out.put(at, Output::Step { axis: AXIS, steps });
        }
    }

    /// A board has made so many steps more than planned.
    pub(super) fn slipped(&mut self, steps: i32) {
        self.beside = self.beside.wrapping_add(steps);
    }

    pub(super) fn deadline(&self) -> Instant {
        self.next_period
    }

    /// A period of the PWM begins.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.next_period <= at {
            let duty = self.duty_of(self.plan.speed_at(at));
            self.set_duty(at, duty, out);
            self.schedule(at);
        }
    }

    /// Position of the plan, with the steps beside it.
    fn planned(&self, at: Instant) -> i32 {
        self.plan.position_at(at).wrapping_add(self.beside)
    }

    fn go(&mut self, at: Instant, plan: Plan, out: &mut dyn Context) {
        (self.plan, self.beside) = (plan, 0);
        if self.stands.is_none() {
            out.put(at, Output::Plan { axis: AXIS, plan: &self.plan });
        }
        self.schedule(at);
    }

    /// Follows the plan from here on, or stands still.
    fn follow(&mut self, at: Instant, out: &mut dyn Context) {
        let stands = !self.has_current || self.pwm.is_some();
        let rests = self.end() <= at;
        match self.stands {
            None if stands => {
                let position = self.planned(at);
                self.stands = Some(position);
                if !rests {
                    out.put(at, Output::Plan { axis: AXIS, plan: &Plan::rest(at, position) });
                }
            }
            Some(position) if !stands => {
                self.stands = None;
                if rests {
                    (self.plan, self.beside) = (Plan::rest(at, position), 0);
                } else {
                    self.go(at, self.plan.resumed(at, position), out);
                }
            }
            _ => {}
        }
        if !self.has_current {
            self.set_duty(at, 0, out);
        }
        self.schedule(at);
    }

    /// Schedules the next change of duty: with a period, never within one (MD3-32).
    fn schedule(&mut self, at: Instant) {
        self.next_period = match self.pwm {
            Some(Pwm { period, .. }) if self.has_current && self.duty != self.duty_of(self.aim.into()) => {
                let begun = at.since(Instant::ZERO) / period;
                Instant::ZERO + period * (begun + 1)
            }
            _ => Instant::NEVER,
        };
    }

    /// The duty of so many counts, in 1/65536 of full on.
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
