//! The motor on the drive's own shaft: the plan that turns it, and its current.

use super::response::Response;
use crate::device::{Axis, Context, Duration, Instant, Output, Plan};
use crate::motor::stepper::{StepperMotor, StepperParameters};
use crate::motor::{Command, Kinematics, Plant};

const AXIS: Axis = Axis(0);

/// Peak current at 100 %, in mA. The manual gives no figure ("as motor is appropriately sized", MC 5-28), so
/// the motor's rated current is used.
const PEAK_MA: u32 = StepperParameters::NOMINAL.rated_ma;

/// The motor with its plan and its current.
#[derive(Clone, Debug)]
pub(super) struct Motor {
    shaft: StepperMotor,
    plan: Plan,
    /// Present current, in mA; `None` if it was not set since power-on.
    ma: Option<u32>,
    /// Current with which the shaft follows the plan: the present one, or the last one while inertia turns
    /// the shaft.
    pull_ma: Option<u32>,
    pub(super) response: Response,
}

impl Motor {
    /// Creates a motor at rest at position 0 and angle 0, without current.
    pub(super) fn new(microsteps: u16) -> Self {
        let mut shaft = StepperMotor::new(StepperParameters::NOMINAL);
        shaft.set_microsteps(Instant::ZERO, microsteps);
        Self {
            shaft,
            plan: Plan::at_rest(Instant::ZERO, 0),
            ma: None,
            pull_ma: None,
            response: Response::FULL,
        }
    }

    /// Handles power-on: the position is 0, wherever the shaft is.
    pub(super) fn power_on(&mut self, at: Instant, out: &mut dyn Context) {
        self.set_plan(at, Plan::at_rest(at, 0), out);
        (self.ma, self.pull_ma) = (None, None);
    }

    /// Present plan.
    pub(super) fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Position of the plan, in steps.
    pub(super) fn position(&self, at: Instant) -> i32 {
        self.plan.position_at(at)
    }

    /// Returns true if the plan moves in this direction, now or later.
    pub(super) fn moves(&self, at: Instant, back: bool) -> bool {
        let mut end = self.plan.start();
        self.plan.segments().iter().any(|segment| {
            end += Duration::from_ticks(segment.ticks);
            end > at && segment.ticks > 0 && segment.reverse == back
        })
    }

    /// Makes the motor follow `plan` from `at` on.
    pub(super) fn set_plan(&mut self, at: Instant, plan: Plan, out: &mut dyn Context) {
        self.plan = plan;
        self.response.update(at, &self.plan);
        self.lead_shaft(at, out);
    }

    /// Makes steps without a ramp, from standstill.
    pub(super) fn step(&mut self, at: Instant, steps: i32, out: &mut dyn Context) {
        self.plan = Plan::at_rest(at, self.position(at).wrapping_add(steps));
        self.shaft.command(at, Command::Step(steps), &mut ());
        out.put(at, Output::Step { axis: AXIS, steps });
    }

    /// Sets the current, in %; `None` opens the bridge. If `turns_on`, inertia turns the shaft: without
    /// current it continues along its plan.
    pub(super) fn energize(
        &mut self,
        at: Instant,
        percent: Option<u8>,
        turns_on: bool,
        out: &mut dyn Context,
    ) {
        let ma = u32::from(percent.unwrap_or(0)) * PEAK_MA / 100;
        let is_pulled = ma != 0 || !turns_on;
        if is_pulled && self.pull_ma.replace(ma) != Some(ma) {
            self.shaft.command(at, Command::CurrentLimit(ma), &mut ());
        }
        if self.ma.replace(ma) != Some(ma) {
            out.put(at, Output::CurrentLimit { axis: AXIS, ma });
        }
    }

    /// Sets the maximum speed of the shaft, in steps/s.
    pub(super) fn limit(&mut self, at: Instant, most: u32, out: &mut dyn Context) {
        if self.response.max_speed != most {
            self.response.max_speed = most;
            self.respond(at, out);
        }
    }

    /// Returns true if the plan is faster than the shaft can be.
    pub(super) fn is_too_fast(&self) -> bool {
        self.response.is_too_fast
    }

    fn respond(&mut self, at: Instant, out: &mut dyn Context) {
        if self.response.update(at, &self.plan) {
            self.lead_shaft(at, out);
        }
    }

    fn lead_shaft(&mut self, at: Instant, out: &mut dyn Context) {
        let plan = self.response.of(at, &self.plan);
        self.shaft.command(at, Command::Plan(&plan), &mut ());
        out.put(at, Output::Plan { axis: AXIS, plan: &plan });
    }

    /// Blocks the shaft, or releases it.
    pub(super) fn set_blocked(&mut self, at: Instant, blocked: bool) {
        self.shaft.set_blocked(at, blocked, &mut ());
    }

    /// Sets the parameters of the motor and its load.
    pub(super) fn load(&mut self, at: Instant, machine: StepperParameters) {
        self.shaft.load(at, machine);
    }

    /// Sets whether the field stays next to a shaft that does not follow.
    pub(super) fn keep_field(&mut self, at: Instant, keeps: bool) {
        self.shaft.keep_field(at, keeps);
    }

    /// Returns true if the motor can turn from rest in this direction.
    pub(super) fn can_turn(&self, forward: bool) -> bool {
        self.shaft.can_turn(forward)
    }

    /// Returns true if the shaft is at the plan's position, not on its way there.
    pub(super) fn is_in_step(&self, at: Instant) -> bool {
        self.shaft.is_in_step(at)
    }

    /// Returns true if the load turns the shaft.
    pub(super) fn slides(&self) -> bool {
        let kinematics = self.shaft.kinematics();
        !self.follows() && (kinematics.half_speed != 0 || kinematics.half_acceleration != 0)
    }

    /// Lets a shaft that is free again continue from its present position.
    pub(super) fn resynchronise(&mut self, at: Instant) {
        self.shaft.resynchronise(at);
    }

    /// Sets the number of microsteps in a full step, from `at` on.
    pub(super) fn set_microsteps(&mut self, at: Instant, microsteps: u16) {
        self.shaft.set_microsteps(at, microsteps);
    }

    /// Returns true if the shaft follows the plan, as far as its maximum speed allows.
    pub(super) fn follows(&self) -> bool {
        self.pull_ma != Some(0) && !self.shaft.stalled()
    }

    /// Angle of the shaft, in 2⁻³² revolutions. The result is valid up to [`Self::deadline`].
    pub(super) fn angle(&self, at: Instant) -> i64 {
        self.shaft.angle_at(at)
    }

    /// Present motion of the shaft.
    pub(super) fn kinematics(&self) -> Kinematics {
        self.shaft.kinematics()
    }

    /// Time at which the shaft changes its motion: the plan does so, or becomes too fast for the shaft.
    pub(super) fn deadline(&self) -> Instant {
        self.shaft.deadline().min(self.response.due)
    }

    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if self.response.due <= at {
            self.respond(at, out);
        }
        self.shaft.timeout(at, &mut ());
    }
}
