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
//! Phases begin where the exact motion is at their first whole tick. A stop ramp is anchored at its
//! end: it is the acceleration run backwards from the last step, so it lands there with speed 0
//! whatever was rounded before.

use fixed::types::{I24F8, I48F16, U24F8};
use standin_protocol::time::{Duration, Instant, TICKS_PER_SECOND};

/// Units of phase in a step: 2·f².
const STEP: i128 = 2 * (TICKS_PER_SECOND as i128) * (TICKS_PER_SECOND as i128);

/// The greatest acceleration a plan takes, in steps/s².
const MAX_ACCELERATION: u32 = i32::MAX as u32;

/// How fast a profile move may be.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Rates {
    /// Steps per second at its beginning and at its end; above `speed` it acts as that.
    pub start: U24F8,
    /// Steps per second.
    pub speed: U24F8,
    /// Steps per second² while it speeds up; more than 2³¹ − 1 acts as that.
    pub up: u32,
    /// Steps per second² while it slows down; more than 2³¹ − 1 acts as that.
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
    pub a: i64,
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
    /// Phase beyond `from`, `d` ticks in.
    fn phase(&self, d: u64) -> i128 {
        let (d, a, h) = (i128::from(d), i128::from(self.a), i128::from(self.h));
        i128::from(self.rest) + d * (2 * h + a * d)
    }

    /// Speed `d` ticks in, in the unit of `h`.
    fn speed(&self, d: u64) -> i128 {
        i128::from(self.h) + i128::from(self.a) * i128::from(d)
    }

    /// Position `d` ticks in: every step whose nearest tick is not later.
    fn position(&self, d: u64) -> i32 {
        self.step(self.reach(d).div_euclid(STEP))
    }

    /// The phase up to which steps have been made, `d` ticks in.
    fn reach(&self, d: u64) -> i128 {
        self.phase(d) + (self.speed(d) - 1).max(0)
    }

    /// The position `steps` beyond `from`; positions wrap at 32 bits.
    fn step(&self, steps: i128) -> i32 {
        let steps = (steps & 0xFFFF_FFFF) as u32;
        let steps = steps.cast_signed();
        if self.back { self.from.wrapping_sub(steps) } else { self.from.wrapping_add(steps) }
    }

    /// This segment begun at another phase beyond its `from`.
    fn at_phase(self, phase: i128) -> Self {
        let rest = phase.rem_euclid(STEP);
        Self { from: self.step(phase.div_euclid(STEP)), rest: rest as i64, ..self }
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
    pub fn rest(at: Instant, position: i32) -> Self {
        Self::of(at, [Segment { from: position, ..Segment::default() }])
    }

    fn of<const N: usize>(start: Instant, list: [Segment; N]) -> Self {
        let mut segments = [Segment::default(); 3];
        for (place, segment) in segments.iter_mut().zip(list) {
            *place = segment;
        }
        Self { start, segments, count: (N & 3) as u8 }
    }

    /// From standstill at `from`, exactly `steps` steps: ramp up, cruise, ramp down, with the same
    /// ramps; a triangle where the way is too short for the speed. No speed or no acceleration is no
    /// motion.
    #[must_use]
    pub fn profile(at: Instant, from: i32, steps: i32, rates: Rates) -> Self {
        let acceleration = rates.up.min(MAX_ACCELERATION);
        if steps == 0 || rates.speed == 0 || acceleration == 0 {
            return Self::rest(at, from);
        }
        let (a, h) = (i128::from(acceleration), top(rates.speed));
        let distance = i128::from(steps.unsigned_abs()) * STEP;
        let base = Segment { from, back: steps < 0, ..Segment::default() };
        let up = Segment { a: a as i64, ..base };
        // The last `ticks` of the way, run backwards from its end.
        let down = |ticks: i128| Segment {
            ticks: ticks as u64,
            a: -a as i64,
            h: (a * ticks) as i64,
            ..base.at_phase(distance - a * ticks * ticks)
        };
        if 2 * h * h > distance * a {
            let end = ((8 * distance / a).isqrt() + 1) / 2;
            let half = end / 2;
            return Self::of(at, [Segment { ticks: half as u64, ..up }, down(end - half)]);
        }
        let ramp = h / a;
        // h/a for both ramps' loss of time, distance/2h for the way; rounded to the nearest tick.
        let end = (2 * h * h + distance * a + a * h) / (2 * a * h);
        let cruise = Segment { ticks: (end - 2 * ramp) as u64, h: h as i64, ..base };
        let cruise = cruise.at_phase(2 * h * ramp - h * h / a);
        Self::of(at, [Segment { ticks: ramp as u64, ..up }, cruise, down(ramp)])
    }

    /// From what this plan does at `at`, a ramp to the signed `speed` in steps/s, and on at that speed
    /// without end; to 0 it ends there. Against the present direction by way of standstill. No
    /// acceleration is a halt.
    #[must_use]
    pub fn towards(&self, at: Instant, speed: I24F8, acceleration: u32) -> Self {
        let (now, d) = self.segment_at(at);
        let (a, h) = (i128::from(acceleration.min(MAX_ACCELERATION)), now.speed(d));
        let position = now.position(d);
        if a == 0 || (h == 0 && speed == 0) {
            return Self::rest(at, position);
        }
        let target = top(speed.unsigned_abs());
        let cruise = Segment { ticks: u64::MAX, h: target as i64, ..Segment::default() };
        let ramp = |ticks: i128, a: i128| {
            Segment { ticks: ticks as u64, a: a as i64, h: h as i64, ..now }.at_phase(now.phase(d))
        };
        if speed == 0 || h == 0 || (speed < 0) != now.back {
            // Down to the vertex, a part of a tick before the last whole one; there the phase is
            // forgotten.
            let stop = ramp((h + a - 1) / a, -a);
            let vertex = i128::from(stop.rest) + h * h / a;
            let turn = match stop.ticks.checked_sub(1) {
                Some(last) => stop.step(vertex.max(stop.reach(last)).div_euclid(STEP)),
                None => position,
            };
            let base = Segment { from: turn, back: speed < 0, ..Segment::default() };
            if speed == 0 {
                return Self::of(at, [stop, base]);
            }
            let ticks = target / a;
            let up = Segment { ticks: ticks as u64, a: a as i64, ..base };
            let cruise = Segment { from: turn, back: speed < 0, ..cruise };
            return Self::of(at, [stop, up, cruise.at_phase(2 * target * ticks - target * target / a)]);
        }
        let change = (target - h).abs();
        let signed = if target < h { -a } else { a };
        let ramp = ramp(change / a, signed);
        // The cruise is the tangent of the ramp where it reaches the speed, a part of a tick later.
        let missing = change % a;
        let tangent = ramp.phase(ramp.ticks) - missing * missing / signed;
        let cruise = Segment { from: ramp.from, back: ramp.back, ..cruise }.at_phase(tangent);
        Self::of(at, [ramp, cruise])
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
        let lost = position.wrapping_sub(self.position_at(at));
        let mut ticks = at.since(self.start).ticks();
        let mut rest = Self { start: at, segments: [Segment::default(); 3], count: 0 };
        for segment in self.segments() {
            let passed = ticks.min(segment.ticks);
            ticks -= passed;
            if passed < segment.ticks || passed == 0 {
                let from = Segment { from: segment.from.wrapping_add(lost), ..*segment };
                let place = rest.segments.get_mut(usize::from(rest.count));
                if let Some(place) = place {
                    *place = Segment {
                        ticks: segment.ticks - passed,
                        h: from.speed(passed) as i64,
                        ..from.at_phase(from.phase(passed))
                    };
                    rest.count += 1;
                }
            }
        }
        if rest.count == 0 { Self::rest(at, position) } else { rest }
    }

    /// When it began.
    #[must_use]
    pub fn start(&self) -> Instant {
        self.start
    }

    /// When it stands again; [`Instant::NEVER`] if it goes on without end.
    #[must_use]
    pub fn end(&self) -> Instant {
        self.segments().iter().fold(self.start, |at, segment| at + Duration::from_ticks(segment.ticks))
    }

    /// Its segments, in order.
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

    /// Signed speed at `at`, in steps/s.
    #[must_use]
    pub fn speed_at(&self, at: Instant) -> I48F16 {
        /// 2¹⁶ / f in lowest terms.
        const BITS: i128 = 64;
        const FREQUENCY: i128 = 15_625;
        let (segment, d) = self.segment_at(at);
        let bits = (segment.speed(d) * BITS / FREQUENCY) as i64;
        I48F16::from_bits(if segment.back { -bits } else { bits })
    }

    /// The segment that rules at `at`, and how many ticks it has run by then.
    fn segment_at(&self, at: Instant) -> (Segment, u64) {
        let mut ticks = at.since(self.start).ticks();
        let mut last = Segment::default();
        for segment in self.segments() {
            if ticks < segment.ticks {
                return (*segment, ticks);
            }
            ticks -= segment.ticks;
            last = *segment;
        }
        (last, last.ticks)
    }
}

