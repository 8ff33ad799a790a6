//! Marks of a program that has its instructions counted by the plugin `insncount`.
//!
//! A program is a list of groups; a group is an operation, done several times:
//!
//! ```text
//! group(c"a step");
//! for _ in 0..1_000 {
//!     count(|| step(&mut walker));
//! }
//! ```
//!
//! The names go to QEMU's output, the counts of the plugin to its log, both in the order of the groups.
#![no_std]

use core::arch::asm;
use core::ffi::{CStr, c_void};
use core::panic::PanicInfo;
use core::ptr;

pub use core::hint::black_box as opaque;

/// Operation of a debugger for the program (ARM IHI 0105, semihosting).
const WRITE0: usize = 0x04;
const EXIT: usize = 0x18;
/// Reason of a program's end.
const APPLICATION_EXIT: *const c_void = ptr::without_provenance(0x20026);
const RUN_TIME_ERROR: *const c_void = ptr::without_provenance(0x20023);

/// Begins a group. Its name is a line.
pub fn group(name: &CStr) {
    semihosting(WRITE0, name.as_ptr().cast());
    semihosting(WRITE0, c"\n".as_ptr().cast());
    // SAFETY: it does nothing.
    unsafe { asm!("mov r9, r9") };
}

/// Runs a part of the group: the instructions of `act` are counted. Call a function there that is not inlined, so
/// that none of it runs outside.
#[inline(always)]
pub fn count<R>(act: impl FnOnce() -> R) -> R {
    // SAFETY: it does nothing, and the compiler moves no access to memory across it.
    unsafe { asm!("mov r10, r10") };
    let result = act();
    // SAFETY: the same.
    unsafe { asm!("mov r11, r11") };
    result
}

/// Ends the program, and QEMU.
pub fn done() -> ! {
    loop {
        semihosting(EXIT, APPLICATION_EXIT);
    }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {
        semihosting(EXIT, RUN_TIME_ERROR);
    }
}

fn semihosting(operation: usize, argument: *const c_void) {
    // SAFETY: QEMU answers this breakpoint; both operations only read what they are given.
    unsafe { asm!("bkpt 0xab", inlateout("r0") operation => _, in("r1") argument) };
}
