//! Plans of motion: the position and speed of an axis at any instant (PROJECT-7).
//!
//! A plan is a short list of segments of constant acceleration. All numbers are integers, in units chosen so
//! that nothing is rounded within a segment. With *f* ticks in a second, the speed *v* (steps/s) is stored as
//! `h = f·v`, the acceleration *a* (steps/s²) as it is, and a step is [`STEP`] `= 2·f²` units of phase. *d*
//! ticks after the start of a segment that began with `h`:
//!
//! ```text
//! phase grew by  d·(2h + a·d)          speed is  h + a·d
//! ```
//!
//! Step *n* is made at the tick nearest to the instant when the phase reaches `n·STEP`. In half a tick the
//! phase grows by the speed, so this is the first tick with `n·STEP < phase + speed`, or with
//! `n·STEP = phase`. By the second condition a step exactly on the vertex of a stop ramp, where the speed is
//! 0, counts as made. The factory move of an MD3 ends on such a step: its ramp has 5000²/(2·10000) = 1250
//! steps.
//!
//! The exact motion changes its acceleration between two ticks. A segment begins at the first whole tick
//! after the change, with the phase and the speed that the exact motion has there, so nothing is lost between
//! two segments. Only the end of a profile move is rounded, to the nearest tick. Its stop ramp is computed
//! backwards from the last step with the given acceleration. So it ends exactly on that step, whatever was
//! rounded before.
//!
//! # Example: a trapezoid
//!
//! 5,000 steps at up to 2,000 steps/s with 10,000 steps/s², from position 0. *f* is 16,000,000 ticks/s, so a
//! step is 2·*f*² = 512·10¹² units of phase.
//!
//! | segment | ticks | acceleration | `start_speed` = f·v | `base` | steps |
//! |---|---|---|---|---|---|
//! | ramp up, 2,000/10,000 = 0.2 s | 3,200,000 | 10,000 | 0 | 0 | 2,000²/(2·10,000) = 200 |
//! | cruise, 4,600/2,000 = 2.3 s | 36,800,000 | 0 | 32·10⁹ | 200 | 4,600 |
//! | stop ramp, 0.2 s | 3,200,000 | −10,000 | 32·10⁹ | 4,800 | 200 |
//!
//! At the end of the first ramp *d* = 3,200,000, so the phase has grown by *d*·(0 + 10,000·*d*) =
//! 102,400·10¹², which is exactly 200 steps. The speed is 10,000·*d* = 32·10⁹, which is 2,000 steps/s.
//!
//! ```
//! use drivetwin_firmware::device::{Instant, Plan};
//! use drivetwin_firmware::motion::Limits;
//! use fixed::types::U24F8;
//!
//! let start = Instant::from_ticks(0);
//! let plan = Plan::profile(start, 0, 5_000, Limits::even(U24F8::from_num(2_000), 10_000));
//! let [up, cruise, stop] = plan.segments() else { panic!("three segments") };
//! assert_eq!((up.ticks, up.acceleration, up.start_speed, up.base), (3_200_000, 10_000, 0, 0));
//! assert_eq!((cruise.ticks, cruise.start_speed, cruise.base), (36_800_000, 32_000_000_000, 200));
//! assert_eq!((stop.ticks, stop.acceleration, stop.base), (3_200_000, -10_000, 4_800));
//! // 2.7 s, of 16,000,000 ticks each.
//! assert_eq!(plan.end(), Instant::from_ticks(43_200_000));
//! assert_eq!(plan.position_at(Instant::from_ticks(3_200_000)), 200);
//! assert_eq!(plan.speed_at(Instant::from_ticks(3_200_000)), 2_000);
//! ```
//! # Limits
//!
//! Speeds are in 1/256 step/s up to [`MAX_SPEED`], accelerations in whole steps/s² up to 2³¹ − 1, any number
//! of steps that fits in 32 bits. Larger values act as the limit. A plan that takes longer than 2⁶⁴ ticks,
//! 36,000 years, ends there.

mod segment;
#[cfg(test)]
mod tests;

use core::num::NonZero;

use drivetwin_protocol::time::{Duration, Instant, TICKS_PER_SECOND};
use fixed::types::{I24F8, I48F16, U24F8};

pub use self::segment::Segment;
use self::segment::{divided, vertex};
use super::search::first_true;

/// Units of phase in a step: 2·f².
pub(crate) const STEP: i64 = 2 * (TICKS_PER_SECOND * TICKS_PER_SECOND).cast_signed();

