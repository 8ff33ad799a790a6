//! A stretch of a plan.

use core::num::NonZero;

use super::super::search::least;
use super::STEP;

/// A stretch of constant acceleration, in one direction.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Segment {
    /// Length in ticks; `u64::MAX` without end.
    pub ticks: u64,
    /// Acceleration in steps/s²; negative slows down.
    pub a: i32,
    /// Speed at its first tick, in steps/s times ticks/s; never negative.
    pub h: i64,
    /// Position at its first tick, without `rest`.
    pub from: i32,
    /// Phase beyond `from` at its first tick, `0..2·f²`.
    pub rest: i64,
    /// True if steps count down.
    pub back: bool,
}

impl Segment {
    /// Speed `d` ticks in, in the unit of `h`.
    pub(crate) fn speed(&self, d: u64) -> i64 {
        self.h + i64::from(self.a) * d.cast_signed()
    }

    /// Phase beyond `from`, `d` ticks in.
    #[inline(never)]
    pub(crate) fn phase(&self, d: u64) -> i128 {
        i128::from(self.rest) + i128::from(d) * i128::from(self.h + self.speed(d))
    }

    /// Steps made beyond `from`, `d` ticks in: every one whose nearest tick is not later.
    pub(crate) fn made(&self, d: u64) -> u64 {
        let half_a_tick = (self.speed(d) - 1).max(0);
        steps_in(self.phase(d) + i128::from(half_a_tick))
    }

    /// Position `d` ticks in.
    pub(in crate::motion) fn position(&self, d: u64) -> i32 {
        self.step(self.made(d))
    }

    /// The position `steps` beyond `from`; positions wrap at 32 bits.
    pub(in crate::motion) fn step(&self, steps: u64) -> i32 {
        let steps = (steps as u32).cast_signed();
        if self.back { self.from.wrapping_sub(steps) } else { self.from.wrapping_add(steps) }
    }

    /// The segment, begun at another phase beyond its `from`.
    #[inline(never)]
    pub(super) fn at_phase(self, phase: i128) -> Self {
        let steps = steps_in(phase);
        // Less than a step, so 64 bits of both are enough.
        let rest = (phase as i64).wrapping_sub(STEP.wrapping_mul(steps.cast_signed()));
        Self { from: self.step(steps), rest, ..self }
    }

    /// The rest of this segment `d` ticks in.
    pub(super) fn since(self, d: u64) -> Self {
        let ticks = if self.ticks == u64::MAX { u64::MAX } else { self.ticks.saturating_sub(d) };
        Self { ticks, h: self.speed(d), ..self }.at_phase(self.phase(d))
    }

    /// The last `ticks` of a way of which this is the beginning: the acceleration `down` run backwards from
    /// its end, where it is as fast as here.
    #[inline(never)]
    pub(super) fn ending(self, way: i128, ticks: u64, down: NonZero<u32>) -> Self {
        let backwards = Self { a: down.get().cast_signed(), ..self };
        let stop = Self { ticks, a: -backwards.a, h: backwards.speed(ticks), ..self };
        stop.at_phase(way - backwards.phase(ticks))
    }

    /// A ramp down to the speed `last`, from which it stands at once, and where it stands then. What is not faster
    /// stands where it is.
    #[inline(never)]
    pub(super) fn stop(self, last: i64, down: NonZero<u32>) -> (Self, i32) {
        let ticks = whole_ticks((self.h - last).max(0).cast_unsigned(), down);
        let stop = Self { ticks, a: -down.get().cast_signed(), ..self };
        // It stands a part of a tick before the last whole one, and there the phase is forgotten.
        let Some(before) = ticks.checked_sub(1) else { return (stop, self.position(0)) };
        let h = stop.speed(before).cast_unsigned();
        let left = way_to(h, last.cast_unsigned(), down).max(h.saturating_sub(1));
        (stop, stop.step(steps_in(stop.phase(before) + i128::from(left))))
    }

