//! The selector of a UF2 with an image of each kind of drive.
#![no_std]
#![no_main]

/// Entry that the boot ROM jumps to, behind the stack pointer (`selector.x`).
#[unsafe(link_section = ".start")]
#[used]
static START: extern "C" fn() -> ! = drivetwin_pico::select;
