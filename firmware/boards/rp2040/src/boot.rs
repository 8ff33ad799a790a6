//! From the reset to a program in RAM (2.8.1).
//!
//! The boot ROM runs the second stage, which makes the flash readable fast, takes the stack pointer and the address to
//! jump to from the first two words after it, and jumps there. No miss of the flash's cache delays a step
//! of a program in RAM.

/// The second stage, for the flash chip of the Pico and most others.
#[unsafe(link_section = ".boot2")]
#[unsafe(no_mangle)]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

drivetwin_board::run_from_ram!();
