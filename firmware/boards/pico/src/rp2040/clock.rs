//! The clocks, from the crystal: that of the system, and that of USB.

use cortex_m::asm;

use super::WATCHDOG;
use crate::pll::start_pll;
use crate::registers::Register;

/// Frequency of the Pico's crystal in MHz.
const CRYSTAL_MHZ: u32 = 12;
/// Cycles of the processor and of the UARTs in a second.
pub(crate) const HZ: u32 = 200_000_000;

/// Registers of the clocks (2.15.7).
const CLOCKS: usize = 0x4000_8000;
const REF_CTRL: Register = Register::at(CLOCKS, 0x30);
const REF_SELECTED: Register = Register::at(CLOCKS, 0x38);
const SYS_CTRL: Register = Register::at(CLOCKS, 0x3C);
const SYS_SELECTED: Register = Register::at(CLOCKS, 0x44);
const PERI_CTRL: Register = Register::at(CLOCKS, 0x48);
const USB_CTRL: Register = Register::at(CLOCKS, 0x54);

/// Enables PERI_CTRL's or USB_CTRL's clock, from the system clock or from the PLL of USB.
const ENABLED: u32 = 1 << 11;

/// Registers of the crystal oscillator (2.16.7).
const XOSC: usize = 0x4002_4000;
const XOSC_CTRL: Register = Register::at(XOSC, 0x0);
const XOSC_STATUS: Register = Register::at(XOSC, 0x4);
const XOSC_STARTUP: Register = Register::at(XOSC, 0xC);

/// Register of the voltage regulator of the core (2.10.6).
const VREG: Register = Register::at(0x4006_4000, 0x0);

/// Registers of the PLLs of the system clock and of USB (2.18.4).
const PLL_SYS: usize = 0x4002_8000;
const PLL_USB: usize = 0x4002_C000;

/// Registers of the resets of the peripherals (2.14.3).
const RESETS: usize = 0x4000_C000;
const RESET: Register = Register::at(RESETS, 0x0);
const RESET_DONE: Register = Register::at(RESETS, 0x8);
const RESET_PLL_SYS: u32 = 1 << 12;
const RESET_PLL_USB: u32 = 1 << 13;
/// Resets of USBCTRL, and of SYSINFO, which knows the revision of the chip.
const RESET_USB: u32 = 1 << 24 | 1 << 19;
/// Resets of IO_BANK0, PADS_BANK0, TIMER and UART0.
const RESET_REST: u32 = 1 << 5 | 1 << 8 | 1 << 21 | 1 << 22;

/// Runs the processor at 200 MHz from the crystal, for which the core needs 1.15 V (2.15.3, BOARD-17), starts the microsecond tick, and resets the peripherals.
pub(crate) fn start() {
    const STABLE: u32 = 1 << 31;
    const FROM_CRYSTAL: u32 = 2;
    const FROM_PLL: u32 = 1;
    /// Register of the watchdog that starts the tick of TIMER (4.7.6).
    const TICK: usize = 0x2C;
    const RUN: u32 = 1 << 9;
    /// 1.15 V, enabled.
    const VOLTAGE: u32 = 12 << 4 | 1;

    // Range 1 to 15 MHz, enabled. The crystal is stable after 5 ms; the unit of the register is 256 cycles.
    XOSC_STARTUP.write(CRYSTAL_MHZ * 5_000 / 256);
    XOSC_CTRL.write(0xFAB << 12 | 0xAA0);
    while XOSC_STATUS.read() & STABLE == 0 {}

    // Switches from the PLL, which may run after a debugger's reset, to the crystal.
    SYS_CTRL.clear(FROM_PLL);
    while SYS_SELECTED.read() != 1 {}
    REF_CTRL.write(FROM_CRYSTAL);
    while REF_SELECTED.read() != 1 << FROM_CRYSTAL {}
    WATCHDOG.plus(TICK).write(CRYSTAL_MHZ | RUN);

    VREG.write(VOLTAGE);
    // 1 ms for the regulator.
    asm::delay(CRYSTAL_MHZ * 1_000);

    // 12 MHz × 100 = 1,200 MHz, / 6 / 1 = 200 MHz (2.18.3).
    reset(RESET_PLL_SYS);
    start_pll(PLL_SYS, 100, [6, 1]);

    SYS_CTRL.write(0);
    SYS_CTRL.set(FROM_PLL);
    while SYS_SELECTED.read() != 1 << FROM_PLL {}
    PERI_CTRL.write(ENABLED);
    reset(RESET_REST);
}

/// Starts the clock of USB, and resets the USB controller.
pub(crate) fn start_usb() {
    // 12 MHz × 100 = 1,200 MHz, / 5 / 5 = 48 MHz (2.18.3).
    reset(RESET_PLL_USB);
    start_pll(PLL_USB, 100, [5, 5]);
    USB_CTRL.write(ENABLED);
    reset(RESET_USB);
}

fn reset(peripherals: u32) {
    RESET.set(peripherals);
    RESET.clear(peripherals);
    while !RESET_DONE.read() & peripherals != 0 {}
}
