//! Motion that a Hybrid's circuitry makes on its own. C1 does not count it (MC 5-9).

use fixed::types::I24F8;

use super::orders::{Activity, Preemption};
use super::{Motion, Settings};
use crate::device::{Context, Duration, Instant, Plan};
use crate::motion::Limits;

/// Largest difference between position and shaft that comes from rounding only, in steps.
const ROUNDING: u32 = 1;
/// Interval of checks while the rotor is too slow or its load turns it.
const CHECK_PERIOD: Duration = Duration::millis(1);

impl Motion {
    /// Turns the shaft by a number of steps at a percentage of its current. The axis must be at rest or
    /// circuit-driven; otherwise nothing happens. This motion replaces a running circuit-driven motion, and a
    /// motion command ends it.
    pub(in crate::mdrive) fn circuit_turn(
        &mut self,
        at: Instant,
        steps: i32,
        rates: Limits,
        percent: u8,
        out: &mut dyn Context,
    ) {
        let plan = Plan::profile(at, self.motor.position(at), steps, rates);
        self.circuit_start(at, plan, percent, Preemption::AtOnce, out);
    }

    /// Turns the shaft without end, and ignores motion commands; otherwise as [`Self::circuit_turn`]. The
    /// shaft accelerates from its present speed. It has inertia, so it does not stop when the bridge is
    /// switched off.
    pub(in crate::mdrive) fn circuit_spin(
        &mut self,
        at: Instant,
        speed: I24F8,
        acceleration: u32,
        percent: u8,
        out: &mut dyn Context,
    ) {
        let plan = self.motor.plan().ramp_to(at, speed, acceleration);
        self.circuit_start(at, plan, percent, Preemption::Never, out);
    }

    /// Slows down a spinning shaft. A motion command waits until the shaft is at rest.
    pub(in crate::mdrive) fn circuit_slow(
        &mut self,
        at: Instant,
        deceleration: u32,
        percent: u8,
        out: &mut dyn Context,
    ) {
        let plan = self.motor.plan().ramp_to(at, I24F8::ZERO, deceleration);
        self.circuit_start(at, plan, percent, Preemption::AtStandstill, out);
    }

    /// Stops a spinning shaft at once, because something outside stops it.
    pub(in crate::mdrive) fn circuit_stop(&mut self, at: Instant, out: &mut dyn Context) {
        self.circuit_run_plan(at, self.motor.plan().halt(at), out);
    }

    /// Ends the circuit-driven motion at its present position. A waiting task begins.
    pub(in crate::mdrive) fn circuit_end(&mut self, at: Instant, out: &mut dyn Context) {
        if let Activity::CircuitDriven { steps, .. } = self.activity {
            let plan = self.motor.plan().halt(at);
            self.circuit_run_plan(at, plan, out);
            self.c1 = steps.wrapping_sub(self.motor.position(at));
            self.watch_from(at);
            self.over(at, out);
            self.refresh(at, out);
        }
    }

    /// Speed of the plan, in steps/s, truncated to 1/256.
    pub(in crate::mdrive) fn circuit_speed(&self, at: Instant) -> I24F8 {
        let speed = self.motor.plan().speed_at(at);
        let size = I24F8::saturating_from_num(speed.abs());
        if speed < 0 { -size } else { size }
    }

    /// Returns true if the present motion has inertia.
    pub(super) fn spins(&self) -> bool {
        matches!(
            self.activity,
            Activity::CircuitDriven { preemption: Preemption::Never | Preemption::AtStandstill, .. }
        )
    }

    /// End of the present plan.
    pub(in crate::mdrive) fn plan_ends(&self) -> Instant {
        self.motor.plan().end()
    }

    /// Returns true if the axis is at rest: nothing moves, settles or is calculated.
    pub(in crate::mdrive) fn is_at_rest(&self) -> bool {
        self.activity == Activity::Rest
    }

    /// Lets a rotor that is free again continue from its present position, without waiting for standstill.
    pub(in crate::mdrive) fn resynchronise_rotor(&mut self, at: Instant, out: &mut dyn Context) {
        self.motor.resynchronise(at);
        self.refresh(at, out);
    }

    /// Returns true if the motor's torque can turn the rotor from rest in this direction.
    pub(in crate::mdrive) fn can_turn(&self, forward: bool) -> bool {
        self.motor.can_turn(forward)
    }

    /// Returns true if the circuitry turns the motor.
    pub(in crate::mdrive) fn is_circuit_driven(&self) -> bool {
        matches!(self.activity, Activity::CircuitDriven { .. })
    }

    /// Returns true if the shaft follows the plan.
    pub(in crate::mdrive) fn follows(&self) -> bool {
        self.motor.follows()
    }

    /// Returns true if the shaft is at rest at the plan's position.
    pub(in crate::mdrive) fn shaft_stands(&self) -> bool {
        let kinematics = self.motor.kinematics();
        self.motor.follows() && kinematics.half_speed == 0 && kinematics.half_acceleration == 0
    }

    /// Steps by which the rotor is behind the steps made, counted from the last [`Self::clear_lag`].
    pub(in crate::mdrive) fn lag(&self, at: Instant) -> i32 {
        let lag = self.raw_lag(at).wrapping_sub(self.lag_origin);
        if lag.unsigned_abs() <= ROUNDING { 0 } else { lag }
    }

    /// Makes the present lag count as 0.
    pub(in crate::mdrive) fn clear_lag(&mut self, at: Instant) {
        self.lag_origin = self.raw_lag(at);
    }

    /// Returns true if the plan is too fast for the rotor, so that the rotor lags more and more.
    pub(in crate::mdrive) fn is_too_fast(&self) -> bool {
        self.motor.is_too_fast()
    }

    /// Time at which a rotor at rest will lag by this many steps; [`Instant::NEVER`] if the plan does not
    /// lead there. If the rotor is too slow or its load turns it, this is the time of the next check.
    pub(in crate::mdrive) fn lag_time(&self, at: Instant, steps: i32) -> Instant {
        if self.follows() {
            return if self.is_too_fast() { at + CHECK_PERIOD } else { Instant::NEVER };
        }
        if self.motor.slides() {
            return at + CHECK_PERIOD;
        }
        let way = steps.wrapping_sub(self.lag(at));
        self.motor.plan().time_of(at, self.motor.position(at).wrapping_add(way))
    }

    fn raw_lag(&self, at: Instant) -> i32 {
        let Settings { machine, microsteps, .. } = self.settings;
        let steps_per_rev = i128::from(machine.steps_per_rev) * i128::from(microsteps);
        let shaft = (i128::from(self.motor.angle(at)) * steps_per_rev) >> 32;
        self.steps(at).wrapping_sub(shaft as i32)
    }

    fn circuit_start(
        &mut self,
        at: Instant,
        plan: Plan,
        percent: u8,
        preemption: Preemption,
        out: &mut dyn Context,
    ) {
        if matches!(self.activity, Activity::Rest | Activity::CircuitDriven { .. }) {
            let steps = self.steps(at);
            self.enter(Activity::CircuitDriven { steps, percent, preemption }, Instant::NEVER);
            // The current is set first, because without current the shaft would not follow.
            self.refresh(at, out);
            self.circuit_run_plan(at, plan, out);
        }
    }

    fn circuit_run_plan(&mut self, at: Instant, plan: Plan, out: &mut dyn Context) {
        self.motor.set_plan(at, plan, out);
        self.changed = true;
    }
}
