//! The bench of drivetwin: drives in virtual time, and the tools for them.
//!
//! | module | what it holds |
//! |---|---|
//! | [`mod@bench`] | the bench: drives, time, pins, motors, power, clients; the interface for tests |
//! | [`blocking`] | ports on virtual time for masters that wait |
//! | [`board`] | simulated hardware: embedded-hal, embedded-io and embedded-storage on virtual time |
//! | [`catalog`] | the kinds of drive |
//! | [`commands`] | what is done to a bench by name: pins, pulses, registers, faults |
//! | [`config`] | bench files, and the configuration of a bench as plain data |
//! | [`decode`] | messages and their outcomes in the words of the manual |
//! | [`export`] | waveforms (VCD), frames of the lines (pcapng), pictures of traces (SVG) |
//! | [`line`](mod@line) | serial lines: arbitration, complete requests, faults, collisions |
//! | [`programs`] | user programs of drives as text, for those who watch a drive |
//! | [`record`] | recordings: traces as text, captures of the lines |
//! | [`replay`] | runs a trace again and finds the first difference |
//! | [`rsasm`] | user programs of the RS drives as text |
//! | [`signals`] | motion and step pulses from plans, and all waveforms of a drive |
//! | [`suggest`] | the nearest valid name to a mistyped one |
//! | `testing` | devices for tests (feature `testing`) |
//! | [`value`] | a register's value as users see it |
//!
//! A folder uses only the folders below it; `tests/tests/layers.rs` has the order.

pub mod bench;
pub mod blocking;
pub mod board;
pub mod catalog;
pub mod commands;
pub mod config;
pub mod decode;
pub mod export;
mod ids;
pub mod line;
pub mod programs;
pub mod record;
pub mod replay;
mod rng;
pub mod rsasm;
mod scheduler;
pub mod signals;
mod slot;
pub mod suggest;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
pub mod value;
