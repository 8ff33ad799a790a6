//! Timers that interrupt once (10.6).

use drivetwin_firmware::device::Duration;

use crate::clock::HZ;
use crate::registers::Register;

/// Wakes the loop.
pub(crate) const WAKE: OneShot = OneShot(0x4003_0000);
/// Makes the steps.
pub(crate) const STEP: OneShot = OneShot(0x4003_1000);
/// Polls for the end of the last character on the bus.
pub(crate) const SENT: OneShot = OneShot(0x4003_2000);

/// A general-purpose timer in its 32-bit mode, the only one that QEMU has.
#[derive(Clone, Copy)]
pub(crate) struct OneShot(usize);

impl OneShot {
    /// The longest time that a timer can count, 85 s.
    pub(crate) const LONGEST: Duration = Duration::from_ticks((u32::MAX / 25 * 8) as u64);

    /// Configures the timer. Must be called first.
    pub(crate) fn prepare(self) {
        const ONE_SHOT: u32 = 1;
        self.control().write(0);
        self.register(0x000).write(0);
        self.register(0x004).write(ONE_SHOT);
        self.register(0x018).write(1);
    }

    /// Starts the timer to interrupt after `span`, at most [`LONGEST`](Self::LONGEST).
    pub(crate) fn start(self, span: Duration) {
        const _: () = assert!(HZ == 50_000_000, "25 cycles are 8 ticks");
        let ticks = span.min(Self::LONGEST).ticks() as u32;
        let cycles = ticks / 8 * 25 + (ticks % 8 * 25).div_ceil(8);
        self.control().write(0);
        self.register(0x028).write(cycles.max(1));
        self.control().write(1);
    }

    /// Stops the timer and drops its pending interrupt.
    pub(crate) fn stop(self) {
        self.control().write(0);
        self.acknowledge();
    }

    /// Acknowledges the timer's interrupt.
    pub(crate) fn acknowledge(self) {
        self.register(0x024).write(1);
    }

    const fn control(self) -> Register {
        self.register(0x00C)
    }

    const fn register(self, offset: usize) -> Register {
        Register::at(self.0, offset)
    }
}
