//! The system clock, the time since it started, and sleep.
//!
//! SysTick counts milliseconds and the cycles inside one; TIMER0 wakes the loop at a deadline. Time
//! is not read from a TIMER: QEMU's do not show their count.

use core::cell::Cell;

use cortex_m::asm;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{NVIC, SCB, SYST};
use cortex_m_rt::exception;
use critical_section::Mutex;
use lm3s6965::{Interrupt, interrupt};
use standin_firmware::device::{Duration, Instant};

use crate::registers::Register;

/// Cycles in a second.
pub(crate) const HZ: u32 = 50_000_000;
const CYCLES_PER_MS: u32 = HZ / 1_000;

/// System control (5.5).
const SYSTEM: usize = 0x400F_E000;
const RIS: Register = Register::at(SYSTEM, 0x050);
const RCC: Register = Register::at(SYSTEM, 0x060);
/// Clock gates of UART0, UART1, TIMER0.
const RCGC1: Register = Register::at(SYSTEM, 0x104);
/// Clock gates of the ports A, B, D, F.
const RCGC2: Register = Register::at(SYSTEM, 0x108);

/// General-purpose timer (10.6).
const TIMER0: usize = 0x4003_0000;
const TIMER0_CFG: Register = Register::at(TIMER0, 0x000);
const TIMER0_TAMR: Register = Register::at(TIMER0, 0x004);
const TIMER0_CTL: Register = Register::at(TIMER0, 0x00C);
const TIMER0_IMR: Register = Register::at(TIMER0, 0x018);
const TIMER0_ICR: Register = Register::at(TIMER0, 0x024);
const TIMER0_TAILR: Register = Register::at(TIMER0, 0x028);

/// Whole milliseconds since the start.
static MILLISECONDS: Mutex<Cell<u64>> = Mutex::new(Cell::new(0));

/// Runs the processor at 50 MHz from the board's crystal of 8 MHz, gives the peripherals their
/// clock, and starts to count.
pub(crate) fn start(systick: &mut SYST) {
    const BYPASS: u32 = 1 << 11;
    const POWER_DOWN: u32 = 1 << 13;
    const USE_DIVIDER: u32 = 1 << 22;
    const BY_FOUR: u32 = 3 << 23;
    const CRYSTAL_8_MHZ: u32 = 0xE << 6;
    const LOCKED: u32 = 1 << 6;
    // The sequence of 5.3: away from the PLL, configure it, wait until it locks, back to it.
    RCC.set(BYPASS);
    RCC.write(BY_FOUR | USE_DIVIDER | BYPASS | CRYSTAL_8_MHZ | POWER_DOWN);
    RCC.clear(POWER_DOWN);
    while RIS.read() & LOCKED == 0 {}
    RCC.clear(BYPASS);
    RCGC1.set(1 << 0 | 1 << 1 | 1 << 16);
    RCGC2.set(1 << 0 | 1 << 1 | 1 << 3 | 1 << 5);

    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(CYCLES_PER_MS - 1);
    systick.clear_current();
    systick.enable_interrupt();
    systick.enable_counter();

    TIMER0_CTL.write(0);
    TIMER0_CFG.write(0);
    TIMER0_TAMR.write(1);
    TIMER0_IMR.write(1);
    // SAFETY: the interrupt only acknowledges itself; no critical section of this crate relies on
    // its mask.
    unsafe { NVIC::unmask(Interrupt::TIMER_0A) };
}

/// Now.
pub(crate) fn now() -> Instant {
    let (milliseconds, left) = critical_section::with(|cs| {
        let milliseconds = MILLISECONDS.borrow(cs).get();
        let left = SYST::get_current();
        // A millisecond that is over and not yet counted.
        if SCB::is_pendst_pending() { (milliseconds + 1, SYST::get_current()) } else { (milliseconds, left) }
    });
    // SysTick counts down, and its interrupt comes when it reaches 0.
    let cycles = if left == 0 { 0 } else { CYCLES_PER_MS.saturating_sub(left) };
    // 16 ticks in a microsecond, 50 cycles.
    Instant::from(Duration::millis(milliseconds)) + Duration::from_ticks(u64::from(cycles * 8 / 25))
}

/// Waits for an interrupt, at most until `deadline`. One that comes between the last look and here
/// is not missed: it leaves an event behind, and `wfe` returns at once.
pub(crate) fn sleep_until(deadline: Instant) {
    // 50 cycles in a microsecond, 16 ticks; the longest the timer can wait is 85 s.
    let ticks = deadline.since(now()).ticks().min(u64::from(u32::MAX / 25 * 8)) as u32;
    let cycles = ticks / 8 * 25 + (ticks % 8 * 25).div_ceil(8);
    if cycles > 0 {
        TIMER0_CTL.write(0);
        TIMER0_TAILR.write(cycles);
        TIMER0_CTL.write(1);
        asm::wfe();
    }
}

#[interrupt]
fn TIMER_0A() {
    TIMER0_ICR.write(1);
}

#[exception]
fn SysTick() {
    critical_section::with(|cs| {
        let milliseconds = MILLISECONDS.borrow(cs);
        milliseconds.set(milliseconds.get().wrapping_add(1));
    });
}
