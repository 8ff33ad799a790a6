//! What happened on a bench, as text that people read and write.

/// How much of what happens is kept.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum TraceKeep {
    /// Nothing.
    Off,
    /// The last so many bytes, in a packed form.
    Ring(usize),
    /// Everything.
    All,
}

/// What is kept by default: 64 MiB.
impl Default for TraceKeep {
    fn default() -> Self {
        Self::Ring(64 << 20)
    }
}

/// A recording, or a scenario.
#[derive(Clone, Debug, Default)]
pub struct Trace {}

impl Trace {
    /// Reads a trace.
    ///
    /// # Errors
    /// What is wrong, and in which line.
    pub fn parse(_text: &str) -> Result<Self, ParseError> {
        unimplemented!()
    }

    /// The trace as text, header included.
    #[must_use]
    pub fn to_text(&self) -> String {
        unimplemented!()
    }

    /// Writes the text.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn write(&self, _to: &mut dyn std::io::Write) -> std::io::Result<()> {
        unimplemented!()
    }
}

/// What is wrong with the text of a trace.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ParseError {
    /// In which line, from 1.
    pub line: usize,
    /// One sentence.
    pub what: String,
}

impl std::fmt::Display for ParseError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "line {}: {}", self.line, self.what)
    }
}

impl std::error::Error for ParseError {}
