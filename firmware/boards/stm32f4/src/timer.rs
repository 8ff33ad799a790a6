//! The time since the start, alarms and sleep.
//!
//! TIM2 (chapter 13) counts the ticks of drivetwin's time. A microsecond has 16 ticks, so nothing is rounded.
//! TIM2 has 32 bits and overflows every 268 s.

use core::cell::Cell;
use core::sync::atomic::{AtomicU32, Ordering};

use critical_section::Mutex;
use drivetwin_firmware::device::Instant;

use crate::clock::MHZ;
use crate::registers::Register;
use crate::steps;
use crate::vectors::interrupt;

/// Registers of TIM2 (13.4).
const TIMER: usize = 0x4000_0000;
const CONTROL: Register = Register::at(TIMER, 0x00);
const INTERRUPTS: Register = Register::at(TIMER, 0x0C);
const STATUS: Register = Register::at(TIMER, 0x10);
const EVENT: Register = Register::at(TIMER, 0x14);
const COUNT: Register = Register::at(TIMER, 0x24);
const PRESCALER: Register = Register::at(TIMER, 0x28);
const LAST: Register = Register::at(TIMER, 0x2C);
/// Compare registers of the channels.
const COMPARE: usize = TIMER + 0x34;

/// Bit of the overflow in STATUS and INTERRUPTS. The bits of channels 1 and 2 follow.
const ROUND: u32 = 1 << 0;

/// Register that selects the peripherals which stop while a debugger halts the processor (23.16.4).
const FROZEN: Register = Register::at(0xE004_2000, 0x08);

/// Number of overflows.
static ROUNDS: AtomicU32 = AtomicU32::new(0);

/// Starts to count time.
pub(crate) fn start() {
    const _: () = assert!(MHZ.is_multiple_of(16), "a tick is a whole number of cycles");
    const ENABLE: u32 = 1 << 0;
    // With this flag, an update that software requests does not count as an overflow.
    const ONLY_ROUNDS: u32 = 1 << 2;
    const UPDATE: u32 = 1 << 0;
    const TIMER_2: u32 = 1 << 0;
    const WATCHDOG: u32 = 1 << 12;
    FROZEN.set(TIMER_2 | WATCHDOG);
    CONTROL.write(ONLY_ROUNDS);
    PRESCALER.write(MHZ / 16 - 1);
    LAST.write(u32::MAX);
    EVENT.write(UPDATE);
    STATUS.write(0);
    INTERRUPTS.write(ROUND);
    CONTROL.write(ONLY_ROUNDS | ENABLE);
}

/// Ticks since the start.
#[inline]
fn ticks() -> u64 {
    let (rounds, count) = critical_section::with(|_| {
        let (rounds, count) = (ROUNDS.load(Ordering::Relaxed), COUNT.read());
        // If the counter has overflowed, `count` may be from before the overflow.
        if STATUS.read() & ROUND != 0 { (rounds.wrapping_add(1), COUNT.read()) } else { (rounds, count) }
    });
    u64::from(rounds) << 32 | u64::from(count)
}

/// The low half of the ticks since the start, for measuring short times.
#[inline]
pub(crate) fn ticks_low() -> u32 {
    COUNT.read()
}

/// The present time, for timestamps in interrupts.
#[inline]
pub(crate) fn now() -> Instant {
    Instant::from_ticks(ticks())
}

/// The last tick that is over, for the loop: all events with this timestamp are queued, and there will be no
/// more.
pub(crate) fn past() -> Instant {
    Instant::from_ticks(ticks().saturating_sub(1))
}

/// A channel of TIM2.
pub(crate) struct Alarm {
    /// Number of the channel, 1 to 4.
    channel: usize,
    due: Mutex<Cell<Instant>>,
}

impl Alarm {
    /// The channel with this number, not set.
    pub(crate) const fn new(channel: usize) -> Self {
        Self { channel, due: Mutex::new(Cell::new(Instant::NEVER)) }
    }

    /// Bit of the channel in STATUS and INTERRUPTS.
    const fn bit(&self) -> u32 {
        ROUND << self.channel
    }

    /// Schedules the interrupt at `due`; [`Instant::NEVER`] means never. Returns `false` if that time is
    /// already over; then no interrupt is scheduled.
    #[inline]
    pub(crate) fn set(&self, due: Instant) -> bool {
        critical_section::with(|cs| {
            self.due.borrow(cs).set(due);
            // TIM2 compares only the lower half of the time, whenever its count changes. So the alarm fires
            // if `due` is in the future, and additionally fires early if `due` is far in the future.
            Register::at(COMPARE, 4 * (self.channel - 1)).write((due.ticks() & u64::from(u32::MAX)) as u32);
            self.acknowledge();
            let comes = due > now();
            if comes && due != Instant::NEVER {
                INTERRUPTS.set(self.bit());
            } else {
                INTERRUPTS.clear(self.bit());
            }
            comes
        })
    }

    /// Acknowledges the alarm's interrupt.
    #[inline]
    fn acknowledge(&self) {
        STATUS.write(!self.bit());
    }

    /// Acknowledges the alarm's interrupt, and returns whether its time has come. If not, the interrupt will
    /// come again.
    #[inline]
    pub(crate) fn has_come(&self) -> bool {
        if STATUS.read() & INTERRUPTS.read() & self.bit() == 0 {
            return false;
        }
        self.acknowledge();
        let due = critical_section::with(|cs| self.due.borrow(cs).get());
        now() >= due || !self.set(due)
    }
}

/// Alarm that wakes the loop.
pub(crate) static WAKE: Alarm = Alarm::new(2);

#[interrupt]
fn TIM2() {
    if STATUS.read() & ROUND != 0 {
        STATUS.write(!ROUND);
        ROUNDS.store(ROUNDS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
    }
    steps::look();
    // The interrupt has ended the sleep; the loop reads the time. `has_come` sets an alarm again that fired
    // early.
    let _ = WAKE.has_come();
}
