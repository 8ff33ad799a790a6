//! `PULSE_IN`: measures the rate of pulses, or their width (p. 10).

use super::Ratio;
use crate::device::{Duration, Instant};

/// Minimum time for which pulses are counted.
const GATE: Duration = Duration::millis(1);
/// RC pulses are faster than 250 Hz, and counted pulses are faster still. After this time without a pulse the
/// drive decides that the input has no pulses.
const SLOWEST: Duration = Duration::millis(4);

/// Pulses per second at standstill and at full scale.
const LEAST_RATE: u64 = 5_000;
const GREATEST_RATE: u64 = 500_000;

/// Widths of an RC pulse: full scale backward, and the range of the middle.
const RC_LEAST: Duration = Duration::micros(1_050);
const RC_MIDDLE: (Duration, Duration) = (Duration::micros(1_400), Duration::micros(1_600));

/// Measurement at PULSE_IN.
#[derive(Clone, Copy, Debug)]
pub(super) struct PulseIn {
    /// Start of the last pulse.
    rose: Option<Instant>,
    /// Width of the last pulse.
    width: Option<Duration>,
    /// Start of the present count, and pulses since then.
    gate: Instant,
    count: u32,
    /// Pulses of the last finished count, and its duration.
    counted: (u32, Duration),
    /// Time at which the drive decides that the input has no pulses.
    due: Instant,
}

impl PulseIn {
    /// No pulses.
    pub(super) const SILENT: Self = Self {
        rose: None,
        width: None,
        gate: Instant::ZERO,
        count: 0,
        counted: (0, Duration::ZERO),
        due: Instant::NEVER,
    };

    /// Handles an edge. Returns true if there is a new measurement.
    pub(super) fn edge(&mut self, at: Instant, high: bool) -> bool {
        if !high {
            self.width = self.rose.map(|rose| at.since(rose));
            return self.width.is_some();
        }
        self.due = at + SLOWEST;
        if self.rose.replace(at).is_none() {
            self.gate = at;
            return false;
        }
        self.count += 1;
        let span = at.since(self.gate);
        let whole = span >= GATE;
        if whole {
            (self.counted, self.gate, self.count) = ((self.count, span), at, 0);
        }
        whole
    }

    pub(super) fn deadline(&self) -> Instant {
        self.due
    }

    /// Returns true if the pulses have just timed out.
    pub(super) fn timeout(&mut self, at: Instant) -> bool {
        let silent = self.due <= at;
        if silent {
            *self = Self::SILENT;
        }
        silent
    }

    /// Speed that the rate of the pulses requests.
    pub(super) fn rate(self) -> Ratio {
        let (count, span) = self.counted;
        // Both sides of the fraction are multiplied by the time in ticks.
        let ticks = span.ticks();
        let pulses = Duration::secs(count.into()).ticks();
        let above = pulses.saturating_sub(LEAST_RATE.saturating_mul(ticks));
        Ratio::new(above.cast_signed(), (GREATEST_RATE - LEAST_RATE).saturating_mul(ticks).cast_signed())
    }

    /// Speed that the width of the pulses requests, as from a radio control.
    pub(super) fn rc(self) -> Ratio {
        let Some(width) = self.width else { return Ratio::NONE };
        let (first, last) = RC_MIDDLE;
        let past = width.ticks().cast_signed() - width.clamp(first, last).ticks().cast_signed();
        Ratio::new(past, (first - RC_LEAST).ticks().cast_signed())
    }
}
