//! The drive's outputs to its motor: steps along a plan while there is current, or a duty cycle.

use core::num::{NonZeroU32, NonZeroU64};

use drivetwin_protocol::time::TICKS_PER_SECOND;
use fixed::types::{I24F8, I48F16};

use super::AXIS;
use crate::device::{Context, Duration, Instant, Output, Plan};
use crate::motion::Limits;

/// Bit of `MotorCurrentAndMicrostepping`: a DC motor is connected to phase B.
pub(super) const DC: u16 = 1 << 13;

/// A value of `MotorCurrentAndMicrostepping` (7.2).
#[derive(Clone, Copy, Debug)]
pub(super) struct Setting(pub(super) u16);

impl Setting {
    /// Microsteps in a full step of a stepper. Codes beyond the table act as its last row. They do not change
    /// counts, which are always microsteps (MD3-17).
    pub(super) fn microsteps(self) -> u16 {
        if self.is_dc() { 1 } else { 1 << self.parameter().min(LAST_PARAMETER) }
    }

    /// Returns true for a stepper without microsteps.
    pub(super) fn is_full_step(self) -> bool {
        !self.is_dc() && self.parameter() == 0
    }

    /// Returns true if the tables have the microstepping or PWM code.
    pub(super) fn has_parameter(self) -> bool {
        self.parameter() <= LAST_PARAMETER
    }

    fn is_dc(self) -> bool {
        self.0 & DC != 0
    }

    /// The motor control parameter: the microstepping or PWM code.
    fn parameter(self) -> u16 {
        self.0 >> 8 & 0x1F
    }

    /// PWM of a DC motor; `None` for a stepper. Codes beyond the table act as its last row.
    fn pwm(self) -> Option<Pwm> {
        if !self.is_dc() {
            return None;
        }
        let (hz, range) = PWM.get(usize::from(self.parameter().min(LAST_PARAMETER)))?;
        let ticks = (TICKS_PER_SECOND as u32).checked_div(*hz)?;
        Some(Pwm { period: Duration::from_ticks(ticks.into()), range: NonZeroU32::new(*range)? })
    }
}

/// Last microstepping or PWM code of the tables.
const LAST_PARAMETER: u16 = 8;

/// PWM frequencies in Hz, in the order of the motor control parameter, and the duty cycle steps of each
/// (7.2).
const PWM: [(u32, u32); 9] = [
    (500, 40_000),
    (1_000, 20_000),
    (2_000, 40_000),
    (5_000, 16_000),
    (10_000, 8_000),
    (16_000, 5_000),
    (20_000, 4_000),
    (25_000, 3_200),
    (40_000, 2_000),
];

/// PWM of a DC motor (7.2).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Pwm {
    /// Duration of a PWM cycle.
    period: Duration,
    /// Number of counts in a whole cycle: the on time at full duty.
    range: NonZeroU32,
}

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
    /// Peak phase current, in mA.
    current: u32,
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
            current: 0,
            pwm: None,
            duty: 0,
            target_counts: I24F8::ZERO,
            next_period: Instant::NEVER,
        }
    }

    /// Power-on: puts the first plan and current.
    pub(super) fn begin(&self, at: Instant, out: &mut dyn Context) {
        out.put(at, Output::Plan { axis: AXIS, plan: &self.plan });
        out.put(at, Output::CurrentLimit { axis: AXIS, ma: self.current });
    }

    /// End of the plan.
    pub(super) fn end(&self) -> Instant {
        self.plan.end()
    }

    /// Returns true if the motor is a brush motor.
    pub(super) fn is_dc(&self) -> bool {
        self.pwm.is_some()
    }

    /// A speed in steps/s, or in counts of a brush motor: at most all counts of a PWM cycle.
    pub(super) fn speed(&self, speed: i32) -> I24F8 {
        let speed = match self.pwm {
            Some(pwm) => speed.min(pwm.range.get().cast_signed()).max(-pwm.range.get().cast_signed()),
            None => speed,
        };
        // The value is at most 40,000, so the shift does not overflow.
        I24F8::from_bits(speed << 8)
    }

    /// Returns true if a brush motor has a duty other than 0.
    pub(super) fn is_driven(&self) -> bool {
        self.duty != 0
    }

    /// Returns true if a setting changes the type of the motor. The motor must stop before.
    pub(super) fn is_changed_by(&self, setting: Setting) -> bool {
        self.is_dc() != setting.is_dc()
    }

    /// Selects a stepper, or a brush motor and its PWM. Counts refer to the new range from the next PWM period on.
    pub(super) fn configure(&mut self, at: Instant, setting: Setting, out: &mut dyn Context) {
        self.pwm = setting.pwm();
        self.update_output(at, out);
    }

    /// Peak phase current, in mA.
    pub(super) fn current(&self) -> u32 {
        self.current
    }

    /// Sets the current.
    pub(super) fn set_current(&mut self, at: Instant, ma: u32, out: &mut dyn Context) {
        if self.current == ma {
            return;
        }
        let had_current = self.has_current();
        self.current = ma;
        out.put(at, Output::CurrentLimit { axis: AXIS, ma });
        if self.has_current() != had_current {
            self.update_output(at, out);
        }
    }

    fn has_current(&self) -> bool {
        self.current > 0
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
        let is_held = !self.has_current() || self.pwm.is_some();
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
        if !self.has_current() {
            self.set_duty(at, 0, out);
        }
        self.schedule(at);
    }

    /// Schedules the next change of the duty: at the start of a PWM period, never within one (MD3-32).
    fn schedule(&mut self, at: Instant) {
        self.next_period = match self.pwm {
            Some(Pwm { period, .. })
                if self.has_current() && self.duty != self.duty_of(self.target_counts.into()) =>
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
