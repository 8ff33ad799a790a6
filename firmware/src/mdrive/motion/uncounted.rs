//! What a Hybrid's circuitry does with the shaft on its own: C1 does not count it (MC 5-9).

use fixed::types::I24F8;

use super::Motion;
use super::motor::STEPS_PER_REV;
use super::orders::Activity;
use crate::device::{Instant, Plan, Sink};
use crate::motion::Rates;

/// Where position and shaft round differently, they are that much apart.
const ROUNDING: u32 = 1;

impl Motion {
    /// Turns the shaft by so many steps, at this share of its current, until an order comes. What runs so already ends;
    /// from anything else but rest nothing comes of it.
    pub(in crate::mdrive) fn turn_uncounted(
        &mut self,
        at: Instant,
        steps: i32,
        rates: Rates,
        percent: u8,
        out: &mut dyn Sink,
    ) {
        if self.begin_uncounted(at, percent, true, out) {
            let plan = Plan::profile(at, self.motor.position(at), steps, rates);
            self.go_uncounted(at, plan, out);
        }
    }

    /// As [`Self::turn_uncounted`], without end, and no order comes through; from what runs so already it goes on.
    pub(in crate::mdrive) fn spin_uncounted(
        &mut self,
        at: Instant,
        speed: I24F8,
        acceleration: u32,
        percent: u8,
        out: &mut dyn Sink,
    ) {
        let plan = self.motor.plan().towards(at, speed, acceleration);
        if self.begin_uncounted(at, percent, false, out) {
            self.go_uncounted(at, plan, out);
        }
    }

    /// Ends that, where it is.
    pub(in crate::mdrive) fn end_uncounted(&mut self, at: Instant, out: &mut dyn Sink) {
        if let Activity::Uncounted { steps, .. } = self.activity {
            let plan = self.motor.plan().halt(at);
            self.go_uncounted(at, plan, out);
            self.c1 = steps.wrapping_sub(self.motor.position(at));
            self.watch_from(at);
            self.rest(at);
            self.refresh(at, out);
        }
    }

    /// When the plan of it is done.
    pub(in crate::mdrive) fn plan_ends(&self) -> Instant {
        self.motor.plan().end()
    }

    /// Whether nothing moves but what C1 does not count.
    pub(in crate::mdrive) fn is_at_rest(&self) -> bool {
        self.activity == Activity::Rest
    }

    /// A rotor that is free again does not wait for standstill: it goes on from where it is.
    pub(in crate::mdrive) fn catch_rotor(&mut self, at: Instant, out: &mut dyn Sink) {
        self.motor.catch(at);
        self.refresh(at, out);
    }

    /// Whether the circuitry turns it.
    pub(in crate::mdrive) fn is_uncounted(&self) -> bool {
        matches!(self.activity, Activity::Uncounted { .. })
    }

    /// Whether the shaft does what the plan says.
    pub(in crate::mdrive) fn follows(&self) -> bool {
        self.motor.follows()
    }

    /// Whether the shaft stands, and is where the plan has it.
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

    /// When the rotor comes to lag by so many steps, as long as it stands; [`Instant::NEVER`] if it does not.
    pub(in crate::mdrive) fn lags(&self, at: Instant, steps: i32) -> Instant {
        let way = steps.wrapping_sub(self.lag(at));
        self.motor.plan().when(at, self.motor.position(at).wrapping_add(way))
    }

    fn behind(&self, at: Instant) -> i32 {
        let steps_per_rev = i128::from(STEPS_PER_REV) * i128::from(self.settings.microsteps);
        let shaft = (i128::from(self.motor.angle(at)) * steps_per_rev) >> 32;
        self.steps(at).wrapping_sub(shaft as i32)
    }

    fn begin_uncounted(&mut self, at: Instant, percent: u8, yields: bool, out: &mut dyn Sink) -> bool {
        let steps = self.steps(at);
        let begins = matches!(self.activity, Activity::Rest | Activity::Uncounted { .. });
        if begins {
            self.enter(Activity::Uncounted { steps, percent, yields }, Instant::NEVER);
            self.refresh(at, out);
        }
        begins
    }

    fn go_uncounted(&mut self, at: Instant, plan: Plan, out: &mut dyn Sink) {
        self.motor.go(at, plan, out);
        self.changed = true;
    }
}