/// The greatest speed of a plan, in steps/s: one tick for a pulse and one tick for the gap after it.
pub const MAX_SPEED: u32 = (TICKS_PER_SECOND / 2) as u32;

/// The greatest acceleration of a plan, in steps/s².
pub const MAX_ACCELERATION: u32 = i32::MAX as u32;

/// Limits of a profile move. A value above a limit acts as the limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Speed at the start and at the end, in steps/s; a value above `max_speed` acts as `max_speed`.
    pub start_speed: U24F8,
    /// Greatest speed in steps/s, up to [`MAX_SPEED`].
    pub max_speed: U24F8,
    /// Acceleration while speeding up in steps/s², up to [`MAX_ACCELERATION`].
    pub acceleration: u32,
    /// Acceleration while slowing down in steps/s², up to [`MAX_ACCELERATION`].
    pub deceleration: u32,
}

impl Limits {
    /// A move that starts and ends at standstill, with one acceleration.
    #[must_use]
    pub const fn even(speed: U24F8, acceleration: u32) -> Self {
        Self { start_speed: U24F8::ZERO, max_speed: speed, acceleration, deceleration: acceleration }
    }
}

/// Motion of an axis from an instant on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Plan {
    start: Instant,
    /// Ramp up, cruise, ramp down; or ramp down, ramp up, cruise (PROJECT-8).
    segments: [Segment; 3],
    /// Number of segments in use, at least one.
    count: u8,
}

impl Plan {
    /// Standstill at `position`.
    #[must_use]
    #[inline(never)]
    pub fn at_rest(at: Instant, position: i32) -> Self {
        Self::of(at, &[Segment { base: position, ..Segment::default() }])
    }

    #[inline(never)]
    fn of(start: Instant, list: &[Segment]) -> Self {
        let mut segments = [Segment::default(); 3];
        for (place, segment) in segments.iter_mut().zip(list) {
            *place = *segment;
        }
        Self { start, segments, count: (list.len() & 3) as u8 }
    }

    /// The plan with these segments, as [`start`](Self::start) and [`segments`](Self::segments) of another one return
    /// them; `None` if a plan cannot have them. For reports of plans that a board follows.
    #[must_use]
    pub fn of_segments(start: Instant, list: &[Segment]) -> Option<Self> {
        let is_possible = (1..=3).contains(&list.len()) && list.iter().all(Segment::is_possible);
        is_possible.then(|| Self::of(start, list))
    }

    /// A move from standstill at `from` by exactly `steps` steps: ramp up, cruise, ramp down. If the distance
    /// is too short for the speed, there is no cruise. The move ends at the tick nearest to the exact end, at
    /// which its last step is made. Without speed or acceleration the axis does not move.
    #[must_use]
    pub fn profile(at: Instant, from: i32, steps: i32, rates: Limits) -> Self {
        let speed = speed_units(rates.max_speed);
        let twice_speed = NonZero::new(2 * speed).filter(|_| steps != 0);
        let (Some(up), Some(down), Some(twice_speed)) =
            (bounded(rates.acceleration), bounded(rates.deceleration), twice_speed)
        else {
            return Self::at_rest(at, from);
        };
        let start = speed_units(rates.start_speed).min(speed);
        let distance = u128::from(steps.unsigned_abs()) * STEP as u128;
        let (a, b) = (NonZero::<u64>::from(up), NonZero::<u64>::from(down));
        // 1/a + 1/b = sum/product
        let (sum, product) = (a.saturating_add(b.get()), a.saturating_mul(b));
        let long = |number: NonZero<u64>| u128::from(number.get());
        let change = u128::from(speed - start);

        let first = Segment {
            base: from,
            reverse: steps < 0,
            start_speed: start.cast_signed(),
            ..Segment::default()
        };
        let stop_ramp = |ticks| first.stop_ramp_to(distance.cast_signed(), ticks, down);

        // Both ramps take (speed² − start²)·(1/a + 1/b) of the distance.
        let ramps = change * u128::from(speed + start) * long(sum);
        if divided(ramps + long(product) - 1, product) > distance {
            // Computed like one ramp with the acceleration a·b/(a + b): distance = t·(2·start + t·a·b/(a +
            // b)).
            let (start, distance) = (4 * u128::from(start) * long(sum), 4 * distance * long(sum));
            let half_ticks =
                first_true(|t| u128::from(t) * (start + u128::from(t) * long(product)) > distance) - 1;
            let end = half_ticks.div_ceil(2);
            let stop = divided(u128::from(end) * long(a), sum) as u64;
            let up = Segment { ticks: end - stop, acceleration: up.get().cast_signed(), ..first };
            return Self::of(at, &[up, stop_ramp(stop)]);
        }
        // Duration of the move in ticks: distance/(2·speed), as if the whole move had this speed, plus the
        // time that the ramps add: (speed − start)²·(1/a + 1/b)/(2·speed).
        let whole = divided(distance, twice_speed);
        let part = distance - whole * long(twice_speed);
        let lost = part * long(product) + change * change * long(sum);
        let half = long(twice_speed) * long(product) / 2;
        let end = (whole + divided(divided(lost + half, product), twice_speed)) as u64;
        let stop = ((speed - start) / b).min(end);
        let [up, cruise] = first.ramp_and_cruise(speed.cast_signed(), up, false);
        let up = Segment { ticks: up.ticks.min(end - stop), ..up };
        let cruise = Segment { ticks: end - stop - up.ticks, ..cruise };
        Self::of(at, &[up, cruise, stop_ramp(stop)])
    }

