//! MCode, the drive's own language: lines that come on TCP, and programs.
//!
//! | file | what of it |
//! |---|---|
//! | `console` | a connection: echo, lines, keys, prompts |
//! | `serial` | party mode and check sums, of the serial sister |
//! | `mnemonic` | the names of the language |
//! | `statement` | a line, taken apart |
//! | `parse` | how it is taken apart |
//! | `program` | the lines that are stored, by address |
//! | `names` | labels and user variables |
//! | `print` | PR: texts and values |
//! | `message_writer` | what is printed, on its way |
//! | `execute` | what a statement does |
//! | `vm` | the program that runs |
//! | `trip` | trips |

pub(super) mod console;
pub(super) mod execute;
mod message_writer;
pub(super) mod mnemonic;
pub(super) mod names;
pub(super) mod parse;
pub(super) mod print;
pub(super) mod program;
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

/// The language's state.
#[derive(Clone, Debug)]
pub(super) struct Mcode {
    pub(super) consoles: Consoles,
    pub(super) program: Program,
    pub(super) names: Names,
    pub(super) vm: Vm,
    pub(super) trips: Trips,
}

impl Mcode {
    // Where it will be: a copy takes room on a board's stack.
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
