//! Time modes of a bench, as users write them.

use std::fmt;
use std::str::FromStr;

use drivetwin_firmware::device::Duration;

/// Longest wait for the rest of a partial frame, in ms of the wall clock.
const PATIENCE_MS: u64 = 20;

/// The greatest factor of [`TimeMode::Times`].
const FASTEST: u32 = 1000;

/// Relation of bench time to the wall clock.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum TimeMode {
    /// Bench time runs this many times as fast as the wall clock.
    Times(u32),
    /// Bench time is stopped, except for the time that a request or a call needs.
    Manual,
}

impl TimeMode {
    /// Longest wait for the rest of a partial frame, in bench time.
    pub fn frame_timeout(self) -> Duration {
        match self {
            Self::Times(factor) => Duration::millis(PATIENCE_MS) * u64::from(factor),
            Self::Manual => Duration::millis(PATIENCE_MS),
        }
    }
}

impl FromStr for TimeMode {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let factor = text.strip_prefix('x').and_then(|factor| factor.parse().ok());
        match (text, factor) {
            ("real", _) => Ok(Self::Times(1)),
            ("manual", _) => Ok(Self::Manual),
            (_, Some(factor)) if (1..=FASTEST).contains(&factor) => Ok(Self::Times(factor)),
            _ => Err(format!("it takes real, xN (N from 1 to {FASTEST}) or manual")),
        }
    }
}

impl fmt::Display for TimeMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Times(1) => f.write_str("real"),
            Self::Times(factor) => write!(f, "x{factor}"),
            Self::Manual => f.write_str("manual"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patience_is_wall_time() {
        assert_eq!(TimeMode::Times(10).frame_timeout(), Duration::millis(200));
        assert_eq!(TimeMode::Manual.frame_timeout(), Duration::millis(20));
    }
}
