//! Where an axis is, and how fast, at any instant.
//!
//! A plan is a short list of segments of constant acceleration. All numbers are integers in units
//! chosen so that nothing is ever rounded on the way: with *f* ticks in a second, speed *v* (steps/s)
//! is `h = f·v`, acceleration *a* (steps/s²) is itself, and a step is [`STEP`] `= 2·f²` units of
//! phase. *d* ticks into a segment that began with `h`
//!
//! ```text
//! phase grew by  d·(2h + a·d)          speed is  h + a·d
//! ```
//!
//! Step *n* is made at the tick nearest to the instant when the phase reaches `n·STEP`. In half a tick
//! the phase grows by the speed, so that is the first tick with `n·STEP < phase + speed`, or with
//! `n·STEP = phase`: a step exactly on the vertex of a stop ramp, where the speed is 0, counts as
//! made. The factory move of an MD3, 5000²/(2·10000) = 1250 steps of ramp, ends on one.
//!
//! The exact motion changes its acceleration between two ticks. A segment begins at the first whole
//! tick after that, with the phase and the speed which the exact motion has there; so nothing is lost
//! at a seam. Only the end of a profile move is rounded, to the nearest tick, and its stop ramp is
//! anchored there: it is the acceleration run backwards from the last step, so it lands on it
//! whatever was rounded before.
//!
//! # Limits
//!
//! Speeds in 1/256 step/s up to [`MAX_SPEED`], accelerations in whole steps/s² up to 2³¹ − 1, any
//! number of steps that 32 bits hold; what is beyond acts as the limit. A plan that takes longer than
//! 64 bits of ticks, 36,000 years, ends with them.

use core::num::NonZero;

use fixed::types::{I24F8, I48F16, U24F8};
use standin_protocol::time::{Duration, Instant, TICKS_PER_SECOND};

use super::search::least;

/// Units of phase in a step: 2·f².
pub(crate) const STEP: i64 = 2 * (TICKS_PER_SECOND * TICKS_PER_SECOND).cast_signed();

/// The greatest speed of a plan, in steps/s: a tick for a pulse and one for the gap after it.
pub const MAX_SPEED: u32 = (TICKS_PER_SECOND / 2) as u32;

/// The greatest acceleration of a plan, in steps/s².
pub const MAX_ACCELERATION: u32 = i32::MAX as u32;

/// How fast a profile move may be. What is above a limit acts as the limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Rates {
    /// Steps per second at its beginning and at its end; above `speed` it acts as that.
    pub start: U24F8,
    /// Steps per second, up to [`MAX_SPEED`].
    pub speed: U24F8,
    /// Steps per second² while it speeds up, up to [`MAX_ACCELERATION`].
    pub up: u32,
    /// Steps per second² while it slows down, up to [`MAX_ACCELERATION`].
    pub down: u32,
}

impl Rates {
    /// From standstill and to standstill, with one acceleration.
    #[must_use]
    pub const fn even(speed: U24F8, acceleration: u32) -> Self {
        Self { start: U24F8::ZERO, speed, up: acceleration, down: acceleration }
    }
}

