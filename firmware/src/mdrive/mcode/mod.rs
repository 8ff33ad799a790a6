//! MCode, the drive's own language: lines received on TCP, and programs.
//!
//! | file | content |
//! |---|---|
//! | `console` | a connection: echo, lines, keys, prompts |
//! | `serial` | party mode and checksums, as in drives with a serial port |
//! | `mnemonic` | names of the language |
//! | `statement` | a line after parsing |
//! | `parse` | the parser |
//! | `program` | stored lines, by address |
//! | `names` | labels and user variables |
//! | `print` | PR: texts and values |
//! | `message_writer` | printed text, collected to messages |
//! | `execute` | effects of statements |
//! | `vm` | state of the program that runs |
//! | `run` | effects of the program that runs: its lines, errors and calls |
//! | `trip` | trips |

pub(super) mod console;
pub(super) mod execute;
mod message_writer;
pub(super) mod mnemonic;
pub(super) mod names;
pub(super) mod parse;
pub(super) mod print;
pub(super) mod program;
mod run;
mod serial;
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

/// State of MCode.
#[derive(Clone, Debug)]
pub(super) struct Mcode {
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
            consoles: Consoles::new(),
            program: Program::new(),
            names: Names::new(),
            vm: Vm::new(),
            trips: Trips::NONE,
        }
    }
}
