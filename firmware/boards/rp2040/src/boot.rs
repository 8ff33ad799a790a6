//! From the reset to a program in RAM (2.8.1).
//!
//! The boot ROM runs the second stage, which makes the flash readable fast and calls what lies behind it:
//! a few instructions that copy the image to RAM and start it there. From then on flash holds nothing but
//! saved registers, so it can be erased and programmed while interrupts go on, and no miss of its cache
//! delays a step.

use core::arch::global_asm;

/// The second stage, for the flash chip of the Pico and most others.
#[unsafe(link_section = ".boot2")]
#[unsafe(no_mangle)]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;

// The second stage takes the stack pointer and the address to jump to from the first two words.
global_asm!(
    ".section .entry, \"ax\"
     .word _stack_start
     .word _entry

     .global _entry
     .type _entry, %function
     .thumb_func
     _entry:
         ldr r0, =__image_start
         ldr r1, =__image_end
         ldr r2, =__image_load
     0:  ldm r2!, {{r3}}
         stm r0!, {{r3}}
         cmp r0, r1
         blo 0b
         ldr r0, =Reset
         bx r0
     .pool
     .size _entry, . - _entry"
);