    /// A plan that continues this plan's motion at `at`, ramps to the signed `speed` in steps/s, and keeps
    /// that speed without end. If `speed` is 0, it ends at standstill. If `speed` has the opposite direction,
    /// the axis first slows down to standstill. With acceleration 0 the axis stops at once. The limits are
    /// those of [`Limits`].
    #[must_use]
    pub fn ramp_to(&self, at: Instant, speed: I24F8, acceleration: u32) -> Self {
        let (now, d) = self.segment_at(at);
        let position = now.position(d);
        let now = now.since(d);
        let Some(a) = bounded(acceleration).filter(|_| now.start_speed != 0 || speed != 0) else {
            return Self::at_rest(at, position);
        };
        let target = speed_units(speed.unsigned_abs()).cast_signed();
        let back = speed < 0;
        if now.start_speed != 0 && speed != 0 && back == now.reverse {
            return Self::of(at, &now.ramp_and_cruise(target, a, target < now.start_speed));
        }
        let (stop, turn) = now.stop(0, a);
        let turned = Segment { base: turn, reverse: back, ..Segment::default() };
        if speed == 0 {
            return Self::of(at, &[stop, turned]);
        }
        let h = -stop.speed(stop.ticks);
        let rest = vertex(h.cast_unsigned(), a).cast_signed();
        let [up, cruise] =
            Segment { start_speed: h, phase_offset: rest, ..turned }.ramp_and_cruise(target, a, false);
        Self::of(at, &[stop, up, cruise])
    }

    /// As [`ramp_to`](Self::ramp_to), for an axis that starts and stops at the speed `rates.start_speed`, or
    /// at `speed` if `speed` is less: a motion from standstill begins at this speed, and a ramp to standstill
    /// ends at it. `rates.max_speed` has no effect.
    #[must_use]
    pub fn slew(&self, at: Instant, speed: I24F8, rates: Limits) -> Self {
        let (now, d) = self.segment_at(at);
        let position = now.position(d);
        let now = now.since(d);
        let (Some(up), Some(down)) = (bounded(rates.acceleration), bounded(rates.deceleration)) else {
            return Self::at_rest(at, position);
        };
        let (start, target) =
            (speed_units(rates.start_speed).cast_signed(), speed_units(speed.unsigned_abs()).cast_signed());
        let back = speed < 0;
        let begin = |from| Segment {
            base: from,
            reverse: back,
            start_speed: start.min(target),
            ..Segment::default()
        };
        match (now.start_speed, target) {
            (0, 0) => Self::at_rest(at, position),
            (0, _) => Self::of(at, &begin(position).ramp_and_cruise(target, up, false)),
            (h, 1..) if back == now.reverse => {
                let slower = target < h;
                Self::of(at, &now.ramp_and_cruise(target, if slower { down } else { up }, slower))
            }
            _ => {
                let (stop, turn) = now.stop(start, down);
                if target == 0 {
                    return Self::of(at, &[stop, begin(turn)]);
                }
                let [ramp, cruise] = begin(turn).ramp_and_cruise(target, up, false);
                Self::of(at, &[stop, ramp, cruise])
            }
        }
    }

