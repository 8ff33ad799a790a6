//! Marks in a program for the plugin `insncount`, which counts the program's instructions.
//!
//! A program consists of groups. A group is one operation, done several times:
//!
//! ```text
//! group(c"a step");
//! for _ in 0..1_000 {
//!     count(|| step(&mut walker));
//! }
//! ```
//!
//! QEMU prints the names to its output, and the plugin prints the counts to its log, both in the order of the
//! groups.
#![no_std]

use core::arch::asm;
use core::ffi::{CStr, c_void};
use core::panic::PanicInfo;
use core::ptr;

pub use core::hint::black_box as opaque;

/// Semihosting operations (ARM IHI 0105).
const WRITE0: usize = 0x04;
const EXIT: usize = 0x18;
/// Reasons for which a program ends.
const APPLICATION_EXIT: *const c_void = ptr::without_provenance(0x20026);
const RUN_TIME_ERROR: *const c_void = ptr::without_provenance(0x20023);

/// Begins a group and prints its name as a text line.
pub fn group(name: &CStr) {
    semihosting(WRITE0, name.as_ptr().cast());
    semihosting(WRITE0, c"\n".as_ptr().cast());
    // SAFETY: the instruction does nothing.
    unsafe { asm!("mov r9, r9") };
}

/// Counts the instructions of `act` as a part of the group. `act` should call a function that is not inlined,
/// because the compiler may move inlined instructions out of the part.
#[inline(always)]
pub fn count<R>(act: impl FnOnce() -> R) -> R {
    // SAFETY: the instruction does nothing, and the compiler moves no access to memory across it.
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
    // SAFETY: QEMU handles this breakpoint, and both operations only read their argument.
    unsafe { asm!("bkpt 0xab", inlateout("r0") operation => _, in("r1") argument) };
}
