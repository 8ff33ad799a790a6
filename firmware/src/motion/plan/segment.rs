//! A segment of a plan.

use core::num::NonZero;

use drivetwin_protocol::time::TICKS_PER_SECOND;

use super::super::search::first_true;
use super::STEP;

/// A part of a plan with constant acceleration, in one direction.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Segment {
    /// Length in ticks; `u64::MAX` for a segment without end.
    pub ticks: u64,
    /// Acceleration in steps/s²; negative slows down.
    pub acceleration: i32,
    /// Speed at the first tick, in steps/s times ticks/s; never negative.
    pub start_speed: i64,
    /// Position at the first tick, without `phase_offset`.
    pub base: i32,
    /// Phase beyond `base` at the first tick, `0..2·f²`.
    pub phase_offset: i64,
    /// True if steps count down.
    pub reverse: bool,
}

impl Segment {
    /// Returns true if a plan may have the segment: at its begin and its end its speed is at most twice the greatest one of
    /// a plan, and its phase is that of one step. Rounded to a tick, the speed at the end may be below 0.
    pub(super) fn is_possible(&self) -> bool {
        const MOST: i128 = 2 * TICKS_PER_SECOND as i128 * super::MAX_SPEED as i128;
        let begin = i128::from(self.start_speed);
        let end = begin + i128::from(self.acceleration) * i128::from(self.ticks);
        [begin, end].iter().all(|speed| (-MOST..=MOST).contains(speed))
            && (0..STEP).contains(&self.phase_offset)
    }

    /// Speed `d` ticks after the start, in the unit of `start_speed`.
    pub(crate) fn speed(&self, d: u64) -> i64 {
        self.start_speed + i64::from(self.acceleration) * d.cast_signed()
    }

    /// Phase beyond `base`, `d` ticks after the start.
    #[inline(never)]
    pub(crate) fn phase(&self, d: u64) -> i128 {
        i128::from(self.phase_offset) + i128::from(d) * i128::from(self.start_speed + self.speed(d))
    }

    /// Number of steps made beyond `base`, `d` ticks after the start. A step is made at its nearest tick.
    pub(crate) fn steps_made(&self, d: u64) -> u64 {
        let half_a_tick = (self.speed(d) - 1).max(0);
        steps_in(self.phase(d) + i128::from(half_a_tick))
    }

    /// Position `d` ticks after the start.
    pub(in crate::motion) fn position(&self, d: u64) -> i32 {
        self.step(self.steps_made(d))
    }

    /// The position `steps` beyond `base`; positions wrap at 32 bits.
    pub(in crate::motion) fn step(&self, steps: u64) -> i32 {
        let steps = (steps as u32).cast_signed();
        if self.reverse { self.base.wrapping_sub(steps) } else { self.base.wrapping_add(steps) }
    }

    /// The same segment, but at its start the phase is `phase` beyond `base`.
    #[inline(never)]
    pub(super) fn at_phase(self, phase: i128) -> Self {
        let steps = steps_in(phase);
        // The rest is less than a step, so the low 64 bits of both terms are enough.
        let rest = (phase as i64).wrapping_sub(STEP.wrapping_mul(steps.cast_signed()));
        Self { base: self.step(steps), phase_offset: rest, ..self }
    }

    /// The rest of this segment from `d` ticks after its start on.
    pub(super) fn since(self, d: u64) -> Self {
        let ticks = if self.ticks == u64::MAX { u64::MAX } else { self.ticks.saturating_sub(d) };
        Self { ticks, start_speed: self.speed(d), ..self }.at_phase(self.phase(d))
    }

    /// The stop ramp of `ticks` ticks at the end of a motion over `distance` that starts with this segment.
    /// It is computed backwards from the end with the acceleration `down`. The speed at the end is the speed
    /// at the start of this segment.
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

    /// A ramp down to the speed `last` with an immediate stop at that speed, and the position of the stop. A
    /// segment that is not faster than `last` stops at its start.
    #[inline(never)]
    pub(super) fn stop(self, last: i64, down: NonZero<u32>) -> (Self, i32) {
        let ticks = whole_ticks((self.start_speed - last).max(0).cast_unsigned(), down);
        let stop = Self { ticks, acceleration: -down.get().cast_signed(), ..self };
        // Standstill is reached a part of a tick before the last whole tick, and the phase beyond it is
        // dropped.
        let Some(before) = ticks.checked_sub(1) else { return (stop, self.position(0)) };
        let h = stop.speed(before).cast_unsigned();
        let left = braking_distance(h, last.cast_unsigned(), down).max(h.saturating_sub(1));
        (stop, stop.step(steps_in(stop.phase(before) + i128::from(left))))
    }

