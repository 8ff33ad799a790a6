//! A segment of a plan.

use core::num::NonZero;

use super::super::search::first_true;
use super::STEP;

/// A part of a plan with constant acceleration, in one direction.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Segment {
    /// Length in ticks; `u64::MAX` without end.
    pub ticks: u64,
    /// Acceleration in steps/s²; negative slows down.
    pub acceleration: i32,
    /// Speed at its first tick, in steps/s times ticks/s; never negative.
    pub start_speed: i64,
    /// Position at its first tick, without `phase_offset`.
    pub base: i32,
    /// Phase beyond `base` at its first tick, `0..2·f²`.
    pub phase_offset: i64,
    /// True if steps count down.
    pub reverse: bool,
}

impl Segment {
    /// Speed `d` ticks in, in the unit of `start_speed`.
    pub(crate) fn speed(&self, d: u64) -> i64 {
        self.start_speed + i64::from(self.acceleration) * d.cast_signed()
    }

    /// Phase beyond `base`, `d` ticks in.
    #[inline(never)]
    pub(crate) fn phase(&self, d: u64) -> i128 {
        i128::from(self.phase_offset) + i128::from(d) * i128::from(self.start_speed + self.speed(d))
    }

    /// Steps made beyond `base`, `d` ticks in: those whose nearest tick is not later.
    pub(crate) fn steps_made(&self, d: u64) -> u64 {
        let half_a_tick = (self.speed(d) - 1).max(0);
        steps_in(self.phase(d) + i128::from(half_a_tick))
    }

    /// Position `d` ticks in.
    pub(in crate::motion) fn position(&self, d: u64) -> i32 {
        self.step(self.steps_made(d))
    }

    /// The position `steps` beyond `base`; positions wrap at 32 bits.
    pub(in crate::motion) fn step(&self, steps: u64) -> i32 {
        let steps = (steps as u32).cast_signed();
        if self.reverse { self.base.wrapping_sub(steps) } else { self.base.wrapping_add(steps) }
    }

    /// The segment, begun at another phase beyond its `base`.
    #[inline(never)]
    pub(super) fn at_phase(self, phase: i128) -> Self {
        let steps = steps_in(phase);
        // Less than a step, so 64 bits of both are enough.
        let rest = (phase as i64).wrapping_sub(STEP.wrapping_mul(steps.cast_signed()));
        Self { base: self.step(steps), phase_offset: rest, ..self }
    }

    /// The rest of this segment `d` ticks in.
    pub(super) fn since(self, d: u64) -> Self {
        let ticks = if self.ticks == u64::MAX { u64::MAX } else { self.ticks.saturating_sub(d) };
        Self { ticks, start_speed: self.speed(d), ..self }.at_phase(self.phase(d))
    }

    /// The last `ticks` of a way of which this is the beginning: the acceleration `down` run backwards from
    /// its end, where it is as fast as here.
    #[inline(never)]
    pub(super) fn stop_ramp_to(self, distance: i128, ticks: u64, down: NonZero<u32>) -> Self {
        let backwards = Self { acceleration: down.get().cast_signed(), ..self };
        let stop = Self {
            ticks,
            acceleration: -backwards.acceleration,
            start_speed: backwards.speed(ticks),
            ..self
        };
        stop.at_phase(distance - backwards.phase(ticks))
    }

    /// A ramp down to the speed `last` and an immediate stop there, and the position of that stop. A segment that is
    /// not faster than `last` stops where it is.
    #[inline(never)]
    pub(super) fn stop(self, last: i64, down: NonZero<u32>) -> (Self, i32) {
        let ticks = whole_ticks((self.start_speed - last).max(0).cast_unsigned(), down);
        let stop = Self { ticks, acceleration: -down.get().cast_signed(), ..self };
        // Standstill is reached a part of a tick before the last whole one; the phase is dropped there.
        let Some(before) = ticks.checked_sub(1) else { return (stop, self.position(0)) };
        let h = stop.speed(before).cast_unsigned();
        let left = braking_distance(h, last.cast_unsigned(), down).max(h.saturating_sub(1));
        (stop, stop.step(steps_in(stop.phase(before) + i128::from(left))))
    }

