//! From the reset to a program in RAM (2.4).
//!
//! The processor takes the stack and the first instruction from the beginning of the flash. What is there copies the
//! image to RAM and starts it. From then on flash holds nothing but saved registers, so it can be erased and
//! programmed, when nothing in it can be fetched, while interrupts go on.

use core::arch::global_asm;

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
