//! The clocks, derived from the crystal.

use crate::registers::Register;

/// Cycles of the processor in a microsecond. The timer has the same clock, and six cycles are a tick of
/// drivetwin's time. The chip could do 100 MHz, but that is not a multiple of 16.
pub(crate) const MHZ: u32 = 96;
/// Frequency of the Black Pill's crystal in MHz.
const CRYSTAL_MHZ: u32 = 25;

/// Registers of reset and clock control (6.3).
const RCC: usize = 0x4002_3800;
const CONTROL: Register = Register::at(RCC, 0x00);
const PLL: Register = Register::at(RCC, 0x04);
const CONFIGURATION: Register = Register::at(RCC, 0x08);
/// Resets of USB, and its clock gate.
const AHB2_RESETS: Register = Register::at(RCC, 0x14);
const AHB2_GATES: Register = Register::at(RCC, 0x34);
/// Clock gates of the ports.
const AHB1_GATES: Register = Register::at(RCC, 0x30);
/// Clock gates of TIM2 and of the power control.
const APB1_GATES: Register = Register::at(RCC, 0x40);
/// Clock gates of USART1 and of SYSCFG.
const APB2_GATES: Register = Register::at(RCC, 0x44);

/// Voltage of the core (5.4.1).
const POWER: Register = Register::at(0x4000_7000, 0x00);
/// Wait states of the flash (3.8.1).
const FLASH: Register = Register::at(0x4002_3C00, 0x00);

/// Prescaler of the bus of USART1, as coded in the configuration.
const APB2_PRESCALER: u32 = 0b111 << 13;
const APB2_BY_4: u32 = 0b101 << 13;

/// Runs the processor at 96 MHz from the crystal, and enables the clocks of the peripherals.
pub(crate) fn start() {
    const INTERNAL_ON: u32 = 1 << 0;
    const INTERNAL_READY: u32 = 1 << 1;
    const CRYSTAL_ON: u32 = 1 << 16;
    const CRYSTAL_READY: u32 = 1 << 17;
    const PLL_ON: u32 = 1 << 24;
    const PLL_READY: u32 = 1 << 25;
    const SELECTED: u32 = 0b11 << 2;
    const FROM_PLL: u32 = 0b10;
    const APB1_BY_2: u32 = 0b100 << 10;
    const PREFETCH: u32 = 1 << 8;
    const INSTRUCTION_CACHE: u32 = 1 << 9;

    // Switches from the PLL, which the boot loader of the chip may have left running, to the internal
    // oscillator.
    CONTROL.set(INTERNAL_ON);
    while CONTROL.read() & INTERNAL_READY == 0 {}
    CONFIGURATION.write(0);
    while CONFIGURATION.read() & SELECTED != 0 {}
    CONTROL.clear(PLL_ON);
    while CONTROL.read() & PLL_READY != 0 {}
    CONTROL.set(CRYSTAL_ON);
    while CONTROL.read() & CRYSTAL_READY == 0 {}

    AHB1_GATES.set(0b111);
    APB1_GATES.set(1 << 0 | 1 << 28);
    APB2_GATES.set(1 << 4 | 1 << 14);
    // A clock gate needs two cycles of its bus before the registers behind it answer (6.2.11).
    let _ = APB1_GATES.read();
    // More than 84 MHz need the highest voltage, more than 90 MHz three wait states.
    POWER.set(0b11 << 14);
    // Prefetch, and the cache for instructions. No cache for data, because cached data may have been erased since.
    FLASH.write(INSTRUCTION_CACHE | PREFETCH | 3);
    // 25 MHz / 25 = 1 MHz; × 192 = 192 MHz; / 2 = 96 MHz. The USB clock is 192 MHz / 4 = 48 MHz.
    PLL.write(4 << 24 | 1 << 22 | (2 * MHZ) << 6 | CRYSTAL_MHZ);
    CONTROL.set(PLL_ON);
    while CONTROL.read() & PLL_READY == 0 {}
    // APB1 allows up to 50 MHz. A timer on it counts at twice its clock (6.2).
    CONFIGURATION.write(APB1_BY_2 | FROM_PLL);
    while CONFIGURATION.read() & SELECTED != FROM_PLL << 2 {}
}

/// Enables the clock of the USB controller, and resets the controller, which the boot loader of the chip may have left
/// running.
pub(crate) fn start_usb() {
    const USB: u32 = 1 << 7;
    AHB2_GATES.set(USB);
    // As above.
    let _ = AHB2_GATES.read();
    AHB2_RESETS.set(USB);
    AHB2_RESETS.clear(USB);
}

/// Divides the clock of USART1 by four, or not. This only makes accesses to other peripherals on the same bus
/// slower.
pub(crate) fn divide_uart(by_4: bool) {
    CONFIGURATION.replace(APB2_PRESCALER, if by_4 { APB2_BY_4 } else { 0 });
}

/// Reason of the last reset, as bits of RCC_CSR (6.3.20). Clears these bits.
#[cfg(feature = "defmt")]
pub(crate) fn take_reset() -> u32 {
    const STATUS: Register = Register::at(RCC, 0x74);
    const FORGET: u32 = 1 << 24;
    let causes = STATUS.read();
    STATUS.set(FORGET);
    causes
}
