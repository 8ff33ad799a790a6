//! Time in drivetwin: whole ticks of 1/16 µs (PROJECT-1).
//!
//! 16 MHz is the rate of a common timer. A tick divides every baud rate well enough (a character of 9,600 8E1
//! is 18,333⅓ ticks), and 64 bits of ticks last 36,000 years. All arithmetic saturates: [`Instant::NEVER`]
//! stays [`Instant::NEVER`] whatever is added to it.

use core::fmt;
use core::ops::{Add, AddAssign, Div, Mul, Sub};

/// Ticks in a second.
pub const TICKS_PER_SECOND: u64 = 16_000_000;

/// A point in time: ticks of 1/16 µs since the bench or the board started.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Instant(u64);

/// A span of time in ticks of 1/16 µs.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Duration(u64);

impl Instant {
    /// Start of the bench or the board.
    pub const ZERO: Self = Self(0);
    /// Later than every other instant: the deadline of a device that waits for an input only.
    pub const NEVER: Self = Self(u64::MAX);

    /// The instant `ticks` after the start.
    #[must_use]
    pub const fn from_ticks(ticks: u64) -> Self {
        Self(ticks)
    }

    /// Ticks since the start.
    #[must_use]
    pub const fn ticks(self) -> u64 {
        self.0
    }

    /// The time passed since `earlier`; zero if `earlier` is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Duration {
        Duration(self.0.saturating_sub(earlier.0))
    }
}

impl Duration {
    /// No time.
    pub const ZERO: Self = Self(0);
    /// The shortest nonzero time. Nothing on a bench is faster.
    pub const TICK: Self = Self(1);
    /// Longer than every other span.
    pub const FOREVER: Self = Self(u64::MAX);

    /// A span of `ticks`.
    #[must_use]
    pub const fn from_ticks(ticks: u64) -> Self {
        Self(ticks)
    }

    /// The span in ticks.
    #[must_use]
    pub const fn ticks(self) -> u64 {
        self.0
    }

    /// `n` microseconds.
    #[must_use]
    pub const fn micros(n: u64) -> Self {
        Self(n.saturating_mul(TICKS_PER_SECOND / 1_000_000))
    }

    /// `n` milliseconds.
    #[must_use]
    pub const fn millis(n: u64) -> Self {
        Self(n.saturating_mul(TICKS_PER_SECOND / 1_000))
    }

    /// `n` seconds.
    #[must_use]
    pub const fn secs(n: u64) -> Self {
        Self(n.saturating_mul(TICKS_PER_SECOND))
    }

    /// Duration of `bits` bits at `baud` bits per second, rounded to the nearest tick. A baud rate of 0
    /// counts as 1.
    #[must_use]
    pub const fn of_bits(bits: u32, baud: u32) -> Self {
        let baud = if baud == 0 { 1 } else { baud as u64 };
        Self((bits as u64 * TICKS_PER_SECOND + baud / 2) / baud)
    }
}

/// The instant at this time after the start.
impl From<Duration> for Instant {
    fn from(since_beginning: Duration) -> Self {
        Self(since_beginning.0)
    }
}

impl Add<Duration> for Instant {
    type Output = Self;
    fn add(self, span: Duration) -> Self {
        Self(self.0.saturating_add(span.0))
    }
}

impl AddAssign<Duration> for Instant {
    fn add_assign(&mut self, span: Duration) {
        *self = *self + span;
    }
}

/// Subtraction. The result is never before [`Instant::ZERO`].
impl Sub<Duration> for Instant {
    type Output = Self;
    fn sub(self, span: Duration) -> Self {
        Self(self.0.saturating_sub(span.0))
    }
}

