//! The start of the processor, up to a program in RAM.

/// Puts at the beginning of flash, where the processor starts: the stack pointer, the address to jump to, and
/// a few instructions that copy the image to RAM and start it there. After that, flash contains only saved
/// registers. It can be erased and programmed while interrupts continue, although nothing in flash can be
/// fetched meanwhile (BOARD-3).
///
/// The linker script sets where the image runs and where it is loaded.
#[macro_export]
macro_rules! run_from_ram {
    () => {
        core::arch::global_asm!(
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
    };
}
