//! Proof that no panic can happen: the programs of this crate link only if they contain none.
//!
//! The panic handler calls a function that is not defined. The linker keeps only code that the entry
//! point can reach (`--gc-sections`), so a program links only if it can reach no panic. Each
//! program calls the code under test with [`opaque`] arguments, about which the compiler can assume
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

/// Panics for some arguments, but only with the feature `panic`, which tests this proof.
pub fn perhaps_panic(bytes: &[u8], place: usize) {
    #[cfg(feature = "panic")]
    opaque(bytes[place]);
    #[cfg(not(feature = "panic"))]
    opaque((bytes, place));
}
