//! The clock of the bench beside that of the computer, while all masters wait.

use std::time::Duration;

use crate::control::Control;
use crate::now;

/// Number of times that the clock is asked in a measurement.
const TIMES: usize = 50;

/// Greatest error of a measurement, in seconds, and the number of measurements until one has no greater error.
const MOST_ERROR: f64 = 5e-4;
const TRIES: usize = 10;

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

    /// Measures the difference. Times are from `start` on.
    pub(crate) fn measure(control: &Control, start: std::time::Instant) -> Result<Self, String> {
        Self::first_exact(|| Self::measure_once(control, start))
    }

    /// The first measurement whose error is not too great.
    fn first_exact(mut measure: impl FnMut() -> Result<Self, String>) -> Result<Self, String> {
        for _ in 0..TRIES {
            let offset = measure()?;
            if offset.error() <= MOST_ERROR {
                return Ok(offset);
            }
        }
        let most = 1e3 * MOST_ERROR;
        Err(format!(
            "the clock of the bench cannot be measured: each of {TRIES} measurements has an error above {most} ms; the machine is too busy"
        ))
    }

    fn measure_once(control: &Control, start: std::time::Instant) -> Result<Self, String> {
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
        (middle(self) - middle(earlier), self.error() + earlier.error())
    }

    /// Half of the range, in seconds.
    fn error(self) -> f64 {
        (self.most - self.least).max(0.0) / 2.0
    }

    /// The least difference since `earlier` that the measurements allow.
    pub(crate) fn at_least_since(self, earlier: Self) -> Duration {
        let (difference, error) = self.since(earlier);
        Duration::from_secs_f64((difference.abs() - error).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_no_measurement_shows_exactly_is_an_error() {
        let measure = |mut errors: Vec<f64>| {
            Offset::first_exact(|| Ok(Offset::new(0.0, 2.0 * errors.pop().unwrap()))).map(Offset::error)
        };
        assert_eq!(measure(vec![1e-4, 4e-4, 6e-4]), Ok(4e-4));
        assert!(measure(vec![6e-4; TRIES]).unwrap_err().contains("cannot be measured"));
    }
}
