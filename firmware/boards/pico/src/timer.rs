//! The time since the start, alarms and sleep.
//!
//! TIMER counts microseconds (4.6), so all actions and timestamps of this board are rounded to microseconds.

use core::cell::Cell;

use critical_section::Mutex;
use drivetwin_firmware::device::Instant;

use crate::chip::{ALARM, ARMED, INTE, INTR, RAW_HIGH, RAW_LOW};
use crate::interrupt;

/// Ticks of drivetwin's time in a microsecond.
pub(crate) const TICKS: u64 = 16;

/// Enables the interrupts of alarms.
pub(crate) fn start() {
    INTE.write(0b111);
}

/// Microseconds since the start.
#[inline]
pub(crate) fn micros() -> u64 {
    loop {
        let high = RAW_HIGH.read();
        let low = RAW_LOW.read();
        if RAW_HIGH.read() == high {
            return u64::from(high) << 32 | u64::from(low);
        }
    }
}

/// The low half of [`micros`], for measuring short times.
#[inline]
pub(crate) fn micros_low() -> u32 {
    RAW_LOW.read()
}

/// The present time, for timestamps in interrupts.
#[inline]
pub(crate) fn now() -> Instant {
    Instant::from_ticks(micros() * TICKS)
}

/// The last tick before the present microsecond, for the loop.
pub(crate) fn past() -> Instant {
    Instant::from_ticks((micros() * TICKS).saturating_sub(1))
}

/// The microsecond nearest to `at`; [`u64::MAX`] for [`Instant::NEVER`].
#[inline]
pub(crate) fn nearest(at: Instant) -> u64 {
    if at == Instant::NEVER { u64::MAX } else { at.ticks().saturating_add(TICKS / 2) / TICKS }
}

/// An alarm of TIMER.
pub(crate) struct Alarm {
    number: usize,
    /// Time to which the alarm is set, in µs.
    due: Mutex<Cell<u64>>,
}

impl Alarm {
    /// TIMER's alarm with this number, not set.
    pub(crate) const fn new(number: usize) -> Self {
        Self { number, due: Mutex::new(Cell::new(u64::MAX)) }
    }

    /// Schedules the interrupt at `micros`; [`u64::MAX`] means never. Returns `false` if that time is already
    /// over; then no interrupt is scheduled.
    #[inline]
    pub(crate) fn set(&self, micros: u64) -> bool {
        critical_section::with(|cs| self.due.borrow(cs).set(micros));
        INTR.write(1 << self.number);
        if micros == u64::MAX {
            ARMED.write(1 << self.number);
            return true;
        }
        // TIMER compares only the lower half of the time, whenever its count changes. So the alarm fires if
        // `micros` is in the future, and additionally fires early if `micros` is far in the future.
        ALARM.plus(4 * self.number).write(micros as u32);
        let comes = self::micros() < micros;
        if !comes {
            ARMED.write(1 << self.number);
            INTR.write(1 << self.number);
        }
        comes
    }

    /// Acknowledges the alarm's interrupt.
    #[inline]
    pub(crate) fn acknowledge(&self) {
        INTR.write(1 << self.number);
    }

    /// Acknowledges the alarm's interrupt, and returns whether its time has come. If not, the interrupt will
    /// come again.
    #[inline]
    pub(crate) fn has_come(&self) -> bool {
        self.acknowledge();
        let due = critical_section::with(|cs| self.due.borrow(cs).get());
        micros() >= due || !self.set(due)
    }
}

/// Alarm that wakes the loop.
pub(crate) static WAKE: Alarm = Alarm::new(1);

#[interrupt]
fn TIMER_IRQ_1() {
    // The interrupt has ended the sleep; the loop reads the time.
    WAKE.acknowledge();
}
