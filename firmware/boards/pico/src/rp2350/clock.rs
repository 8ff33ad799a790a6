//! The clocks, from the crystal: that of the system, and that of USB.

use crate::pll::start_pll;
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
const USB_CTRL: Register = Register::at(CLOCKS, 0x60);

/// Enables PERI_CTRL's or USB_CTRL's clock, from the system clock or from the PLL of USB.
const ENABLED: u32 = 1 << 11;

/// Registers of the crystal oscillator (8.2).
const XOSC: usize = 0x4004_8000;
const XOSC_CTRL: Register = Register::at(XOSC, 0x0);
const XOSC_STATUS: Register = Register::at(XOSC, 0x4);
const XOSC_STARTUP: Register = Register::at(XOSC, 0xC);

/// Registers of the tick generators (8.5): the microseconds of TIMER0 and of the watchdog.
const TICKS: usize = 0x4010_8000;
const TIMER_TICK: Register = Register::at(TICKS, 0x18);
const WATCHDOG_TICK: Register = Register::at(TICKS, 0x30);

/// Registers of the PLLs of the system clock and of USB (8.6).
const PLL_SYS: usize = 0x4005_0000;
const PLL_USB: usize = 0x4005_8000;

/// Registers of the resets of the peripherals (7.5).
const RESETS: usize = 0x4002_0000;
const RESET: Register = Register::at(RESETS, 0x0);
const RESET_DONE: Register = Register::at(RESETS, 0x8);
const RESET_PLL_SYS: u32 = 1 << 14;
const RESET_PLL_USB: u32 = 1 << 15;
const RESET_USB: u32 = 1 << 28;
/// Resets of IO_BANK0, PADS_BANK0, TIMER0 and UART0.
const RESET_REST: u32 = 1 << 6 | 1 << 9 | 1 << 23 | 1 << 26;

/// Runs the processor at 150 MHz from the crystal, starts the microsecond ticks, and resets the peripherals.
pub(crate) fn start() {
    const STABLE: u32 = 1 << 31;
    const FROM_CRYSTAL: u32 = 2;
    const FROM_PLL: u32 = 1;

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
    reset(RESET_PLL_SYS);
    start_pll(PLL_SYS, 125, [5, 2]);

    SYS_CTRL.write(0);
    SYS_CTRL.set(FROM_PLL);
    while SYS_SELECTED.read() != 1 << FROM_PLL {}
    PERI_CTRL.write(ENABLED);
    reset(RESET_REST);
}

/// Starts the clock of USB, and resets the USB controller. The clock of the system is faster than that of USB, as the
/// controller needs it.
pub(crate) fn start_usb() {
    // 12 MHz × 100 = 1,200 MHz, / 5 / 5 = 48 MHz (8.6).
    reset(RESET_PLL_USB);
    start_pll(PLL_USB, 100, [5, 5]);
    USB_CTRL.write(ENABLED);
    reset(RESET_USB);
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
