//! The analogue input (MC 5-17, 5-34, 5-65).

use super::super::SHUNT_OHM;
use super::super::error::Error;
use super::point::flag;
use crate::device::{Duration, Instant};

/// Reading at full scale.
const MAX: i32 = 1_023;
/// Reading of 4 mA. A transmitter of 4 to 20 mA gives no less (MC 5-65).
const LEAST_OF_4_MA: i32 = 205;
/// Full scale of a current (20 mA), in mV across the shunt.
const MAX_CURRENT_MV: i32 = 20 * SHUNT_OHM as i32;
/// Interval of readings; the manuals do not give it.
const INTERVAL: Duration = Duration::millis(1);
/// Fractional bits of an average.
const FRACTION: u32 = 16;

/// Measured quantity.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Range {
    Volts5,
    Volts10,
    /// 0 to 20 mA.
    Current,
    /// 4 to 20 mA.
    LiveCurrent,
}

/// The analogue input.
#[derive(Clone, Copy, Debug)]
pub(super) struct Analogue {
    range: Range,
    mv: i32,
    /// D5: number of readings to average over; 0 and 1 mean no average.
    over: u8,
    /// Average of the readings so far, with [`FRACTION`] fractional bits.
    average: i32,
    /// Number of readings that the drive has taken since time 0.
    taken: u64,
}

impl Analogue {
    /// Factory settings, at 0 V.
    pub(super) const ZERO: Self = Self { range: Range::Volts5, mv: 0, over: 0, average: 0, taken: 0 };

    /// Restarts with the factory's settings. The voltage stays as it is.
    pub(super) fn restart(&mut self) {
        *self = Self { mv: self.mv, ..Self::ZERO };
    }

    /// S5: type (9 voltage, 10 current) and range. FB 4.3.1 and the examples of MC 5-65 agree that range 1 of
    /// a current is 4 to 20 mA.
    ///
    /// # Errors
    /// Error 8 for the type, 21 for the range.
    pub(super) fn set_up(&mut self, at: Instant, [kind, second]: [u16; 2]) -> Result<(), Error> {
        let second = match kind {
            9 | 10 => flag(second)?,
            _ => return Err(Error::IllegalType),
        };
        self.read_until(at);
        self.range = match (kind, second) {
            (9, false) => Range::Volts5,
            (9, true) => Range::Volts10,
            (_, false) => Range::Current,
            (_, true) => Range::LiveCurrent,
        };
        Ok(())
    }

    /// D5: sets the number of readings to average over.
    pub(super) fn set_average(&mut self, at: Instant, over: u8) {
        self.read_until(at);
        if self.over <= 1 {
            self.average = self.reading() << FRACTION;
        }
        self.over = over;
    }

    /// Sets the voltage at the pin; for a current, the voltage across the shunt.
    pub(super) fn sample(&mut self, at: Instant, mv: i32) {
        self.read_until(at);
        self.mv = mv;
    }

    /// I5: present reading, averaged.
    pub(super) fn value(&self, at: Instant) -> u16 {
        let value = if self.over <= 1 {
            self.reading()
        } else {
            // A reading that is due at this instant is included.
            let average = self.averaged(at.ticks() / INTERVAL.ticks() + 1);
            (average + (1 << (FRACTION - 1))) >> FRACTION
        };
        u16::try_from(value).unwrap_or(0)
    }

    /// Present reading, without average.
    fn reading(&self) -> i32 {
        // The part of full scale that 1 mV is, in 1/10,000, and the least reading.
        let (per_mv, least) = match self.range {
            Range::Volts5 => (2, 0),
            Range::Volts10 => (1, 0),
            Range::Current => (10_000 / MAX_CURRENT_MV, 0),
            Range::LiveCurrent => (10_000 / MAX_CURRENT_MV, LEAST_OF_4_MA),
        };
        let share = per_mv * self.mv.clamp(0, 10_000);
        ((MAX * share + 5_000) / 10_000).clamp(least, MAX)
    }

    /// Takes all readings before `at`.
    fn read_until(&mut self, at: Instant) {
        let count = at.ticks().div_ceil(INTERVAL.ticks());
        self.average = self.averaged(count);
        self.taken = count;
    }

    /// Average after this number of readings since time 0. Each reading counts 1/D5, the average before it
    /// the rest (MC 5-17).
    fn averaged(&self, count: u64) -> i32 {
        let reading = self.reading() << FRACTION;
        let mut average = self.average;
        for _ in self.taken..count {
            let nearer = (reading - average).checked_div(self.over.into()).unwrap_or(0);
            // From here on the average no longer changes. 16 ln 2 + ln 1023 times D5 readings are enough for
            // that, and millions may be due.
            if nearer == 0 {
                break;
            }
            average += nearer;
        }
        average
    }
}
