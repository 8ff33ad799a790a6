//! Writing a trace file while the bench runs.

use std::collections::BTreeMap;
use std::io::{self, Write};

use drivetwin_firmware::device::Instant;

use super::{Event, Trace};

/// Number of bytes of text that are written at once.
const CHUNK: usize = 64 << 10;

/// Maximum number of lines that are buffered because their timestamps are in the future. If characters take
/// no time, timestamps of outputs may be far more than a second ahead.
const MOST_AHEAD: usize = 100_000;

/// Writer of the text of a [`Trace`] while the trace grows, in the order of timestamps. It buffers only
/// outputs whose timestamps are in the future.
pub struct Recording<W> {
    out: W,
    /// Complete lines that are not written yet.
    text: Vec<u8>,
    /// Number of events taken from the trace.
    taken: u64,
    /// Lines whose timestamps are in the future, by timestamp and order of recording.
    ahead: BTreeMap<(Instant, u64), String>,
}

impl<W: Write> Recording<W> {
    /// Begins the file with the drives of the trace.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn new(trace: &Trace, mut out: W) -> io::Result<Self> {
        out.write_all(trace.header().as_bytes())?;
        Ok(Self { out, text: Vec::new(), taken: 0, ahead: BTreeMap::new() })
    }

    /// Writes the events since the last call.
    ///
    /// # Errors
    /// Errors of the writer, or an error if the trace has dropped events that were not written.
    /// [`Retention::Written`](super::Retention) prevents that.
    pub fn follow(&mut self, trace: &Trace) -> io::Result<()> {
        if trace.lost > self.taken {
            return Err(io::Error::other("events were dropped before they were written"));
        }
        for entry in trace.since(self.taken) {
            match entry.event {
                Event::Input(_) | Event::Missing { .. } => {
                    self.put_until(entry.at)?;
                    self.put(&trace.entry_text(entry))?;
                }
                Event::Output(_) => {
                    self.ahead.insert((entry.at, self.taken), trace.entry_text(entry));
                    if self.ahead.len() > MOST_AHEAD {
                        self.put_first()?;
                    }
                }
                Event::Shaft { .. } | Event::Received(_) => {}
            }
            self.taken += 1;
        }
        self.put_until(trace.end)?;
        self.write_text()
    }

    /// Ends the file at the present end of the trace.
    ///
    /// # Errors
    /// Errors of [`follow`](Self::follow).
    pub fn finish(mut self, trace: &Trace) -> io::Result<W> {
        self.follow(trace)?;
        self.put_until(Instant::NEVER)?;
        self.put(&trace.end_text())?;
        self.write_text()?;
        self.out.flush()?;
        Ok(self.out)
    }

    /// Appends the buffered lines with timestamps up to `until` to the text.
    fn put_until(&mut self, until: Instant) -> io::Result<()> {
        while self.ahead.first_key_value().is_some_and(|(&(at, _), _)| at <= until) {
            self.put_first()?;
        }
        Ok(())
    }

    fn put_first(&mut self) -> io::Result<()> {
        self.ahead.pop_first().map_or(Ok(()), |(_, line)| self.put(&line))
    }

    fn put(&mut self, line: &str) -> io::Result<()> {
        self.text.extend_from_slice(line.as_bytes());
        self.text.push(b'\n');
        if self.text.len() < CHUNK { Ok(()) } else { self.write_text() }
    }

    fn write_text(&mut self) -> io::Result<()> {
        self.out.write_all(&self.text)?;
        self.text.clear();
        Ok(())
    }
}