/// `speed` in steps/s in the unit of [`Segment::h`].
fn top(speed: U24F8) -> i128 {
    /// f / 2⁸: a whole number, so that a speed in 1/256 step/s is, too.
    const UNIT: i128 = TICKS_PER_SECOND as i128 / 256;
    i128::from(speed.to_bits()) * UNIT
}

#[cfg(test)]
mod tests {
    use super::*;
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
    fn a_jog_goes_on_until_it_is_told_to_stop() {
        let jog = Plan::rest(at(0), 0).towards(at(0), I24F8::from_num(5_000), 10_000);
        assert_eq!(jog.end(), Instant::NEVER);
        assert_eq!(jog.position_at(Instant::from(1_500.millis())), 1_250 + 5_000);
        let stop = jog.towards(Instant::from(1_500.millis()), I24F8::ZERO, 10_000);
        assert_eq!(stop.end(), Instant::from(2_000.millis()));
        assert_eq!(stop.position_at(Instant::NEVER), 1_250 + 5_000 + 1_250);
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
            steps in any::<i32>(), speed in 1_u32..5_000_000, acceleration in 1_u32..,
            samples in proptest::collection::vec(any::<u64>(), 2..40),
        ) {
            let plan = Plan::profile(at(0), 0, steps, Rates::even(U24F8::from_num(speed), acceleration));
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
            for t in instants {
                let passed = i64::from(plan.position_at(at(t)).unsigned_abs());
                let left = i64::from(steps.unsigned_abs())
                    - i64::from(plan.position_at(at(end.saturating_sub(t))).unsigned_abs());
                let tolerance = 1 + i64::from(speed) / 8_000_000;
                prop_assert!((passed - left).abs() <= tolerance, "{} {}", passed, left);
            }
        }

        #[test]
        fn a_new_plan_goes_on_where_the_old_one_is(
            turns in proptest::collection::vec((0_u64..40_000_000, -40_000_i32..40_000), 1..8),
            acceleration in 1_u32..1_000_000,
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
    }
}
