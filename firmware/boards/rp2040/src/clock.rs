//! The system clock, the time since it started, alarms and sleep.
//!
//! TIMER counts microseconds (4.6), and so all that this board does or stamps is rounded to them.

use core::cell::Cell;

use cortex_m::asm;
use critical_section::Mutex;
use rp2040_pac::{Interrupt, interrupt};
use standin_firmware::device::Instant;

use crate::registers::Register;
use crate::{caught, watchdog};

/// The Pico's crystal.
pub(crate) const CRYSTAL_MHZ: u32 = 12;
/// Cycles in a second, of the processor and of the UARTs.
pub(crate) const HZ: u32 = 125_000_000;

/// Ticks of standin's time in a microsecond.
const TICKS: u64 = 16;

/// Clocks (2.15.7).
const CLOCKS: usize = 0x4000_8000;
const REF_CTRL: Register = Register::at(CLOCKS, 0x30);
const REF_SELECTED: Register = Register::at(CLOCKS, 0x38);
const SYS_CTRL: Register = Register::at(CLOCKS, 0x3C);
const SYS_SELECTED: Register = Register::at(CLOCKS, 0x44);
const PERI_CTRL: Register = Register::at(CLOCKS, 0x48);

/// Crystal oscillator (2.16.7).
const XOSC: usize = 0x4002_4000;
const XOSC_CTRL: Register = Register::at(XOSC, 0x0);
const XOSC_STATUS: Register = Register::at(XOSC, 0x4);
const XOSC_STARTUP: Register = Register::at(XOSC, 0xC);

/// The PLL of the system clock (2.18.4).
const PLL: usize = 0x4002_8000;
const PLL_CS: Register = Register::at(PLL, 0x0);
const PLL_PWR: Register = Register::at(PLL, 0x4);
const PLL_FBDIV: Register = Register::at(PLL, 0x8);
const PLL_PRIM: Register = Register::at(PLL, 0xC);

/// Resets of the peripherals (2.14.3).
const RESETS: usize = 0x4000_C000;
const RESET: Register = Register::at(RESETS, 0x0);
const RESET_DONE: Register = Register::at(RESETS, 0x8);
const RESET_PLL: u32 = 1 << 12;
/// IO_BANK0, PADS_BANK0, TIMER, UART0.
const RESET_REST: u32 = 1 << 5 | 1 << 8 | 1 << 21 | 1 << 22;

/// TIMER (4.6.5).
const TIMER: usize = 0x4005_4000;
const ALARM: usize = TIMER + 0x10;
const ARMED: Register = Register::at(TIMER, 0x20);
const RAW_HIGH: Register = Register::at(TIMER, 0x24);
const RAW_LOW: Register = Register::at(TIMER, 0x28);
const INTR: Register = Register::at(TIMER, 0x34);
const INTE: Register = Register::at(TIMER, 0x38);

/// Runs the processor at 125 MHz from the crystal, resets the peripherals, and starts to count.
pub(crate) fn start() {
    const STABLE: u32 = 1 << 31;
    const LOCKED: u32 = 1 << 31;
    const FROM_CRYSTAL: u32 = 2;
    const FROM_PLL: u32 = 1;
    const ENABLED: u32 = 1 << 11;

    // 1 to 15 MHz, enabled. Stable after 5 ms, in units of 256 cycles.
    XOSC_STARTUP.write(CRYSTAL_MHZ * 5_000 / 256);
    XOSC_CTRL.write(0xFAB << 12 | 0xAA0);
    while XOSC_STATUS.read() & STABLE == 0 {}

    // Away from the PLL, as after a debugger's reset, and on to the crystal.
    SYS_CTRL.clear(FROM_PLL);
    while SYS_SELECTED.read() != 1 {}
    REF_CTRL.write(FROM_CRYSTAL);
    while REF_SELECTED.read() != 1 << FROM_CRYSTAL {}
    watchdog::tick();

    // 12 MHz × 125 = 1,500 MHz, / 6 / 2 = 125 MHz (2.18.3).
    reset(RESET_PLL);
    PLL_CS.write(1);
    PLL_FBDIV.write(125);
    PLL_PWR.clear(1 << 0 | 1 << 5);
    while PLL_CS.read() & LOCKED == 0 {}
    PLL_PRIM.write(6 << 16 | 2 << 12);
    PLL_PWR.clear(1 << 3);

    SYS_CTRL.write(0);
    SYS_CTRL.set(FROM_PLL);
    while SYS_SELECTED.read() != 1 << FROM_PLL {}
    PERI_CTRL.write(ENABLED);
    reset(RESET_REST);
    INTE.write(0b111);
}