    /// Continues at this segment's speed, then ramps down to the speed `last`; without a ramp if the segment
    /// is not faster than `last`. The motion ends on the first whole step that it can reach, at a distance of
    /// at least the phase `min_distance`.
    #[inline(never)]
    pub(super) fn stop_on_step(self, last: i64, down: NonZero<u32>, min_distance: i64) -> [Self; 2] {
        let last = last.min(self.start_speed);
        let speed = self.start_speed.max(1).cast_unsigned();
        let (change, a) = ((self.start_speed - last).cast_unsigned(), NonZero::<u64>::from(down));
        let long = |number: u64| u128::from(number);
        let rest = long(self.phase_offset.cast_unsigned());
        // The ramp takes (speed² − last²)/a of the distance, rounded up here.
        let ramp = long(change) * (long(speed) + long(last.cast_unsigned())) + long(a.get() - 1);
        let reached =
            rest + divided(ramp, a).max(long(min_distance.cast_unsigned())) + long(STEP.cast_unsigned() - 1);
        let distance = long(steps_in(reached.cast_signed())) * long(STEP.cast_unsigned());
        // At `speed` alone the time would be distance/(2·speed); the ramp adds change²/a/(2·speed).
        let lost = distance.saturating_sub(rest) * long(a.get()) + long(change) * long(change);
        let twice = NonZero::<u64>::MIN.saturating_add(2 * speed - 1);
        // Rounded up, so that no step is undone where the ramp begins.
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

    /// The first tick after `since` at which the segment reaches `position`, in ticks from its start; `None`
    /// if it does not. If the axis is at `position` at `since`, the next time is after a pass through all 2³²
    /// positions.
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

    /// A ramp from the start of this segment up to the speed `target`, or down to it, and the cruise at that
    /// speed.
    #[inline(never)]
    pub(super) fn ramp_and_cruise(self, target: i64, acceleration: NonZero<u32>, down: bool) -> [Self; 2] {
        let a = acceleration.get().cast_signed();
        let change = if down { self.start_speed - target } else { target - self.start_speed };
        let ticks = whole_ticks(change.max(0).cast_unsigned(), acceleration);
        let ramp = Self { ticks, acceleration: if down { -a } else { a }, ..self };
        // The target speed was reached a part of a tick before, so the cruise is the tangent of the ramp at
        // that point.
        let beyond = i128::from(vertex((ramp.speed(ticks) - target).unsigned_abs(), acceleration));
        let there = ramp.phase(ticks);
        let phase = if down { there + beyond } else { there - beyond };
        [ramp, Self { ticks: u64::MAX, acceleration: 0, start_speed: target, ..self }.at_phase(phase)]
    }
}

/// Number of ticks, rounded up, after which the speed has changed by at least `change`.
fn whole_ticks(change: u64, a: NonZero<u32>) -> u64 {
    change.div_ceil(NonZero::<u64>::from(a).get())
}

/// Distance of the last, incomplete tick of a ramp down from the speed `h` to `last`. `h - last` is at most `a`,
/// the change of the speed in one tick.
fn braking_distance(h: u64, last: u64, a: NonZero<u32>) -> u64 {
    if last == 0 {
        return vertex(h, a);
    }
    divided(u128::from(h - last) * u128::from(h + last), a.into()) as u64
}

/// Distance to standstill from the speed `h`, which is at most `a`, the change of the speed in one tick.
pub(super) fn vertex(h: u64, a: NonZero<u32>) -> u64 {
    h * h / NonZero::<u64>::from(a)
}

/// Whole steps in `phase`. Only rounding can make `phase` negative.
#[inline(never)]
fn steps_in(phase: i128) -> u64 {
    /// Odd part of [`STEP`], without its factors of 2: 5¹².
    const ODD: u64 = (STEP >> STEP.trailing_zeros()).cast_unsigned();
    // Computed in two digits of 32 bits, because a 128-bit division costs as much as all the rest of a plan.
    let phase = phase.max(0).cast_unsigned() >> STEP.trailing_zeros();
    let (high, low) = ((phase >> 32) as u64, phase as u32);
    let rest = (high % ODD) << 32 | u64::from(low);
    ((high / ODD) << 32) | (rest / ODD)
}

/// The only long division. The language's own is faster for a long quotient, but takes a kilobyte of code.
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
