//! The host side of standin: drives on a bench of virtual time, and everything around them.
//!
//! | module | what it holds |
//! |---|---|
//! | [`mod@bench`] | the bench: seats for drives, time, pins, power; what a test writes against |
//! | [`bus`] | serial lines: whose turn it is, and when each character is where |
//! | [`hal`] | a board that is not there: embedded-hal, embedded-io and embedded-storage on virtual time |
//! | [`nearest`] | what somebody may have meant who mistyped a name |
//! | [`pulses`] | step pulses, from the plans of an axis |
//! | [`rsasm`] | user programs of the RS drives as text |
//! | [`spi`] | chips on an SPI bus |
//! | [`trace`] | what happened, as text that people read and write |
//! | [`replay`] | a trace once more, and the first difference |
//! | [`vcd`] | waveforms of the pins |

pub mod bench;
pub mod bus;
mod dice;
mod drives;
pub mod hal;
pub mod nearest;
pub mod pulses;
pub mod replay;
pub mod rsasm;
mod schedule;
mod seat;
pub mod spi;
#[cfg(test)]
mod toy;
pub mod trace;
pub mod vcd;