fn reset(peripherals: u32) {
    RESET.set(peripherals);
    RESET.clear(peripherals);
    while !RESET_DONE.read() & peripherals != 0 {}
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

/// The low half of [`micros`]: for spans.
#[inline]
pub(crate) fn micros_low() -> u32 {
    RAW_LOW.read()
}

/// Now, as interrupts stamp it.
#[inline]
pub(crate) fn now() -> Instant {
    Instant::from_ticks(micros() * TICKS)
}

/// The end of the last whole microsecond, for the loop: all that bears this stamp has been caught, and
/// nothing more will be.
pub(crate) fn past() -> Instant {
    Instant::from_ticks((micros() * TICKS).saturating_sub(1))
}

/// The microsecond nearest to `at`; [`u64::MAX`] at [`Instant::NEVER`].
#[inline]
pub(crate) fn nearest(at: Instant) -> u64 {
    if at == Instant::NEVER { u64::MAX } else { at.ticks().saturating_add(TICKS / 2) / TICKS }
}

/// An alarm of TIMER.
pub(crate) struct Alarm {
    number: usize,
    /// What it is set to, in µs.
    due: Mutex<Cell<u64>>,
}

impl Alarm {
    /// TIMER's alarm of that number, not set.
    pub(crate) const fn new(number: usize) -> Self {
        Self { number, due: Mutex::new(Cell::new(u64::MAX)) }
    }

    /// Asks for the interrupt at `micros`, never at [`u64::MAX`]. `false` if that has gone by: then it does
    /// not come.
    #[inline]
    pub(crate) fn set(&self, micros: u64) -> bool {
        critical_section::with(|cs| self.due.borrow(cs).set(micros));
        INTR.write(1 << self.number);
        if micros == u64::MAX {
            ARMED.write(1 << self.number);
            return true;
        }
        // TIMER compares the lower half, when it changes: it comes if this still lies ahead, and now and
        // then before if it is far.
        Register::at(ALARM, 4 * self.number).write(micros as u32);
        let comes = self::micros() < micros;
        if !comes {
            ARMED.write(1 << self.number);
            INTR.write(1 << self.number);
        }
        comes
    }

    /// What its interrupt asks first: whether what it was set to has come. Else it will come again.
    #[inline]
    pub(crate) fn has_come(&self) -> bool {
        INTR.write(1 << self.number);
        let due = critical_section::with(|cs| self.due.borrow(cs).get());
        micros() >= due || !self.set(due)
    }
}

/// Wakes the loop.
static WAKE: Alarm = Alarm::new(1);

/// Sleeps until something was caught, or until [`past`] is `deadline`.
#[inline(never)]
#[unsafe(no_mangle)]
pub(crate) fn sleep_until(deadline: Instant) {
    /// It wakes that often to feed the watchdog, in µs.
    const NAP: u64 = 250_000;
    let due = deadline.ticks() / TICKS + 1;
    while micros() < due && !caught::is_there() {
        watchdog::feed();
        // An interrupt that is kept out ends the sleep, so none is missed between the look and the sleep.
        critical_section::with(|_| {
            if !caught::is_there() && WAKE.set(due.min(micros() + NAP)) {
                asm::wfi();
            }
        });
    }
}

#[interrupt]
fn TIMER_IRQ_1() {
    WAKE.has_come();
}

/// Interrupts of this crate, each with its priority.
pub(crate) fn unmask(nvic: &mut cortex_m::peripheral::NVIC) {
    let priorities = [
        (Interrupt::TIMER_IRQ_0, 0x00),
        (Interrupt::UART0_IRQ, 0x40),
        (Interrupt::IO_IRQ_BANK0, 0x40),
        (Interrupt::TIMER_IRQ_2, 0x40),
        (Interrupt::TIMER_IRQ_1, 0xC0),
    ];
    for (interrupt, priority) in priorities {
        // SAFETY: no critical section of this crate relies on priorities.
        unsafe { nvic.set_priority(interrupt, priority) };
        // SAFETY: none relies on the interrupt's mask.
        unsafe { cortex_m::peripheral::NVIC::unmask(interrupt) };
    }
}
