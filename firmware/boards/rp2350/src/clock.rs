//! The system clock, from the crystal.

use crate::registers::Register;

/// Frequency of the Pico 2's crystal in MHz.
const CRYSTAL_MHZ: u32 = 12;
/// Cycles of the processor and of the UARTs in a second.
pub(crate) const HZ: u32 = 150_000_000;

/// Registers of the clocks (8.1).
const CLOCKS: usize = 0x4001_0000;
const REF_CTRL: Register = Register::at(CLOCKS, 0x30);
const REF_SELECTED: Register = Register::at(CLOCKS, 0x38);
const SYS_CTRL: Register = Register::at(CLOCKS, 0x3C);
const SYS_SELECTED: Register = Register::at(CLOCKS, 0x44);
const PERI_CTRL: Register = Register::at(CLOCKS, 0x48);

/// Registers of the crystal oscillator (8.2).
const XOSC: usize = 0x4004_8000;
const XOSC_CTRL: Register = Register::at(XOSC, 0x0);
const XOSC_STATUS: Register = Register::at(XOSC, 0x4);
const XOSC_STARTUP: Register = Register::at(XOSC, 0xC);

/// Registers of the tick generators (8.5): the microseconds of TIMER0 and of the watchdog.
const TICKS: usize = 0x4010_8000;
const TIMER_TICK: Register = Register::at(TICKS, 0x18);
const WATCHDOG_TICK: Register = Register::at(TICKS, 0x30);

/// Registers of the PLL of the system clock (8.6).
const PLL: usize = 0x4005_0000;
const PLL_CS: Register = Register::at(PLL, 0x0);
const PLL_PWR: Register = Register::at(PLL, 0x4);
const PLL_FBDIV: Register = Register::at(PLL, 0x8);
const PLL_PRIM: Register = Register::at(PLL, 0xC);

/// Registers of the resets of the peripherals (7.5).
const RESETS: usize = 0x4002_0000;
const RESET: Register = Register::at(RESETS, 0x0);
const RESET_DONE: Register = Register::at(RESETS, 0x8);
const RESET_PLL: u32 = 1 << 14;
/// Resets of IO_BANK0, PADS_BANK0, TIMER0 and UART0.
const RESET_REST: u32 = 1 << 6 | 1 << 9 | 1 << 23 | 1 << 26;

/// Runs the processor at 150 MHz from the crystal, starts the microsecond ticks, and resets the peripherals.
pub(crate) fn start() {
    const STABLE: u32 = 1 << 31;
    const LOCKED: u32 = 1 << 31;
    const FROM_CRYSTAL: u32 = 2;
    const FROM_PLL: u32 = 1;
    const ENABLED: u32 = 1 << 11;

    // Range 1 to 15 MHz, enabled. The crystal is stable after 5 ms; the unit of the register is 256 cycles.
    XOSC_STARTUP.write(CRYSTAL_MHZ * 5_000 / 256);
    XOSC_CTRL.write(0xFAB << 12 | 0xAA0);
    while XOSC_STATUS.read() & STABLE == 0 {}

    // Switches from the PLL, which may run after a debugger's reset, to the crystal.
    SYS_CTRL.clear(FROM_PLL);
    while SYS_SELECTED.read() != 1 {}
    REF_CTRL.write(FROM_CRYSTAL);
    while REF_SELECTED.read() != 1 << FROM_CRYSTAL {}
    tick(TIMER_TICK);
    tick(WATCHDOG_TICK);

    // 12 MHz × 125 = 1,500 MHz, / 5 / 2 = 150 MHz (8.6).
    reset(RESET_PLL);
    PLL_CS.write(1);
    PLL_FBDIV.write(125);
    PLL_PWR.clear(1 << 0 | 1 << 5);
    while PLL_CS.read() & LOCKED == 0 {}
    PLL_PRIM.write(5 << 16 | 2 << 12);
    PLL_PWR.clear(1 << 3);

    SYS_CTRL.write(0);
    SYS_CTRL.set(FROM_PLL);
    while SYS_SELECTED.read() != 1 << FROM_PLL {}
    PERI_CTRL.write(ENABLED);
    reset(RESET_REST);
}

/// Starts a tick of a microsecond. The number of cycles is in the register after that which enables the tick.
fn tick(enable: Register) {
    enable.write(0);
    enable.plus(4).write(CRYSTAL_MHZ);
    enable.write(1);
}

fn reset(peripherals: u32) {
    RESET.set(peripherals);
    RESET.clear(peripherals);
    while !RESET_DONE.read() & peripherals != 0 {}
}
