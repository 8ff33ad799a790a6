//! The system clock, the time since it started, and sleep.
//!
//! SysTick counts cycles, and its interrupt counts periods of SysTick. A general-purpose timer wakes the loop
//! at a deadline. Such a timer cannot tell the time, because those of QEMU do not show their count.

use core::cell::Cell;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::asm;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_rt::exception;
use critical_section::Mutex;
use drivetwin_firmware::device::{Duration, Instant};
use lm3s6965::interrupt;

use crate::registers::Register;
use crate::timer::{SENT, STEP, WAKE};
use crate::{Evaluation, ethernet, watchdog};

/// Cycles in a microsecond, and cycles in a second.
pub(crate) const MHZ: u32 = 50;
pub(crate) const HZ: u32 = 1_000_000 * MHZ;
/// Cycles in a period of SysTick, 0.1 s. SysTick can count to 2^24.
const PERIOD: u32 = HZ / 10;

/// Registers of system control (5.5).
const SYSTEM: usize = 0x400F_E000;
const RIS: Register = Register::at(SYSTEM, 0x050);
const RCC: Register = Register::at(SYSTEM, 0x060);
/// Clock gate of the watchdog.
const RCGC0: Register = Register::at(SYSTEM, 0x100);
/// Clock gates of UART0, UART1, and the timers 0 to 2.
const RCGC1: Register = Register::at(SYSTEM, 0x104);
/// Clock gates of the ports A to G, and of the Ethernet controller.
const RCGC2: Register = Register::at(SYSTEM, 0x108);
/// The board's Ethernet address, three bytes in each.
const USER_REG0: Register = Register::at(SYSTEM, 0x1E0);
const USER_REG1: Register = Register::at(SYSTEM, 0x1E4);

/// Whole periods of SysTick since the start. A debugger finds this variable by its exported name.
#[unsafe(export_name = "PERIODS")]
static PERIODS: Mutex<Cell<u64>> = Mutex::new(Cell::new(0));

/// Number of sleeps, from any number on: the start-up code leaves this word alone. A debugger that watches it stops the
/// board before each sleep.
#[unsafe(export_name = "SLEEPS")]
#[unsafe(link_section = ".uninit.SLEEPS")]
static SLEEPS: AtomicU32 = AtomicU32::new(0);

/// Runs the processor at 50 MHz from the board's 8 MHz crystal, enables the clocks of the peripherals, and
/// starts to count time.
pub(crate) fn start(systick: &mut SYST) {
    const BYPASS: u32 = 1 << 11;
    const POWER_DOWN: u32 = 1 << 13;
    const USE_DIVIDER: u32 = 1 << 22;
    const BY_FOUR: u32 = 3 << 23;
    const CRYSTAL_8_MHZ: u32 = 0xE << 6;
    const LOCKED: u32 = 1 << 6;
    // The sequence of 5.3: switch from the PLL to its bypass, configure the PLL, wait until it locks, switch
    // back.
    RCC.set(BYPASS);
    RCC.write(BY_FOUR | USE_DIVIDER | BYPASS | CRYSTAL_8_MHZ | POWER_DOWN);
    RCC.clear(POWER_DOWN);
    while RIS.read() & LOCKED == 0 {}
    RCC.clear(BYPASS);
    RCGC0.set(1 << 3);
    RCGC1.set(0b11 | 0b111 << 16);
    RCGC2.set(0b111_1111);

    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(PERIOD - 1);
    systick.clear_current();
    systick.enable_interrupt();
    systick.enable_counter();

    for timer in [WAKE, STEP, SENT] {
        timer.prepare();
    }
}

/// Enables the clock of the Ethernet controller. Returns the Ethernet address that the board was made with
/// (5.5). A board made without an address reads all ones, and gets a locally administered address.
pub(crate) fn give_ethernet_its_clock() -> [u8; 6] {
    const CONTROLLER: u32 = 1 << 28;
    const TRANSCEIVER: u32 = 1 << 30;
    RCGC2.set(CONTROLLER | TRANSCEIVER);
    let [a, b, c, _] = USER_REG0.read().to_le_bytes();
    let [d, e, f, _] = USER_REG1.read().to_le_bytes();
    match [a, b, c, d, e, f] {
        [0xFF, 0xFF, 0xFF, ..] => *b"\x02sta-n",
        address => address,
    }
}

/// The present time; may be called in interrupts, too. The priority of SysTick is above or equal to that of
/// the others, so a period that has ended is either still pending or already counted.
pub(crate) fn now() -> Instant {
    /// 50 cycles are 16 ticks.
    const TICKS: u64 = ticks(PERIOD);
    const _: () = assert!(HZ == 50_000_000 && ticks(PERIOD) == Duration::millis(100).ticks());
    let (periods, left) = critical_section::with(|cs| {
        let counted = PERIODS.borrow(cs).get();
        let left = SYST::get_current();
        // If a period has ended, `left` may have been read before its end.
        if SCB::is_pendst_pending() { (counted + 1, SYST::get_current()) } else { (counted, left) }
    });
    // A period begins at 0. SysTick continues from its greatest value.
    let cycles = if left == 0 { 0 } else { PERIOD.saturating_sub(left) };
    Instant::from_ticks(periods * TICKS + ticks(cycles))
}

/// Whole ticks in `cycles` of a period.
const fn ticks(cycles: u32) -> u64 {
    (cycles * 8 / 25) as u64
}

/// Cycles since SysTick showed `from`, less than a period ago.
pub(crate) fn cycles_since(from: u32) -> u32 {
    let left = SYST::get_current();
    if left <= from { from - left } else { from + PERIOD - left }
}

/// Sleeps until an event is queued, the bus has room again, a frame was received, or `deadline` has come, but
/// no longer than the watchdog allows. Steps alone do not end the sleep. A debugger finds this function by
/// its exported name.
#[inline(never)]
#[unsafe(export_name = "sleep_until")]
pub(crate) fn sleep_until(deadline: Instant) {
    let deadline = deadline.min(now() + watchdog::NAP);
    WAKE.start(deadline.since(now()));
    loop {
        // An interrupt between the check and the sleep ends the sleep, and is handled when interrupts are
        // enabled again.
        cortex_m::interrupt::disable();
        let woken = drivetwin_board::is_awake::<Evaluation>() || ethernet::take_frames();
        let over = woken || now() >= deadline;
        if !over {
            SLEEPS.store(SLEEPS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
            asm::wfi();
        }
        // SAFETY: only the loop calls this function, and never in a critical section.
        unsafe { cortex_m::interrupt::enable() };
        if over {
            return;
        }
    }
}

#[interrupt]
fn TIMER_0A() {
    WAKE.acknowledge();
}

#[exception]
fn SysTick() {
    critical_section::with(|cs| {
        let periods = PERIODS.borrow(cs);
        periods.set(periods.get().wrapping_add(1));
    });
}
