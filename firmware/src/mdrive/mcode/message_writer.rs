//! Output of PR and L on connections, in messages, with checksums if CK asks for them.

use core::mem;

use heapless::Vec;

use super::super::drive::Drive;
use super::super::error::Error;
use super::console::{MAX_CONNECTIONS, send};
use super::print::{CR_LF, Text};
use super::program::LINE_BYTES;
use super::serial::check_sum;
use super::statement::Place;
use crate::device::{Context, Instant, Link};

impl Drive {
    /// Prints the items of PR on these connections.
    ///
    /// # Errors
    /// The errors of [`print`](Self::print).
    pub(super) fn print_on(
        &mut self,
        at: Instant,
        links: Vec<Link, MAX_CONNECTIONS>,
        items: &[u8],
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let mut writer = MessageWriter::new(at, links, self.bank.check_sums() != 0, out);
        self.print(at, items, &mut writer)?;
        writer.end();
        Ok(())
    }

    /// Lists the stored lines from a place on, on these connections (L, MC 5-40).
    ///
    /// # Errors
    /// Error 30, 42 or 44.
    pub(super) fn list_program(
        &mut self,
        at: Instant,
        links: Vec<Link, MAX_CONNECTIONS>,
        place: Option<Place>,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        self.bank.needs_unlocked()?;
        let mut address = place.map_or(Ok(1), |place| self.mcode.address(place))?;
        while let Some(next) = self.mcode.program.next(address) {
            let line = self.mcode.program.copy(out.memory(), next).unwrap_or_default();
            let mut writer = MessageWriter::new(at, links.clone(), self.bank.check_sums() != 0, out);
            writer.write(&line);
            writer.write(CR_LF);
            writer.end();
            address = next + 1;
        }
        Ok(())
    }
}

/// Collects output into messages, and sends them on connections.
struct MessageWriter<'o> {
    at: Instant,
    links: Vec<Link, MAX_CONNECTIONS>,
    /// Has room for a line of the program with its checksum and CR LF.
    text: Vec<u8, { LINE_BYTES + 3 }>,
    /// True if lines have checksums.
    sums: bool,
    sum: Option<u8>,
    out: &'o mut dyn Context,
}

impl<'o> MessageWriter<'o> {
    fn new(at: Instant, links: Vec<Link, MAX_CONNECTIONS>, sums: bool, out: &'o mut dyn Context) -> Self {
        Self { at, links, text: Vec::new(), sums, sum: None, out }
    }

    fn put(&mut self, character: u8) {
        if self.text.is_full() {
            self.flush();
        }
        // The text has room now.
        let _ = self.text.push(character);
    }

    /// Ends the output. Text without an end of line gets its checksum now (MC 7.1.2).
    fn end(mut self) {
        self.put_sum();
        self.flush();
    }

    fn put_sum(&mut self) {
        if let Some(sum) = self.sum.take() {
            self.put(check_sum(&[sum]));
        }
    }

    fn flush(&mut self) {
        let text = mem::take(&mut self.text);
        for link in &self.links {
            send(self.at, *link, &text, self.out);
        }
    }
}

impl Text for MessageWriter<'_> {
    fn write(&mut self, text: &[u8]) {
        if self.sums && text == CR_LF {
            self.sum.get_or_insert(0);
            self.put_sum();
        }
        for character in text {
            self.put(*character);
            if self.sums && text != CR_LF {
                self.sum = Some(self.sum.unwrap_or(0).wrapping_add(*character));
            }
        }
    }
}
