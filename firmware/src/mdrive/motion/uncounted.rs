//! Motion by a Hybrid's circuitry alone: C1 does not count it (MC 5-9).

use fixed::types::I24F8;

use super::orders::{Activity, Preemption};
use super::{Motion, Settings};
use crate::device::{Context, Duration, Instant, Plan};
use crate::motion::Limits;

/// Difference by which position and shaft may be apart, because they round differently.
const ROUNDING: u32 = 1;
/// Interval at which a rotor that is too slow is checked.
const LOOK: Duration = Duration::millis(1);

impl Motion {
    /// Turns the shaft by so many steps, at this share of its current, until an order comes. What runs so already ends;
    /// from anything else but rest nothing comes of it.
    pub(in crate::mdrive) fn turn_uncounted(
        &mut self,
        at: Instant,
        steps: i32,
        rates: Limits,
        percent: u8,
        out: &mut dyn Context,
    ) {
        let plan = Plan::profile(at, self.motor.position(at), steps, rates);
        self.begin_uncounted(at, plan, percent, Preemption::AtOnce, out);
    }

    /// As [`Self::turn_uncounted`], without end, and no order comes through; from what runs so already it goes on. What
    /// turns so has inertia: it does not stand because its bridge is off.
    pub(in crate::mdrive) fn spin_uncounted(
        &mut self,
        at: Instant,
        speed: I24F8,
        acceleration: u32,
        percent: u8,
        out: &mut dyn Context,
    ) {
        let plan = self.motor.plan().towards(at, speed, acceleration);
        self.begin_uncounted(at, plan, percent, Preemption::Never, out);
    }

    /// Slows down what spins; an order waits until it stands.
    pub(in crate::mdrive) fn slow_uncounted(
        &mut self,
        at: Instant,
        deceleration: u32,
        percent: u8,
        out: &mut dyn Context,
    ) {
        let plan = self.motor.plan().towards(at, I24F8::ZERO, deceleration);
        self.begin_uncounted(at, plan, percent, Preemption::AtStandstill, out);
    }

    /// Stops a spinning shaft from outside.
    pub(in crate::mdrive) fn stop_uncounted(&mut self, at: Instant, out: &mut dyn Context) {
        self.go_uncounted(at, self.motor.plan().halt(at), out);
    }

    /// Ends that, where it is: what has waited for that begins.
    pub(in crate::mdrive) fn end_uncounted(&mut self, at: Instant, out: &mut dyn Context) {
        if let Activity::Uncounted { steps, .. } = self.activity {
            let plan = self.motor.plan().halt(at);
            self.go_uncounted(at, plan, out);
            self.c1 = steps.wrapping_sub(self.motor.position(at));
            self.watch_from(at);
            self.over(at, out);
            self.refresh(at, out);
        }
    }

    /// Speed by the circuitry, in steps/s, but for a fraction.
    pub(in crate::mdrive) fn turns(&self, at: Instant) -> I24F8 {
        let speed = self.motor.plan().speed_at(at);
        let size = I24F8::saturating_from_num(speed.abs());
        if speed < 0 { -size } else { size }
    }

    /// Returns whether this motion has inertia.
    pub(super) fn spins(&self) -> bool {
        matches!(
            self.activity,
            Activity::Uncounted { yields: Preemption::Never | Preemption::AtStandstill, .. }
        )
    }

    /// End of its plan.
    pub(in crate::mdrive) fn plan_ends(&self) -> Instant {
        self.motor.plan().end()
    }

    /// Returns whether no motion that C1 counts runs.
    pub(in crate::mdrive) fn is_at_rest(&self) -> bool {
        self.activity == Activity::Rest
    }

    /// A rotor that is free again does not wait for standstill: it goes on from where it is.
    pub(in crate::mdrive) fn catch_rotor(&mut self, at: Instant, out: &mut dyn Context) {
        self.motor.catch(at);
        self.refresh(at, out);
    }

    /// Returns whether its torque would turn the rotor from rest.
    pub(in crate::mdrive) fn can_turn(&self, forward: bool) -> bool {
        self.motor.can_turn(forward)
    }

    /// Returns whether the circuitry turns it.
    pub(in crate::mdrive) fn is_uncounted(&self) -> bool {
        matches!(self.activity, Activity::Uncounted { .. })
    }

    /// Returns whether the shaft follows the plan.
    pub(in crate::mdrive) fn follows(&self) -> bool {
        self.motor.follows()
    }

    /// Returns whether the shaft stands, and is where the plan has it.
    pub(in crate::mdrive) fn shaft_stands(&self) -> bool {
        let pace = self.motor.pace();
        self.motor.follows() && pace.h == 0 && pace.a == 0
    }

    /// Steps that the rotor is behind the steps made, since [`Self::clear_lag`].
    pub(in crate::mdrive) fn lag(&self, at: Instant) -> i32 {
        let lag = self.behind(at).wrapping_sub(self.lag_origin);
        if lag.unsigned_abs() <= ROUNDING { 0 } else { lag }
    }

    /// From now on the rotor neither lags nor leads.
    pub(in crate::mdrive) fn clear_lag(&mut self, at: Instant) {
        self.lag_origin = self.behind(at);
    }

    /// Returns whether it is too fast for the rotor, which lags more and more.
    pub(in crate::mdrive) fn is_too_fast(&self) -> bool {
        self.motor.is_too_fast()
    }

    /// Time at which the rotor comes to lag by so many steps, if it stands, or is to be checked again, if it is too
    /// slow or its load turns it; [`Instant::NEVER`] if it lags no more than now.
    pub(in crate::mdrive) fn lags(&self, at: Instant, steps: i32) -> Instant {
        if self.follows() {
            return if self.is_too_fast() { at + LOOK } else { Instant::NEVER };
        }
        if self.motor.slides() {
            return at + LOOK;
        }
        let way = steps.wrapping_sub(self.lag(at));
        self.motor.plan().when(at, self.motor.position(at).wrapping_add(way))
    }

    fn behind(&self, at: Instant) -> i32 {
        let Settings { machine, microsteps, .. } = self.settings;
        let steps_per_rev = i128::from(machine.steps_per_rev) * i128::from(microsteps);
        let shaft = (i128::from(self.motor.angle(at)) * steps_per_rev) >> 32;
        self.steps(at).wrapping_sub(shaft as i32)
    }

    fn begin_uncounted(
        &mut self,
        at: Instant,
        plan: Plan,
        percent: u8,
        yields: Preemption,
        out: &mut dyn Context,
    ) {
        if matches!(self.activity, Activity::Rest | Activity::Uncounted { .. }) {
            let steps = self.steps(at);
            self.enter(Activity::Uncounted { steps, percent, yields }, Instant::NEVER);
            // Its current first, or it would not follow.
            self.refresh(at, out);
            self.go_uncounted(at, plan, out);
        }
    }

    fn go_uncounted(&mut self, at: Instant, plan: Plan, out: &mut dyn Context) {
        self.motor.go(at, plan, out);
        self.changed = true;
    }
}