    /// A ramp to standstill that ends on a whole step, at least half a step from the position at `at`. Before
    /// the ramp the present speed continues for as long as this needs. The ramp ends at the speed
    /// `rates.start_speed`, or at the present speed if that is less. A shaft that follows the plan stays
    /// where the plan ends; with [`slew`](Self::slew) it would turn back by a part of a step.
    #[must_use]
    pub fn stop_on_step(&self, at: Instant, rates: Limits) -> Self {
        let (now, d) = self.segment_at(at);
        let now = now.since(d);
        match bounded(rates.deceleration) {
            Some(down) if now.start_speed != 0 => {
                Self::of(at, &now.stop_on_step(speed_units(rates.start_speed).cast_signed(), down, STEP / 2))
            }
            _ => self.halt(at),
        }
    }

    /// Keeps the speed that the plan has at `at` until the next whole step, and stands still there.
    #[must_use]
    pub fn finish_step(&self, at: Instant) -> Self {
        let (now, d) = self.segment_at(at);
        let now = now.since(d);
        if now.start_speed == 0 {
            return self.halt(at);
        }
        Self::of(at, &now.stop_on_step(now.start_speed, NonZero::<u32>::MIN, 1))
    }

    /// Standstill at the plan's position at `at`.
    #[must_use]
    pub fn halt(&self, at: Instant) -> Self {
        Self::at_rest(at, self.position_at(at))
    }

    /// The remainder of this plan from `at` on, starting at `position`. For a motor that had no current while
    /// its plan continued, and that now follows the plan again.
    #[must_use]
    pub fn continued_from(&self, at: Instant, position: i32) -> Self {
        let at = at.max(self.start);
        let mut rest = Self::at_rest(at, position);
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
            let base = segment.base.wrapping_add(lost);
            *place = Segment { base, ..*segment }.since(ticks);
            ticks = 0;
            rest.count += 1;
        }
        rest
    }

    /// The same plan, delayed by `late`.
    #[must_use]
    pub fn delayed(&self, late: Duration) -> Self {
        Self { start: self.start + late, ..*self }
    }

    /// Start of the plan.
    #[must_use]
    pub fn start(&self) -> Instant {
        self.start
    }

    /// End of the motion; [`Instant::NEVER`] if it does not end.
    #[must_use]
    #[inline(never)]
    pub fn end(&self) -> Instant {
        self.segments().iter().fold(self.start, |at, segment| at + Duration::from_ticks(segment.ticks))
    }

    /// Segments, in order. A segment may have no ticks.
    #[must_use]
    pub fn segments(&self) -> &[Segment] {
        self.segments.get(..usize::from(self.count)).unwrap_or(&self.segments)
    }

    /// Position at `at`: all steps made at or before `at` are counted.
    #[must_use]
    pub fn position_at(&self, at: Instant) -> i32 {
        let (segment, d) = self.segment_at(at);
        segment.position(d)
    }

    /// Time of the first step after `after` that reaches `position`; [`Instant::NEVER`] if no step does.
    #[must_use]
    pub fn time_of(&self, after: Instant, position: i32) -> Instant {
        let (mut here, mut begin) = (self.position_at(after), self.start);
        for segment in self.segments().iter().filter(|segment| segment.ticks > 0) {
            let end = begin + Duration::from_ticks(segment.ticks);
            if after < end {
                if after < begin {
                    // A step may be due at the start of this segment.
                    let there = segment.position(0);
                    if here != there && there == position {
                        return begin;
                    }
                }
                if let Some(ticks) = segment.time_of(after.since(begin).ticks(), position) {
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
        /// The fraction 2¹⁶ / f in lowest terms: `BITS` / `FREQUENCY`.
        const BITS: i64 = 64;
        const FREQUENCY: i64 = 15_625;
        let (segment, d) = self.segment_at(at);
        let bits = segment.speed(d) * BITS / FREQUENCY;
        I48F16::from_bits(if segment.reverse { -bits } else { bits })
    }

    /// The segment in effect at `at`, and its ticks that have passed by `at`. After the last segment this is
    /// a segment at standstill.
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
        (Segment { base: last.position(last.ticks), reverse: last.reverse, ..Segment::default() }, 0)
    }
}

/// `speed` in steps/s in the unit of [`Segment::start_speed`].
fn speed_units(speed: U24F8) -> u64 {
    /// f / 2⁸. It is a whole number, so a speed in 1/256 step/s is a whole number of units.
    const UNIT: u64 = TICKS_PER_SECOND / 256;
    u64::from(speed.to_bits().min(MAX_SPEED << 8)) * UNIT
}

/// An acceleration, limited to [`MAX_ACCELERATION`]; `None` if it is 0.
fn bounded(acceleration: u32) -> Option<NonZero<u32>> {
    NonZero::new(acceleration.min(MAX_ACCELERATION))
}
