//! Proof that no panic can happen: the linked programs of this crate have none left.
//!
//! The panic handler calls a function that exists nowhere. The linker keeps only what the entry
//! point can reach (`--gc-sections`), so a program links exactly if no panic is among it. Each
//! program calls everything it is about with [`opaque`] arguments, of which the compiler may assume
//! nothing.
#![no_std]

use core::panic::PanicInfo;

pub use core::hint::black_box as opaque;

unsafe extern "C" {
    /// Never defined: a program that can reach it does not link.
    safe fn a_panic_can_happen() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    a_panic_can_happen()
}

/// Panics for some argument; only with the feature `panic`, for the test of this test.
pub fn perhaps_panic(bytes: &[u8], place: usize) {
    #[cfg(feature = "panic")]
    opaque(bytes[place]);
    #[cfg(not(feature = "panic"))]
    opaque((bytes, place));
}