    /// On at this speed and a ramp down to the speed `last`, or none if this is not faster. They end with the first
    /// whole step that is within reach, and at least the phase `min_distance` away.
    #[inline(never)]
    pub(super) fn stop_on_step(self, last: i64, down: NonZero<u32>, min_distance: i64) -> [Self; 2] {
        let last = last.min(self.start_speed);
        let speed = self.start_speed.max(1).cast_unsigned();
        let (change, a) = ((self.start_speed - last).cast_unsigned(), NonZero::<u64>::from(down));
        let long = |number: u64| u128::from(number);
        let rest = long(self.phase_offset.cast_unsigned());
        // The ramp takes (speed² − last²)/a of the way; this is rounded up.
        let ramp = long(change) * (long(speed) + long(last.cast_unsigned())) + long(a.get() - 1);
        let reached =
            rest + divided(ramp, a).max(long(min_distance.cast_unsigned())) + long(STEP.cast_unsigned() - 1);
        let distance = long(steps_in(reached.cast_signed())) * long(STEP.cast_unsigned());
        // At `speed` alone it would take way/2·speed; the ramp loses change²/a/2·speed.
        let lost = distance.saturating_sub(rest) * long(a.get()) + long(change) * long(change);
        let twice = NonZero::<u64>::MIN.saturating_add(2 * speed - 1);
        // Rounded up, so that no step is taken back where the ramp begins.
        let end = divided(divided(lost + long(a.get() - 1), a) + long(twice.get() - 1), twice) as u64;
        let stop = change / a;
        let cruise = Self { ticks: end.saturating_sub(stop), acceleration: 0, ..self };
        [
            cruise,
            Self { start_speed: last, phase_offset: 0, acceleration: 0, ..self }.stop_ramp_to(
                distance.cast_signed(),
                stop,
                down,
            ),
        ]
    }

    /// The first tick after the one `since` ticks in at which it has come to `position`; once around all positions if
    /// it is there.
    pub(super) fn time_of(&self, since: u64, position: i32) -> Option<u64> {
        let steps_made = self.steps_made(since);
        let here = self.step(steps_made);
        let distance = if self.reverse { here.wrapping_sub(position) } else { position.wrapping_sub(here) };
        let distance = if distance == 0 { 1 << 32 } else { u64::from(distance.cast_unsigned()) };
        let last = self.ticks.checked_sub(1)?;
        let is_reached = |d| self.steps_made(d) >= steps_made + distance;
        let comes = self.ticks == u64::MAX || is_reached(last);
        comes.then(|| first_true(|d| d >= last || is_reached(d)))
    }

    /// From the beginning of this segment a ramp up to the speed `target`, or down to it, and the cruise
    /// at it.
    #[inline(never)]
    pub(super) fn ramp_and_cruise(self, target: i64, acceleration: NonZero<u32>, down: bool) -> [Self; 2] {
        let a = acceleration.get().cast_signed();
        let change = if down { self.start_speed - target } else { target - self.start_speed };
        let ticks = whole_ticks(change.max(0).cast_unsigned(), acceleration);
        let ramp = Self { ticks, acceleration: if down { -a } else { a }, ..self };
        // The target was reached a part of a tick before: the cruise is the tangent of the ramp there.
        let beyond = i128::from(vertex((ramp.speed(ticks) - target).unsigned_abs(), acceleration));
        let there = ramp.phase(ticks);
        let phase = if down { there + beyond } else { there - beyond };
        [ramp, Self { ticks: u64::MAX, acceleration: 0, start_speed: target, ..self }.at_phase(phase)]
    }
}

/// The whole ticks after which the speed has changed by `change`, or by a part of a tick's more.
fn whole_ticks(change: u64, a: NonZero<u32>) -> u64 {
    change.div_ceil(NonZero::<u64>::from(a).get())
}

/// Distance from the speed `h` down to `last`, which is not more than a tick's change below.
fn braking_distance(h: u64, last: u64, a: NonZero<u32>) -> u64 {
    if last == 0 {
        return vertex(h, a);
    }
    divided(u128::from(h - last) * u128::from(h + last), a.into()) as u64
}

/// Distance to standstill at the speed `h`, which is not more than a tick's change.
pub(super) fn vertex(h: u64, a: NonZero<u32>) -> u64 {
    h * h / NonZero::<u64>::from(a)
}

/// Whole steps in `phase`, which is negative by rounding only.
#[inline(never)]
fn steps_in(phase: i128) -> u64 {
    /// Odd part of [`STEP`], without its factors of 2: 5¹².
    const ODD: u64 = (STEP >> STEP.trailing_zeros()).cast_unsigned();
    // Two digits of 32 bits: a division of 128 is as long as all of a plan.
    let phase = phase.max(0).cast_unsigned() >> STEP.trailing_zeros();
    let (high, low) = ((phase >> 32) as u64, phase as u32);
    let rest = (high % ODD) << 32 | u64::from(low);
    ((high / ODD) << 32) | (rest / ODD)
}

/// The one long division. That of the language is faster where the quotient is long, and takes a kilobyte.
#[inline(never)]
pub(super) fn divided(number: u128, by: NonZero<u64>) -> u128 {
    let mut part = u128::from(by.get());
    let (mut rest, mut quotient) = (number, 0);
    let bits = part.leading_zeros().saturating_sub(number.leading_zeros());
    part <<= bits;
    for _ in 0..=bits {
        quotient <<= 1;
        if let Some(less) = rest.checked_sub(part) {
            rest = less;
            quotient |= 1;
        }
        part >>= 1;
    }
    quotient
}