impl Add for Duration {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl Sub for Duration {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

impl Mul<u64> for Duration {
    type Output = Self;
    fn mul(self, n: u64) -> Self {
        Self(self.0.saturating_mul(n))
    }
}

/// Number of times that `other` fits into the span. An `other` of zero counts as one tick.
impl Div for Duration {
    type Output = u64;
    fn div(self, other: Self) -> u64 {
        self.0.checked_div(other.0).unwrap_or(self.0)
    }
}

/// Spans written as `2_500.millis()`.
pub trait Span {
    /// A span of this many microseconds.
    fn micros(self) -> Duration;
    /// A span of this many milliseconds.
    fn millis(self) -> Duration;
    /// A span of this many seconds.
    fn secs(self) -> Duration;
}

impl Span for u64 {
    fn micros(self) -> Duration {
        Duration::micros(self)
    }
    fn millis(self) -> Duration {
        Duration::millis(self)
    }
    fn secs(self) -> Duration {
        Duration::secs(self)
    }
}

/// Seconds since the start, exact, without zeros at the end: `2.513176875 s`; `never` for [`Instant::NEVER`].
///
/// ```
/// use drivetwin_protocol::time::{Duration, Instant, Span as _};
///
/// assert_eq!(Instant::from(2_500.millis()).to_string(), "2.5 s");
/// assert_eq!(Duration::TICK.to_string(), "0.0000000625 s");
/// ```
impl fmt::Display for Instant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::NEVER => f.write_str("never"),
            Self(ticks) => seconds(ticks, f),
        }
    }
}

/// Seconds, exact, without zeros at the end: `0.0000000625 s`; `forever` for [`Duration::FOREVER`].
impl fmt::Display for Duration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::FOREVER => f.write_str("forever"),
            Self(ticks) => seconds(ticks, f),
        }
    }
}

/// Writes ticks as seconds. A tick is 625 units of 0.1 ns.
fn seconds(ticks: u64, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    write!(f, "{}", ticks / TICKS_PER_SECOND)?;
    let (mut rest, mut digits) = (ticks % TICKS_PER_SECOND * 625, 10);
    if rest > 0 {
        while rest % 10 == 0 {
            (rest, digits) = (rest / 10, digits - 1);
        }
        write!(f, ".{rest:0digits$}")?;
    }
    f.write_str(" s")
}

#[cfg(test)]
mod tests {
    use std::string::ToString as _;

    use super::*;

    #[test]
    fn times_are_shown_in_exact_seconds() {
        for (ticks, text) in [
            (0, "0 s"),
            (16_000_000, "1 s"),
            (40_000_000, "2.5 s"),
            (16_000_001, "1.0000000625 s"),
            (160, "0.00001 s"),
            (u64::MAX - 1, "1152921504606.846975875 s"),
        ] {
            assert_eq!(Instant::from_ticks(ticks).to_string(), text);
            assert_eq!(Duration::from_ticks(ticks).to_string(), text);
        }
        assert_eq!(
            (Instant::NEVER.to_string(), Duration::FOREVER.to_string()),
            ("never".into(), "forever".into())
        );
    }

    #[test]
    fn a_tick_is_a_sixteenth_of_a_microsecond() {
        assert_eq!(1.micros().ticks(), 16);
        assert_eq!(1.millis().ticks(), 16_000);
        assert_eq!(1.secs().ticks(), 16_000_000);
    }

    #[test]
    fn never_stays_never() {
        assert_eq!(Instant::NEVER + 1.secs(), Instant::NEVER);
        assert_eq!(Instant::ZERO - 1.secs(), Instant::ZERO);
        assert_eq!(Instant::ZERO.since(Instant::NEVER), Duration::ZERO);
    }

    #[test]
    fn bits_are_rounded_to_the_nearest_tick() {
        assert_eq!(Duration::of_bits(11, 9_600).ticks(), 18_333); // 18,333.33
        assert_eq!(Duration::of_bits(10, 115_200).ticks(), 1_389); // 1,388.89
        assert_eq!(Duration::of_bits(1, 0).ticks(), 16_000_000);
    }
}
