//! Records of outputs as text.

use std::format;
use std::string::String;
use std::vec::Vec;

use super::{new_memory, store};
use crate::device::{Context, Instant, Line, Output};

/// Records all outputs as text, in the order in which they were put, and writes stores into its memory. Used
/// to compare two runs.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Transcript {
    /// Non-volatile memory.
    pub memory: Vec<u8>,
    /// Each output as text: its timestamp in ticks and the output.
    pub outputs: Vec<String>,
    /// The last settings of a serial line that were put.
    pub line: Option<Line>,
    /// True if notes are left out. Notes count frames that a drive ignores, which depends on how the bytes
    /// are split.
    pub without_notes: bool,
}

impl Transcript {
    /// A transcript of all outputs, with a new memory of `size` bytes.
    #[must_use]
    pub fn new(size: usize) -> Self {
        Self::with_memory(new_memory(size))
    }

    /// A transcript of all outputs, with the memory `memory`.
    #[must_use]
    pub fn with_memory(memory: Vec<u8>) -> Self {
        Self { memory, outputs: Vec::new(), line: None, without_notes: false }
    }

    /// The same transcript, without notes.
    #[must_use]
    pub fn without_notes(mut self) -> Self {
        self.without_notes = true;
        self
    }
}

impl Context for Transcript {
    fn put(&mut self, at: Instant, output: Output<'_>) {
        match output {
            Output::Store { offset, bytes } => store(&mut self.memory, &mut { usize::MAX }, offset, bytes),
            Output::Line { line, .. } => self.line = Some(line),
            Output::Log(_) if self.without_notes => return,
            _ => {}
        }
        self.outputs.push(format!("{} {output:?}", at.ticks()));
    }

    fn memory(&self) -> &[u8] {
        &self.memory
    }
}
