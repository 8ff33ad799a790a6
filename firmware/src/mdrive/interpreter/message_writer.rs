//! Output of PR and L on connections, in messages, with checksums if CK asks for them.

use core::mem;

use heapless::Vec;

use crate::device::{Context, Instant, Link};
use crate::mdrive::mcode::console::{CR_LF, MAX_CONNECTIONS, send};
use crate::mdrive::mcode::program::LINE_BYTES;
use crate::mdrive::mcode::serial::check_sum;
use crate::mdrive::reader::Text;

/// Collects output into messages, and sends them on connections.
pub(super) struct MessageWriter<'o> {
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
    pub(super) fn new(
        at: Instant,
        links: Vec<Link, MAX_CONNECTIONS>,
        sums: bool,
        out: &'o mut dyn Context,
    ) -> Self {
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
    pub(super) fn end(mut self) {
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
