//! SPEED_IN: a voltage, or the duty of pulses (p. 10, 14).

use super::Ratio;
use crate::device::{Duration, Instant};

/// Result of a measurement of 5 V, with 10 bits.
pub(super) const FULL_SCALE: u16 = 1_023;
const FULL_SCALE_MV: i32 = 5_000;

/// The middle range of a joystick is 2 V to 3 V: 409.2 to 613.8.
const MIDDLE: core::ops::RangeInclusive<u16> = 409..=614;

/// Period of pulses of 5 kHz; the pulses of this input are faster. A level that lasts longer is a voltage.
const SLOWEST: Duration = Duration::micros(200);

/// Measurement at SPEED_IN.
#[derive(Clone, Copy, Debug)]
pub(super) struct SpeedIn {
    /// Measured value, 0 to [`FULL_SCALE`].
    digit: u16,
    high: bool,
    /// Time of the last rising edge, and length of the last high level after one.
    rose: Option<Instant>,
    on: Option<Duration>,
    /// Time at which the present level has lasted too long for a pulse.
    due: Instant,
}

impl SpeedIn {
    /// State at 0 V.
    pub(super) const GROUND: Self = Self { digit: 0, high: false, rose: None, on: None, due: Instant::NEVER };

    /// Handles a voltage.
    pub(super) fn voltage(&mut self, mv: i32) {
        let digit = mv.clamp(0, FULL_SCALE_MV) * i32::from(FULL_SCALE) / FULL_SCALE_MV;
        *self = Self { digit: digit as u16, ..Self::GROUND };
    }

    /// Handles an edge. Returns true if there is a new measurement.
    pub(super) fn edge(&mut self, at: Instant, high: bool) -> bool {
        (self.high, self.due) = (high, at + SLOWEST);
        if !high {
            self.on = self.rose.map(|rose| at.since(rose));
            return false;
        }
        let Some((rose, on)) = self.rose.replace(at).zip(self.on.take()) else { return false };
        let period = at.since(rose);
        let pulsed = period < SLOWEST;
        if pulsed {
            self.digit = (on * FULL_SCALE.into() / period) as u16;
        }
        pulsed
    }

    pub(super) fn deadline(&self) -> Instant {
        self.due
    }

    /// Measured value, 0 to [`FULL_SCALE`].
    pub(super) fn digit(&self) -> u16 {
        self.digit
    }

    /// Returns true if the level has just become a voltage.
    pub(super) fn timeout(&mut self, at: Instant) -> bool {
        let steady = self.due <= at;
        if steady {
            let digit = if self.high { FULL_SCALE } else { 0 };
            *self = Self { digit, high: self.high, ..Self::GROUND };
        }
        steady
    }
}

/// Speed that a voltage requests: zero below `low`, full scale from `high` on (p. 14).
pub(super) fn analogue(digit: u16, low: u16, high: u16) -> Ratio {
    let [digit, low, high] = [digit, low, high].map(i64::from);
    if digit < low {
        Ratio::NONE
    } else if digit >= high {
        Ratio::ALL
    } else {
        Ratio::new(digit - low, high - low)
    }
}

/// Speed that a joystick requests: its sign is the side of the middle.
pub(super) fn joystick(digit: u16) -> Ratio {
    let (first, last) = (*MIDDLE.start(), *MIDDLE.end());
    let past = i64::from(digit) - i64::from(digit.clamp(first, last));
    Ratio::new(past, i64::from(first))
}
