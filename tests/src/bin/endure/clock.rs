//! The clock of the bench beside that of the computer.

use std::time::Duration;

use crate::control::Control;
use crate::now;

/// Number of times that the clock is asked.
const TIMES: usize = 50;

/// Error of a time that the control API prints, in seconds.
const ROUNDING: f64 = 1e-5;

/// Bench time minus time of the computer, in seconds: a range that contains it.
///
/// The bench reads its clock at some time between the request and the reply. So a reply says only that the difference is
/// between the bench time minus the time of the reply and the bench time minus the time of the request. Each of
/// several replies makes the range smaller; what is left is the error of the measurement, and the delays of the network
/// are no part of the result.
#[derive(Clone, Copy)]
pub(crate) struct Offset {
    least: f64,
    most: f64,
}

impl Offset {
    #[cfg(test)]
    pub(crate) fn new(least: f64, most: f64) -> Self {
        Self { least, most }
    }

    /// Measures the difference from `start` on.
    pub(crate) fn measure(control: &Control, start: std::time::Instant) -> Result<Self, String> {
        let mut offset = Self { least: f64::NEG_INFINITY, most: f64::INFINITY };
        for _ in 0..TIMES {
            let before = (now() - start).as_secs_f64();
            let bench = control.seconds()?;
            let after = (now() - start).as_secs_f64();
            offset.least = offset.least.max(bench - after);
            offset.most = offset.most.min(bench - before);
        }
        if offset.least > offset.most + ROUNDING {
            return Err(format!("the clock of the bench jumped while it was read {TIMES} times"));
        }
        Ok(offset)
    }

    /// The difference since `earlier` and its error, in seconds.
    pub(crate) fn since(self, earlier: Self) -> (f64, f64) {
        let middle = |it: Self| f64::midpoint(it.least, it.most);
        let error = |it: Self| (it.most - it.least).max(0.0) / 2.0;
        (middle(self) - middle(earlier), error(self) + error(earlier))
    }

    /// The least difference since `earlier` that the measurements allow.
    pub(crate) fn at_least_since(self, earlier: Self) -> Duration {
        let (difference, error) = self.since(earlier);
        Duration::from_secs_f64((difference.abs() - error).max(0.0))
    }
}
