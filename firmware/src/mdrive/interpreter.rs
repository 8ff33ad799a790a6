//! The drive's own language as it acts on the drive: typed lines of port 503, and the lines of a program.
//!
//! | file | content |
//! |---|---|
//! | `typed` | execution of typed lines |
//! | `execute` | effects of statements, typed or of the program |
//! | `message_writer` | printed text, collected to messages |
//!
//! Like the Modbus server (`modbus`), the interpreter stands above the drive. The state of the language is in
//! `mcode`, a part of the drive.

mod execute;
mod message_writer;
mod typed;

use super::drive::Drive;
use crate::device::{Context, Instant};

/// The drive as MCode acts on it at an instant: by typed lines (`typed`) and by the lines of a program (`execute`).
pub(super) struct Interpreter<'a> {
    drive: &'a mut Drive,
    at: Instant,
    out: &'a mut dyn Context,
}

impl<'a> Interpreter<'a> {
    pub(super) fn new(drive: &'a mut Drive, at: Instant, out: &'a mut dyn Context) -> Self {
        Self { drive, at, out }
    }
}
