//! MCode, the drive's own language: its connections, its parser, its programs and their state. The lines are executed
//! by `interpreter`, which acts on the whole drive.
//!
//! | file | content |
//! |---|---|
//! | `console` | connections: characters, keys, echo, answers |
//! | `serial` | party mode and checksums, as in drives with a serial port |
//! | `mnemonic` | names of the language |
//! | `operand` | what statements are made of |
//! | `statement` | a line after parsing |
//! | `parse` | the parser |
//! | `program` | stored lines, by address |
//! | `names` | labels and user variables |
//! | `vm` | state of the program that runs |
//! | `run` | start, pauses and end of the program; errors and calls |
//! | `trip` | trips |

pub(super) mod console;
pub(super) mod mnemonic;
pub(super) mod names;
pub(super) mod operand;
pub(super) mod parse;
pub(super) mod program;
mod run;
pub(super) mod serial;
pub(super) mod statement;
pub(super) mod trip;
pub(super) mod vm;

#[cfg(test)]
mod tests;

use self::console::Consoles;
use self::names::Names;
use self::program::Program;
use self::trip::Trips;
use self::vm::Vm;
use super::error::Errors;
use crate::device::Instant;

/// State of MCode. EF and ER are a part of it, because an error calls OE's handler.
#[derive(Clone, Debug)]
pub(super) struct Mcode {
    pub(super) errors: Errors,
    pub(super) consoles: Consoles,
    pub(super) program: Program,
    pub(super) names: Names,
    pub(super) vm: Vm,
    pub(super) trips: Trips,
}

impl Mcode {
    // Inlined to build the value in its final place: a copy would need room on a board's stack.
    #[inline(always)]
    pub(super) fn new() -> Self {
        Self {
            errors: Errors::NONE,
            consoles: Consoles::new(),
            program: Program::new(),
            names: Names::new(),
            vm: Vm::new(),
            trips: Trips::NONE,
        }
    }

    pub(super) fn deadline(&self) -> Instant {
        self.consoles.deadline().min(self.vm.deadline()).min(self.trips.deadline())
    }
}
