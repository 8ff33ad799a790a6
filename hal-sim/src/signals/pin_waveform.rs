//! Waveforms of outputs: the level at any time.

use drivetwin_firmware::device::{Duration, Instant, Level};

/// Output of a drive at a pin.
#[derive(Clone, Copy, Debug)]
pub(crate) enum PinOutput {
    /// A constant level; `Float` if the pin is released.
    Level(Level),
    /// A wave: high for `high`, low for the rest of `period`.
    Wave { since: Instant, period: Duration, high: Duration },
}

impl PinOutput {
    /// The pin is released.
    pub(crate) const NOTHING: Self = Self::Level(Level::Float);

    /// The level at `at`. If the output is a wave, it must have begun by then.
    pub(crate) fn level(self, at: Instant) -> Level {
        match self {
            Self::Level(level) => level,
            Self::Wave { since, period, high } => level_of(phase(since, period, at) < high),
        }
    }

    /// Time of the next change of level after `at`, if the output stays the same; [`Instant::NEVER`] if there
    /// is none. If the output is a wave, it must have begun by `at`.
    pub(crate) fn next_edge(self, at: Instant) -> Instant {
        match self {
            Self::Wave { since, period, high } if Duration::ZERO < high && high < period => {
                let phase = phase(since, period, at);
                at + (if phase < high { high - phase } else { period - phase })
            }
            Self::Wave { .. } | Self::Level(_) => Instant::NEVER,
        }
    }
}

/// A logic level.
pub(crate) fn level_of(high: bool) -> Level {
    if high { Level::High } else { Level::Low }
}

/// Time since the start of the present cycle of a wave; zero if the period is zero.
fn phase(since: Instant, period: Duration, at: Instant) -> Duration {
    Duration::from_ticks(at.since(since).ticks() % period.ticks().max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SINCE: u64 = 1_000;

    fn wave(period: u64, high: u64) -> PinOutput {
        PinOutput::Wave {
            since: Instant::from_ticks(SINCE),
            period: Duration::from_ticks(period),
            high: Duration::from_ticks(high),
        }
    }

    /// The level at that many ticks after the start, and the tick of the next change.
    fn after(drives: PinOutput, ticks: u64) -> (Level, Option<u64>) {
        let at = Instant::from_ticks(SINCE + ticks);
        let next = drives.next_edge(at);
        (drives.level(at), (next < Instant::NEVER).then(|| next.ticks() - SINCE))
    }

    #[test]
    fn a_wave_begins_high_and_changes_twice_in_a_cycle() {
        let wave = wave(10, 3);
        assert_eq!(after(wave, 0), (Level::High, Some(3)));
        assert_eq!(after(wave, 2), (Level::High, Some(3)));
        assert_eq!(after(wave, 3), (Level::Low, Some(10)));
        assert_eq!(after(wave, 9), (Level::Low, Some(10)));
        assert_eq!(after(wave, 10), (Level::High, Some(13)));
        assert_eq!(after(wave, 1_000_009), (Level::Low, Some(1_000_010)));
    }

    #[test]
    fn what_does_not_alternate_has_no_edges() {
        for ticks in [0, 5, 12] {
            assert_eq!(after(wave(10, 0), ticks), (Level::Low, None));
            assert_eq!(after(wave(10, 10), ticks), (Level::High, None));
            assert_eq!(after(wave(10, 11), ticks), (Level::High, None));
            assert_eq!(after(wave(0, 0), ticks), (Level::Low, None));
            assert_eq!(after(wave(0, 1), ticks), (Level::High, None));
            assert_eq!(after(PinOutput::NOTHING, ticks), (Level::Float, None));
            assert_eq!(after(PinOutput::Level(Level::High), ticks), (Level::High, None));
        }
    }
}
