//! Everything that any drive sends or receives: time, serial lines, register maps, Modbus, text lines.
//!
//! | module | what it holds |
//! |---|---|
//! | [`time`] | [`time::Instant`] and [`time::Duration`], ticks of 1/16 µs |
//! | [`mod@line`] | baud rate, parity, stop bits, and the duration of a character |
//! | [`mod@registers`] | a register map declared once, as a table |
//! | [`modbus`] | requests, replies, their framings, and a server for a register map and its rules |
//! | [`text`] | text lines in ASCII |
//!
//! No `std`, no heap, no `unsafe`, no float. No input makes this crate panic: `cargo xtask test` proves this
//! by linking the crate for two Cortex-M targets without a panic handler.
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

#[cfg(test)]
extern crate std;

pub mod line;
pub mod modbus;
pub mod registers;
pub mod text;
pub mod time;