    /// On at this speed and a ramp down to the speed `last`, or none if this is not faster. They end with the first
    /// whole step that is within reach, and at least the phase `least` away.
    #[inline(never)]
    pub(super) fn stop_on_step(self, last: i64, down: NonZero<u32>, least: i64) -> [Self; 2] {
        let last = last.min(self.h);
        let speed = self.h.max(1).cast_unsigned();
        let (change, a) = ((self.h - last).cast_unsigned(), NonZero::<u64>::from(down));
        let long = |number: u64| u128::from(number);
        let rest = long(self.rest.cast_unsigned());
        // The ramp takes (speed² − last²)/a of the way; this is rounded up.
        let ramp = long(change) * (long(speed) + long(last.cast_unsigned())) + long(a.get() - 1);
        let reached =
            rest + divided(ramp, a).max(long(least.cast_unsigned())) + long(STEP.cast_unsigned() - 1);
        let way = long(steps_in(reached.cast_signed())) * long(STEP.cast_unsigned());
        // At `speed` alone it would take way/2·speed; the ramp loses change²/a/2·speed.
        let lost = way.saturating_sub(rest) * long(a.get()) + long(change) * long(change);
        let twice = NonZero::<u64>::MIN.saturating_add(2 * speed - 1);
        // Rounded up, so that no step is taken back where the ramp begins.
        let end = divided(divided(lost + long(a.get() - 1), a) + long(twice.get() - 1), twice) as u64;
        let stop = change / a;
        let cruise = Self { ticks: end.saturating_sub(stop), a: 0, ..self };
        [cruise, Self { h: last, rest: 0, a: 0, ..self }.ending(way.cast_signed(), stop, down)]
    }

    /// The first tick after the one `since` ticks in at which it has come to `position`; once around all positions if
    /// it is there.
    pub(super) fn reaches(&self, since: u64, position: i32) -> Option<u64> {
        let made = self.made(since);
        let here = self.step(made);
        let way = if self.back { here.wrapping_sub(position) } else { position.wrapping_sub(here) };
        let way = if way == 0 { 1 << 32 } else { u64::from(way.cast_unsigned()) };
        let last = self.ticks.checked_sub(1)?;
        let is_there = |d| self.made(d) >= made + way;
        let comes = self.ticks == u64::MAX || is_there(last);
        comes.then(|| least(|d| d >= last || is_there(d)))
    }

    /// From the beginning of this segment a ramp up to the speed `target`, or down to it, and the cruise
    /// at it.
    #[inline(never)]
    pub(super) fn reach(self, target: i64, acceleration: NonZero<u32>, down: bool) -> [Self; 2] {
        let a = acceleration.get().cast_signed();
        let change = if down { self.h - target } else { target - self.h };
        let ticks = whole_ticks(change.max(0).cast_unsigned(), acceleration);
        let ramp = Self { ticks, a: if down { -a } else { a }, ..self };
        // The target was reached a part of a tick before: the cruise is the tangent of the ramp there.
        let beyond = i128::from(vertex((ramp.speed(ticks) - target).unsigned_abs(), acceleration));
        let there = ramp.phase(ticks);
        let phase = if down { there + beyond } else { there - beyond };
        [ramp, Self { ticks: u64::MAX, a: 0, h: target, ..self }.at_phase(phase)]
    }
}

/// The whole ticks after which the speed has changed by `change`, or by a part of a tick's more.
fn whole_ticks(change: u64, a: NonZero<u32>) -> u64 {
    change.div_ceil(NonZero::<u64>::from(a).get())
}

/// Distance from the speed `h` down to `last`, which is not more than a tick's change below.
fn way_to(h: u64, last: u64, a: NonZero<u32>) -> u64 {
    if last == 0 {
        return vertex(h, a);
    }
    divided(u128::from(h - last) * u128::from(h + last), a.into()) as u64
}

/// Distance to standstill at the speed `h`, which is not more than a tick's change.
pub(super) fn vertex(h: u64, a: NonZero<u32>) -> u64 {
    h * h / NonZero::<u64>::from(a)
}

/// Whole steps in `phase`, which is not negative but for what was rounded.
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
