//! Everything that crosses a wire, for any drive: time, serial lines, register maps, Modbus.
//!
//! | module | what it holds |
//! |---|---|
//! | [`time`] | [`time::Instant`] and [`time::Duration`], ticks of 1/16 µs |
//! | [`mod@line`] | baud, parity, stop bits, and how long a character takes |
//! | [`mod@registers`] | a register map declared once, as a table |
//! | [`modbus`] | requests, replies, their framings, and a server for a map and its rules |
//! | [`text`] | lines of ASCII |
//!
//! No `std`, no heap, no `unsafe`, no float, and no input makes anything here panic; `cargo xtask
//! test` proves the last by linking it for two Cortex-M targets without a panic handler.
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