/// A stretch of constant acceleration, in one direction.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Segment {
    /// How long, in ticks; `u64::MAX` without end.
    pub ticks: u64,
    /// Acceleration in steps/s²; negative slows down.
    pub a: i32,
    /// Speed at its first tick, in steps/s times ticks/s; never negative.
    pub h: i64,
    /// Position at its first tick, without `rest`.
    pub from: i32,
    /// Phase beyond `from` at its first tick, `0..2·f²`.
    pub rest: i64,
    /// Whether steps count down.
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
    pub(super) fn position(&self, d: u64) -> i32 {
        self.step(self.made(d))
    }

    /// The position `steps` beyond `from`; positions wrap at 32 bits.
    pub(super) fn step(&self, steps: u64) -> i32 {
        let steps = (steps as u32).cast_signed();
        if self.back { self.from.wrapping_sub(steps) } else { self.from.wrapping_add(steps) }
    }

    /// This segment, begun at another phase beyond its `from`.
    #[inline(never)]
    fn at_phase(self, phase: i128) -> Self {
        let steps = steps_in(phase);
        // Less than a step, so 64 bits of both are enough.
        let rest = (phase as i64).wrapping_sub(STEP.wrapping_mul(steps.cast_signed()));
        Self { from: self.step(steps), rest, ..self }
    }

    /// What is left of this segment `d` ticks in.
    fn since(self, d: u64) -> Self {
        let ticks = if self.ticks == u64::MAX { u64::MAX } else { self.ticks.saturating_sub(d) };
        Self { ticks, h: self.speed(d), ..self }.at_phase(self.phase(d))
    }

    /// The last `ticks` of a way of which this is the beginning: the acceleration `down` run backwards from
    /// its end, where it is as fast as here.
    #[inline(never)]
    fn ending(self, way: i128, ticks: u64, down: NonZero<u32>) -> Self {
        let backwards = Self { a: down.get().cast_signed(), ..self };
        let stop = Self { ticks, a: -backwards.a, h: backwards.speed(ticks), ..self };
        stop.at_phase(way - backwards.phase(ticks))
    }

    /// A ramp down to the speed `last`, from which it stands at once, and where it stands then. What is not faster
    /// stands where it is.
    #[inline(never)]
    fn stop(self, last: i64, down: NonZero<u32>) -> (Self, i32) {
        let ticks = whole_ticks((self.h - last).max(0).cast_unsigned(), down);
        let stop = Self { ticks, a: -down.get().cast_signed(), ..self };
        // It stands a part of a tick before the last whole one, and there the phase is forgotten.
        let Some(before) = ticks.checked_sub(1) else { return (stop, self.position(0)) };
        let h = stop.speed(before).cast_unsigned();
        let left = way_to(h, last.cast_unsigned(), down).max(h.saturating_sub(1));
        (stop, stop.step(steps_in(stop.phase(before) + i128::from(left))))
    }

    /// The first tick after the one `since` ticks in at which it has come to `position`; once around all positions if
    /// it is there.
    fn reaches(&self, since: u64, position: i32) -> Option<u64> {
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
    fn reach(self, target: i64, acceleration: NonZero<u32>, down: bool) -> [Self; 2] {
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

/// What an axis does from an instant on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Plan {
    start: Instant,
    segments: [Segment; 3],
    /// Segments in use, at least one.
    count: u8,
}

impl Plan {
    /// Standing at `position`.
    #[must_use]
    #[inline(never)]
    pub fn rest(at: Instant, position: i32) -> Self {
        Self::of(at, &[Segment { from: position, ..Segment::default() }])
    }

    #[inline(never)]
    fn of(start: Instant, list: &[Segment]) -> Self {
        let mut segments = [Segment::default(); 3];
        for (place, segment) in segments.iter_mut().zip(list) {
            *place = *segment;
        }
        Self { start, segments, count: (list.len() & 3) as u8 }
    }

    /// From standstill at `from`, exactly `steps` steps: ramp up, cruise, ramp down; without a cruise
    /// where the way is too short for the speed. It ends at the tick nearest to the exact end, which
    /// is that of its last step. No speed or no acceleration is no motion.
    #[must_use]
    pub fn profile(at: Instant, from: i32, steps: i32, rates: Rates) -> Self {
        let speed = top(rates.speed);
        let twice_speed = NonZero::new(2 * speed).filter(|_| steps != 0);
        let (Some(up), Some(down), Some(twice_speed)) = (limited(rates.up), limited(rates.down), twice_speed)
        else {
            return Self::rest(at, from);
        };
        let start = top(rates.start).min(speed);
        let way = u128::from(steps.unsigned_abs()) * STEP as u128;
        let (a, b) = (NonZero::<u64>::from(up), NonZero::<u64>::from(down));
        // 1/a + 1/b = sum/product
        let (sum, product) = (a.saturating_add(b.get()), a.saturating_mul(b));
        let long = |number: NonZero<u64>| u128::from(number.get());
        let change = u128::from(speed - start);

        let first = Segment { from, back: steps < 0, h: start.cast_signed(), ..Segment::default() };
        let ending = |ticks| first.ending(way.cast_signed(), ticks, down);

        // Both ramps take (speed² − start²)·(1/a + 1/b) of the way.
        let ramps = change * u128::from(speed + start) * long(sum);
        if divided(ramps + long(product) - 1, product) > way {
            // As if one ramp did it all, with a·b/(a + b): way = t·(2·start + t·a·b/(a + b)).
            let (start, way) = (4 * u128::from(start) * long(sum), 4 * way * long(sum));
            let half_ticks = least(|t| u128::from(t) * (start + u128::from(t) * long(product)) > way) - 1;
            let end = half_ticks.div_ceil(2);
            let stop = divided(u128::from(end) * long(a), sum) as u64;
            let up = Segment { ticks: end - stop, a: up.get().cast_signed(), ..first };
            return Self::of(at, &[up, ending(stop)]);
        }
        // way/2·speed, and what the ramps lose: (speed − start)²·(1/a + 1/b)/2·speed.
        let whole = divided(way, twice_speed);
        let part = way - whole * long(twice_speed);
        let lost = part * long(product) + change * change * long(sum);
        let half = long(twice_speed) * long(product) / 2;
        let end = (whole + divided(divided(lost + half, product), twice_speed)) as u64;
        let stop = ((speed - start) / b).min(end);
        let [up, cruise] = first.reach(speed.cast_signed(), up, false);
        let up = Segment { ticks: up.ticks.min(end - stop), ..up };
        let cruise = Segment { ticks: end - stop - up.ticks, ..cruise };
        Self::of(at, &[up, cruise, ending(stop)])
    }

    /// From what this plan does at `at`, a ramp to the signed `speed` in steps/s, and on at that speed
    /// without end; to 0 it ends there. Against the present direction by way of standstill. No
    /// acceleration is a halt. Limits are those of [`Rates`].
    #[must_use]
    pub fn towards(&self, at: Instant, speed: I24F8, acceleration: u32) -> Self {
        let (now, d) = self.segment_at(at);
        let position = now.position(d);
        let now = now.since(d);
        let Some(a) = limited(acceleration).filter(|_| now.h != 0 || speed != 0) else {
            return Self::rest(at, position);
        };
        let target = top(speed.unsigned_abs()).cast_signed();
        let back = speed < 0;
        if now.h != 0 && speed != 0 && back == now.back {
            return Self::of(at, &now.reach(target, a, target < now.h));
        }
        let (stop, turn) = now.stop(0, a);
        let turned = Segment { from: turn, back, ..Segment::default() };
        if speed == 0 {
            return Self::of(at, &[stop, turned]);
        }
        let h = -stop.speed(stop.ticks);
        let rest = vertex(h.cast_unsigned(), a).cast_signed();
        let [up, cruise] = Segment { h, rest, ..turned }.reach(target, a, false);
        Self::of(at, &[stop, up, cruise])
    }

    /// As [`towards`](Self::towards), of an axis that starts and stops at the speed `rates.start`, or at `speed` if that
    /// is less: from standstill it begins with it, and a ramp to standstill ends with it. `rates.speed` does not matter.
    #[must_use]
    pub fn slew(&self, at: Instant, speed: I24F8, rates: Rates) -> Self {
        let (now, d) = self.segment_at(at);
        let position = now.position(d);
        let now = now.since(d);
        let (Some(up), Some(down)) = (limited(rates.up), limited(rates.down)) else {
            return Self::rest(at, position);
        };
        let (start, target) = (top(rates.start).cast_signed(), top(speed.unsigned_abs()).cast_signed());
        let back = speed < 0;
        let begin = |from| Segment { from, back, h: start.min(target), ..Segment::default() };
        match (now.h, target) {
            (0, 0) => Self::rest(at, position),
            (0, _) => Self::of(at, &begin(position).reach(target, up, false)),
            (h, 1..) if back == now.back => {
                let slower = target < h;
                Self::of(at, &now.reach(target, if slower { down } else { up }, slower))
            }
            _ => {
                let (stop, turn) = now.stop(start, down);
                if target == 0 {
                    return Self::of(at, &[stop, begin(turn)]);
                }
                let [ramp, cruise] = begin(turn).reach(target, up, false);
                Self::of(at, &[stop, ramp, cruise])
            }
        }
    }

    /// Standing where this plan is at `at`.
    #[must_use]
    pub fn halt(&self, at: Instant) -> Self {
        Self::rest(at, self.position_at(at))
    }

    /// The rest of this plan: what it does from `at` on, beginning at `position`. A motor that went
    /// without current while its plan ran on takes it up again so.
    #[must_use]
    pub fn resumed(&self, at: Instant, position: i32) -> Self {
        let at = at.max(self.start);
        let mut rest = Self::rest(at, position);
        if at >= self.end() {
            return rest;
        }
        let lost = position.wrapping_sub(self.position_at(at));
        let mut ticks = at.since(self.start).ticks();
        let mut left = self.segments();
        while let [first, others @ ..] = left
            && first.ticks <= ticks
        {
            ticks -= first.ticks;
            left = others;
        }
        rest.count = 0;
        for (place, segment) in rest.segments.iter_mut().zip(left) {
            let from = segment.from.wrapping_add(lost);
            *place = Segment { from, ..*segment }.since(ticks);
            ticks = 0;
            rest.count += 1;
        }
        rest
    }

    /// The same, later by `late`.
    #[must_use]
    pub fn delayed(&self, late: Duration) -> Self {
        Self { start: self.start + late, ..*self }
    }

    /// When it began.
    #[must_use]
    pub fn start(&self) -> Instant {
        self.start
    }

    /// When it stands again; [`Instant::NEVER`] if it goes on without end.
    #[must_use]
    #[inline(never)]
    pub fn end(&self) -> Instant {
        self.segments().iter().fold(self.start, |at, segment| at + Duration::from_ticks(segment.ticks))
    }

    /// Its segments, in order; one may be empty.
    #[must_use]
    pub fn segments(&self) -> &[Segment] {
        self.segments.get(..usize::from(self.count)).unwrap_or(&self.segments)
    }

    /// Steps made at or before `at`, from the beginning of time.
    #[must_use]
    pub fn position_at(&self, at: Instant) -> i32 {
        let (segment, d) = self.segment_at(at);
        segment.position(d)
    }

    /// The instant of the first step later than `after` that brings it to `position`; [`Instant::NEVER`] if none does.
    #[must_use]
    pub fn when(&self, after: Instant, position: i32) -> Instant {
        let (mut here, mut begin) = (self.position_at(after), self.start);
        for segment in self.segments().iter().filter(|segment| segment.ticks > 0) {
            let end = begin + Duration::from_ticks(segment.ticks);
            if after < end {
                if after < begin {
                    // A step may be due at the seam.
                    let there = segment.position(0);
                    if here != there && there == position {
                        return begin;
                    }
                }
                if let Some(ticks) = segment.reaches(after.since(begin).ticks(), position) {
                    return begin + Duration::from_ticks(ticks);
                }
                here = segment.position(segment.ticks - 1);
            }
            begin = end;
        }
        let stands = after < begin && here != position && self.position_at(begin) == position;
        if stands { begin } else { Instant::NEVER }
    }

    /// Signed speed at `at`, in steps/s.
    #[must_use]
    pub fn speed_at(&self, at: Instant) -> I48F16 {
        /// 2¹⁶ / f in lowest terms.
        const BITS: i64 = 64;
        const FREQUENCY: i64 = 15_625;
        let (segment, d) = self.segment_at(at);
        let bits = segment.speed(d) * BITS / FREQUENCY;
        I48F16::from_bits(if segment.back { -bits } else { bits })
    }

    /// The segment that rules at `at`, and how many ticks it has run by then. After the last one it
    /// stands.
    pub(crate) fn segment_at(&self, at: Instant) -> (Segment, u64) {
        let mut ticks = at.since(self.start).ticks();
        let mut last = Segment::default();
        for segment in self.segments() {
            if ticks < segment.ticks {
                return (*segment, ticks);
            }
            ticks -= segment.ticks;
            last = *segment;
        }
        (Segment { from: last.position(last.ticks), back: last.back, ..Segment::default() }, 0)
    }
}

/// `speed` in steps/s in the unit of [`Segment::h`].
fn top(speed: U24F8) -> u64 {
    /// f / 2⁸: a whole number, so that a speed in 1/256 step/s is, too.
    const UNIT: u64 = TICKS_PER_SECOND / 256;
    u64::from(speed.to_bits().min(MAX_SPEED << 8)) * UNIT
}

/// An acceleration as it acts.
fn limited(acceleration: u32) -> Option<NonZero<u32>> {
    NonZero::new(acceleration.min(MAX_ACCELERATION))
}

/// The whole ticks after which the speed has changed by `change`, or by a part of a tick's more.
fn whole_ticks(change: u64, a: NonZero<u32>) -> u64 {
    change.div_ceil(NonZero::<u64>::from(a).get())
}

/// How far it is from the speed `h` down to `last`, which is not more than a tick's change below.
fn way_to(h: u64, last: u64, a: NonZero<u32>) -> u64 {
    if last == 0 {
        return vertex(h, a);
    }
    divided(u128::from(h - last) * u128::from(h + last), a.into()) as u64
}

/// How far standstill is at the speed `h`, which is not more than a tick's change.
fn vertex(h: u64, a: NonZero<u32>) -> u64 {
    h * h / NonZero::<u64>::from(a)
}

/// Whole steps in `phase`, which is not negative but for what was rounded.
#[inline(never)]
fn steps_in(phase: i128) -> u64 {
    /// What is left of [`STEP`] without its factors of 2: 5¹².
    const ODD: u64 = (STEP >> STEP.trailing_zeros()).cast_unsigned();
    // Two digits of 32 bits: a division of 128 is as long as all of a plan.
    let phase = phase.max(0).cast_unsigned() >> STEP.trailing_zeros();
    let (high, low) = ((phase >> 32) as u64, phase as u32);
    let rest = (high % ODD) << 32 | u64::from(low);
    ((high / ODD) << 32) | (rest / ODD)
}

/// The one long division. That of the language is faster where the quotient is long, and takes a kilobyte.
#[inline(never)]
fn divided(number: u128, by: NonZero<u64>) -> u128 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Walker;
    use proptest::prelude::*;
    use standin_protocol::time::Span;
    use std::vec::Vec;

    const FACTORY: Rates = Rates::even(U24F8::const_from_int(5_000), 10_000);

    fn at(ticks: u64) -> Instant {
        Instant::from_ticks(ticks)
    }

    #[test]
    fn the_factory_move_of_an_md3_takes_two_and_a_half_seconds() {
        let plan = Plan::profile(at(0), 0, 10_000, FACTORY);
        assert_eq!(plan.end(), Instant::from(2_500.millis()));
        assert_eq!(plan.position_at(Instant::from(500.millis())), 1_250);
        assert_eq!(plan.position_at(Instant::from(2_000.millis())), 8_750);
        assert_eq!(plan.position_at(at(2_500 * 16_000 - 1)), 9_999);
        assert_eq!(plan.position_at(Instant::from(2_500.millis())), 10_000);
        assert_eq!(plan.position_at(Instant::NEVER), 10_000);
        assert_eq!(plan.speed_at(Instant::from(250.millis())), I48F16::from_num(2_500));
        assert_eq!(plan.speed_at(Instant::from(1_000.millis())), I48F16::from_num(5_000));
        assert_eq!(plan.speed_at(Instant::from(3_000.millis())), 0);
    }

    #[test]
    fn a_short_move_is_a_triangle() {
        let plan = Plan::profile(at(0), 7, -101, FACTORY);
        assert_eq!(plan.segments().len(), 2);
        assert_eq!(plan.position_at(plan.end()), 7 - 101);
        // 2·sqrt(101 / 10,000) s
        assert_eq!(plan.end().ticks(), 3_215_960);
    }

    #[test]
    fn nothing_to_do_is_done_at_once() {
        for plan in [
            Plan::profile(at(5), 3, 0, FACTORY),
            Plan::profile(at(5), 3, 9, Rates { speed: U24F8::ZERO, ..FACTORY }),
            Plan::profile(at(5), 3, 9, Rates { up: 0, ..FACTORY }),
        ] {
            assert_eq!((plan.end(), plan.position_at(at(9))), (at(5), 3));
        }
    }

    #[test]
    fn a_plan_that_is_over_has_no_rest() {
        let plan = Plan::profile(at(0), 0, 100, FACTORY);
        for rest in [plan.resumed(plan.end(), 7), plan.resumed(Instant::NEVER, 7)] {
            assert_eq!((rest.position_at(Instant::NEVER), rest.end()), (7, rest.start()));
        }
    }

    #[test]
    fn a_speed_beyond_the_limit_acts_as_the_limit() {
        let limit = Rates { speed: U24F8::from_num(MAX_SPEED), ..FACTORY };
        let beyond = Rates { speed: U24F8::MAX, ..FACTORY };
        let plan = Plan::profile(at(0), 0, i32::MAX, beyond);
        assert_eq!(plan, Plan::profile(at(0), 0, i32::MAX, limit));
        let jog = plan.towards(at(0), I24F8::MAX, u32::MAX);
        assert_eq!(jog, plan.towards(at(0), I24F8::from_num(MAX_SPEED), MAX_ACCELERATION));
    }

    #[test]
    fn a_jog_goes_on_until_it_is_told_to_stop() {
        let jog = Plan::rest(at(0), 0).towards(at(0), I24F8::from_num(5_000), 10_000);
        assert_eq!(jog.end(), Instant::NEVER);
        assert_eq!(jog.position_at(Instant::from(1_500.millis())), 1_250 + 5_000);
        let stop = jog.towards(Instant::from(1_500.millis()), I24F8::ZERO, 10_000);
        assert_eq!(stop.end(), Instant::from(2_000.millis()));
        assert_eq!(stop.position_at(Instant::NEVER), 1_250 + 5_000 + 1_250);
    }

    const SLEW: Rates =
        Rates { start: U24F8::const_from_int(1_000), speed: U24F8::ZERO, up: 10_000, down: 5_000 };

    #[test]
    fn a_slew_begins_and_ends_at_its_start_speed() {
        let slew = Plan::rest(at(0), 0).slew(at(0), I24F8::from_num(5_000), SLEW);
        assert_eq!(slew.speed_at(at(0)), 1_000);
        // 400 ms at 3,000 steps/s on average, then 100 ms at 5,000.
        assert_eq!(slew.position_at(Instant::from(400.millis())), 1_200);
        assert_eq!(slew.position_at(Instant::from(500.millis())), 1_700);
        let stop = slew.slew(Instant::from(500.millis()), I24F8::ZERO, SLEW);
        // 800 ms at 3,000 steps/s on average.
        assert_eq!(stop.end(), Instant::from(1_300.millis()));
        assert_eq!(stop.speed_at(stop.end() - Duration::TICK).round(), 1_000);
        assert_eq!((stop.speed_at(stop.end()), stop.position_at(stop.end())), (I48F16::ZERO, 4_100));
    }

    #[test]
    fn a_slew_below_the_start_speed_has_no_ramp() {
        let slow = Plan::rest(at(0), 7).slew(at(0), I24F8::from_num(-500), SLEW);
        assert_eq!(slow.speed_at(at(0)), -500);
        assert_eq!(slow.position_at(Instant::from(2.secs())), 7 - 1_000);
        let stop = slow.slew(Instant::from(2.secs()), I24F8::ZERO, SLEW);
        assert_eq!((stop.end(), stop.position_at(Instant::NEVER)), (Instant::from(2.secs()), 7 - 1_000));
    }

    #[test]
    fn a_slew_turns_round_at_its_start_speed() {
        let slew = Plan::rest(at(0), 0).slew(at(0), I24F8::from_num(5_000), SLEW);
        let back = slew.slew(Instant::from(500.millis()), I24F8::from_num(-3_000), SLEW);
        let turn = Instant::from(1_300.millis());
        assert_eq!((back.position_at(turn), back.speed_at(turn)), (4_100, I48F16::from_num(-1_000)));
        // 200 ms at 2,000 steps/s on average, then at 3,000.
        assert_eq!(back.position_at(Instant::from(1_500.millis())), 3_700);
        assert_eq!(back.position_at(Instant::from(2_500.millis())), 700);
        let slower = back.slew(Instant::from(2_500.millis()), I24F8::from_num(-2_000), SLEW);
        // 200 ms at 2,500 steps/s on average.
        assert_eq!(slower.position_at(Instant::from(2_700.millis())), 200);
        assert_eq!(slower.speed_at(Instant::from(2_700.millis())), -2_000);
    }

    #[test]
    fn without_a_start_speed_a_slew_stops_as_a_ramp() {
        let jog = Plan::rest(at(0), 0).towards(at(0), I24F8::from_num(4_321), 7_000);
        let rates = Rates { start: U24F8::ZERO, up: 1, down: 9_999, ..SLEW };
        for ticks in (3_000_000..30_000_000).step_by(777_777) {
            assert_eq!(jog.slew(at(ticks), I24F8::ZERO, rates), jog.towards(at(ticks), I24F8::ZERO, 9_999));
        }
    }

    #[test]
    fn the_last_step_of_a_stop_is_one_that_falls_on_its_end() {
        let at_once = Rates { start: U24F8::MAX, ..SLEW };
        let cruise = Plan::rest(at(0), 0).slew(at(0), I24F8::from_num(4_000), at_once);
        // (4000² − 1000²)/(2·7500) = 1000 steps in 400 ms.
        let stop = cruise.slew(Instant::from(250.millis()), I24F8::ZERO, Rates { down: 7_500, ..SLEW });
        assert_eq!(stop.end(), Instant::from(650.millis()));
        assert_eq!(stop.position_at(stop.end() - Duration::TICK), 1_999);
        assert_eq!(stop.position_at(stop.end()), 2_000);
    }

    #[test]
    fn a_position_is_reached_once_around_or_never() {
        let slew =
            Plan::rest(at(0), 0).slew(at(0), I24F8::from_num(8_000_000), Rates { start: U24F8::MAX, ..SLEW });
        // Two ticks a step.
        assert_eq!(slew.when(at(0), 100), at(200));
        assert_eq!(slew.when(at(200), 100), at(200 + (2 << 32)));
        assert_eq!(slew.when(at(200), 99), at(200 + (2 << 32) - 2));
        assert_eq!(slew.when(at(0), -1), at((2 << 32) - 2));
        let stop = slew.halt(at(200));
        assert_eq!((stop.when(at(200), 100), stop.when(at(0), 101)), (Instant::NEVER, Instant::NEVER));
        let profile = Plan::profile(at(5), 0, 10, FACTORY);
        assert_eq!(profile.when(at(0), 10), profile.end());
        assert_eq!(profile.when(profile.end(), 10), Instant::NEVER);
        assert_eq!(profile.when(at(0), 11), Instant::NEVER);
    }

    #[test]
    fn a_reversal_goes_by_way_of_standstill() {
        let jog = Plan::rest(at(0), 0).towards(at(0), I24F8::from_num(5_000), 10_000);
        let back = jog.towards(Instant::from(1_000.millis()), I24F8::from_num(-5_000), 10_000);
        // 1250 + 2500 forward, 1250 more to stop, then back: 1250 in the ramp, 5000 a second.
        assert_eq!(back.position_at(Instant::from(1_500.millis())), 5_000);
        assert_eq!(back.speed_at(Instant::from(1_500.millis())), 0);
        assert_eq!(back.position_at(Instant::from(2_000.millis())), 3_750);
        assert_eq!(back.position_at(Instant::from(3_000.millis())), -1_250);
        assert_eq!(back.speed_at(Instant::from(3_000.millis())), -5_000);
    }

    /// The tick nearest to sqrt(n·S/a), found without the plan's arithmetic.
    fn nearest_root(n: u128, a: u128) -> u64 {
        let square = 2 * 16_000_000_u128.pow(2) * n;
        let (mut low, mut high) = (0_u128, 1_u128 << 50);
        while low < high {
            let middle = (low + high) / 2;
            // middle + 1/2 >= root  <=>  (2·middle + 1)² · a >= 4 · square
            if (2 * middle + 1).pow(2) * a >= 4 * square { high = middle } else { low = middle + 1 }
        }
        low as u64
    }

    proptest! {
        #[test]
        fn every_step_of_a_ramp_is_at_the_nearest_tick(a in 16_u32..2_000_000, n in 1_u32..5_000) {
            let plan = Plan::rest(at(0), 0).towards(at(0), I24F8::MAX, a);
            let due = nearest_root(u128::from(n), u128::from(a));
            prop_assert_eq!(plan.position_at(at(due)), n.cast_signed());
            prop_assert_eq!(plan.position_at(at(due - 1)), n.cast_signed() - 1);
        }

        #[test]
        fn a_profile_makes_its_steps_and_no_others(
            steps in any::<i32>(), start in 0_u32..2_000_000, speed in 1_u32..5_000_000,
            up in 1_u32.., down in 1_u32..,
            samples in proptest::collection::vec(any::<u64>(), 2..40),
        ) {
            let start = U24F8::from_num(start.saturating_sub(1_000_000));
            let rates = Rates { start, speed: U24F8::from_num(speed), up, down };
            let plan = Plan::profile(at(0), 0, steps, rates);
            let mirror = Plan::profile(at(0), 0, steps, Rates { up: down, down: up, ..rates });
            let end = plan.end().ticks();
            prop_assert_eq!(plan.position_at(plan.end()), steps);
            let mut instants: Vec<u64> = samples.iter().map(|n| n % (end + 1)).collect();
            // The seams between segments, where rounding could show.
            let mut seam = 0;
            for segment in plan.segments() {
                seam += segment.ticks;
                instants.extend([seam.saturating_sub(1), seam, seam + 1]);
            }
            instants.sort_unstable();
            let positions: Vec<i64> =
                instants.iter().map(|&t| i64::from(plan.position_at(at(t))) * i64::from(steps.signum())).collect();
            prop_assert!(positions.is_sorted(), "{:?} at {:?}", positions, instants);
            // Its mirror: as many steps before the end as after the beginning, to half a tick each.
            prop_assert_eq!(mirror.end(), plan.end());
            for t in instants {
                let passed = i64::from(plan.position_at(at(t)).unsigned_abs());
                let left = i64::from(steps.unsigned_abs())
                    - i64::from(mirror.position_at(at(end.saturating_sub(t))).unsigned_abs());
                let tolerance = 1 + i64::from(speed) / 8_000_000;
                prop_assert!((passed - left).abs() <= tolerance, "{} {}", passed, left);
            }
        }

        #[test]
        fn a_new_plan_goes_on_where_the_old_one_is(
            turns in proptest::collection::vec((0_u64..40_000_000, -40_000_i32..40_000), 1..8),
            acceleration in 1_u32..,
        ) {
            let mut plan = Plan::rest(at(0), 0);
            let mut now = 0;
            for (wait, speed) in turns {
                now += wait;
                let next = plan.towards(at(now), I24F8::from_num(speed), acceleration);
                prop_assert_eq!(next.position_at(at(now)), plan.position_at(at(now)));
                prop_assert_eq!(next.speed_at(at(now)), plan.speed_at(at(now)));
                // At 40,000 steps/s two ticks never hold two steps.
                let mut seam = now;
                for segment in next.segments() {
                    seam = seam.saturating_add(segment.ticks);
                    let jump = next.position_at(at(seam)) - next.position_at(at(seam - 1));
                    prop_assert!(jump.abs() <= 1);
                }
                plan = next;
            }
        }

        #[test]
        fn a_slew_goes_on_where_it_is_and_never_creeps(
            turns in proptest::collection::vec((0_u64..40_000_000, -40_000_i32..40_000), 1..8),
            start in 1_u32..30_000, up in 1_u32.., down in 1_u32..,
        ) {
            let rates = Rates { start: U24F8::from_num(start), up, down, ..SLEW };
            let mut plan = Plan::rest(at(0), 0);
            let mut now = 0;
            for (wait, speed) in turns {
                now += wait;
                let next = plan.slew(at(now), I24F8::from_num(speed), rates);
                prop_assert_eq!(next.position_at(at(now)), plan.position_at(at(now)));
                let least = I48F16::from_num(speed.unsigned_abs().min(start));
                let mut seam = now;
                for segment in next.segments().iter().filter(|segment| segment.ticks > 0) {
                    // Within a ramp no speed is below the start speed but where it was before.
                    let slowest = next.speed_at(at(seam)).abs().min(next.speed_at(at(seam + segment.ticks.min(1 << 40) - 1)).abs());
                    prop_assert!(slowest + I48F16::DELTA >= least.min(plan.speed_at(at(now)).abs()) || speed == 0);
                    seam = seam.saturating_add(segment.ticks);
                    let jump = next.position_at(at(seam)) - next.position_at(at(seam - 1));
                    prop_assert!(jump.abs() <= 1);
                }
                plan = next;
            }
        }

        #[test]
        fn a_position_is_reached_with_the_walkers_step(
            steps in -3_000..3_000_i32, speed in 1_u32..1_000_000_000, start in 0_u32..1_000_000,
            up in 0_u32..31, down in 0_u32..31, passed in any::<u64>(),
            slew in proptest::option::of(any::<i32>()),
        ) {
            let (start, speed) = (U24F8::from_bits(start), U24F8::from_bits(speed));
            let rates = Rates { start, speed, up: 1 << up, down: 1 << down };
            let mut plan = Plan::profile(at(100), 3, steps, rates);
            let length = (plan.end().ticks() - 100).min(1 << 41);
            if let Some(speed) = slew {
                plan = plan.slew(at(100 + passed % (length + 1)), I24F8::from_bits(speed >> (passed % 20)), rates);
            }
            let after = plan.start() + Duration::from_ticks((passed / 3) % (length + 1));
            let mut position = plan.position_at(after);
            let mut seen = std::collections::BTreeSet::new();
            for step in Walker::new(&plan, after).take(500) {
                position += if step.forward { 1 } else { -1 };
                if seen.insert(position) {
                    prop_assert_eq!(plan.when(after, position), step.at, "{}", position);
                }
            }
        }

        #[test]
        fn the_rest_of_a_plan_is_the_plan_elsewhere(
            steps in -1_000..1_000_i32, bits in proptest::array::uniform4(0_u32..31), fine in any::<u32>(),
            order in proptest::option::of((any::<u64>(), any::<i32>())),
            seam in 0..4_usize, beside in -2..3_i64, inside in any::<u64>(), position in any::<i32>(),
        ) {
            let [start, speed, up, down] = bits.map(|bits| (1 << bits) | (fine & ((1 << bits) - 1)));
            let rates = Rates { start: U24F8::from_bits(start), speed: U24F8::from_bits(speed), up, down };
            let mut plan = Plan::profile(at(100), 3, steps, rates);
            if let Some((when, speed)) = order {
                let when = at(100 + when % (plan.end().ticks() - 99));
                plan = plan.towards(when, I24F8::from_bits(speed), up);
            }
            // Half of the time close to a seam.
            let seam = plan.segments().iter().take(seam).map(|segment| segment.ticks.min(1 << 40)).sum::<u64>();
            let length = (plan.end().ticks() - plan.start().ticks()).min(1 << 41);
            let passed = if inside % 2 == 0 { seam } else { (inside / 2) % (length + 2) };
            let now = at(plan.start().ticks() + passed.saturating_add_signed(beside));

            let rest = plan.resumed(now, position);
            let lost = position.wrapping_sub(plan.position_at(now));
            prop_assert_eq!(rest.start(), now);
            prop_assert_eq!(rest.end(), plan.end().max(now));
            let seams = plan.segments().iter().scan(plan.start(), |at, segment| {
                *at += Duration::from_ticks(segment.ticks);
                Some(*at)
            });
            let steps = Walker::new(&plan, now).take(50).map(|step| step.at);
            let near = |instant: Instant| [instant - Duration::TICK, instant, instant + Duration::TICK];
            for t in seams.chain(steps).chain([now]).flat_map(near).filter(|t| *t >= now) {
                prop_assert_eq!(rest.position_at(t), plan.position_at(t).wrapping_add(lost), "at {:?}", t);
                prop_assert_eq!(rest.speed_at(t), plan.speed_at(t), "at {:?}", t);
            }
            prop_assert!(Walker::new(&rest, now).take(50).eq(Walker::new(&plan, now).take(50)));
        }
    }
}
