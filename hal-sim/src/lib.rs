//! The host side of drivetwin: drives on a bench of virtual time, and everything around them.
//!
//! | module | what it holds |
//! |---|---|
//! | [`mod@bench`] | the bench: seats for drives, time, pins, power; what a test writes against |
//! | [`bus`] | serial lines: whose turn it is, and when each character is where |
//! | [`capture`] | what was on the lines |
//! | [`faults`] | what disturbs a line |
//! | [`mod@file`] | bench files |
//! | [`hal`] | a board that is not there: embedded-hal, embedded-io and embedded-storage on virtual time |
//! | [`kinds`] | which drives there are |
//! | [`layout`] | what is on a bench, as plain data |
//! | [`listen`] | where a port is reached, as users write it |
//! | [`nearest`] | what somebody may have meant who mistyped a name |
//! | [`pace`] | how time runs, as users write it |
//! | [`pcapng`] | frames of the lines |
//! | [`preset`] | registers set by name |
//! | [`pulses`] | step pulses, from the plans of an axis |
//! | [`rsasm`] | user programs of the RS drives as text |
//! | [`spi`] | chips on an SPI bus |
//! | [`trace`] | what happened, as text that people read and write |
//! | [`replay`] | a trace once more, and the first difference |
//! | [`value`] | a register's value as users see it |
//! | [`vcd`] | waveforms of the pins |

pub mod bench;
pub mod bus;
pub mod capture;
mod collisions;
mod dice;
mod drives;
#[cfg(test)]
mod echo;
pub mod faults;
pub mod file;
pub mod hal;
pub mod kinds;
pub mod layout;
pub mod listen;
pub mod nearest;
pub mod pace;
pub mod pcapng;
pub mod preset;
pub mod pulses;
pub mod replay;
pub mod rsasm;
mod schedule;
mod seat;
pub mod spi;
#[cfg(test)]
mod toy;
pub mod trace;
pub mod value;
pub mod vcd;
