//! The drives of drivetwin, and what they share.
//!
//! | module | what it holds |
//! |---|---|
//! | [`counter`] | counters of edges: the LS7366R |
//! | [`debounce`] | debouncing and delays of inputs |
//! | [`device`] | the contract between a drive and the world: read this first |
//! | [`md3`] | US Digital MD3, stepper drive |
//! | [`mdrive`] | MDrivePlus and MDrive Hybrid, stepper motors with Ethernet |
//! | [`mdrobot`] | MDROBOT MD series, brushless motor controllers |
//! | [`memory`] | saved registers and their CRC |
//! | [`modbus_port`] | the serial Modbus port of a slave |
//! | [`motion`] | plans: position and speed at any instant, and every step |
//! | [`motor`] | simulated motors |
//! | [`qsb`] | US Digital QSB, encoder adapter |
//! | [`rs434`] | RS 434544 and 434546, brush motor controllers |
//! | [`shell`] | the main loop of a board, over embedded-hal, embedded-io and nb |
//! | `testing` | a fixture and recorders for tests; needs the feature `testing` and `std` |
//!
//! No `std`, no clock, no socket, no board, no float, no heap, no `unsafe`, no panic.
#![no_std]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::float_arithmetic,
    clippy::indexing_slicing
)]
#![cfg_attr(
    test,
    allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::panic, reason = "a test may fail")
)]

#[cfg(any(test, feature = "testing"))]
extern crate std;

pub mod counter;
pub mod debounce;
pub mod device;
pub mod md3;
pub mod mdrive;
pub mod mdrobot;
pub mod memory;
pub mod modbus_port;
pub mod motion;
pub mod motor;
pub mod qsb;
pub mod rs434;
pub mod shell;
#[cfg(any(test, feature = "testing"))]
pub mod testing;

/// The list of all drives: passes the constructor of each kind, of type `fn() -> impl Device`, to a macro of
/// the caller. The simulator makes a `Box` of each drive; a board uses one.
#[macro_export]
macro_rules! devices {
    ($then:ident) => {
        $then! {
            $crate::md3::Md3::new,
            $crate::md3::Md3::low,
            $crate::qsb::Qsb::d,
            $crate::qsb::Qsb::m,
            $crate::qsb::Qsb::s,
            $crate::rs434::Rs434::rs434544,
            $crate::rs434::Rs434::rs434546,
            $crate::mdrobot::Mdrobot::md400,
            $crate::mdrive::Mdrive::plus,
            $crate::mdrive::Mdrive::hybrid,
        }
    };
}
