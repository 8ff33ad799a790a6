//! The way from the reset to a program in RAM (2.8.1).
//!
//! The boot ROM runs the second stage. The second stage makes fast reads of the flash possible, takes the
//! stack pointer and the start address from the first two words after itself, and jumps to that address.
//! Because the program runs from RAM, no miss of the flash's cache delays a step.

/// The second stage, for the flash chip of the Pico and most others.
#[unsafe(link_section = ".boot2")]
#[unsafe(no_mangle)]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

drivetwin_board::run_from_ram!();
