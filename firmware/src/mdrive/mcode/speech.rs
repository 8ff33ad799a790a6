//! What is printed on connections: PR and L, in messages, with check sums where lines have some.

use core::mem;

use heapless::Vec;

use super::super::drive::Drive;
use super::super::error::Error;
use super::console::{MOST, say};
use super::print::{CR_LF, Text};
use super::program::LINE_BYTES;
use super::serial::check_sum;
use super::statement::Place;
use crate::device::{Instant, Link, Sink};

impl Drive {
    /// PR of a program: everybody hears it.
    ///
    /// # Errors
    /// Those of [`print`](Self::print).
    pub(super) fn print_to_all(
        &mut self,
        at: Instant,
        items: &[u8],
        out: &mut dyn Sink,
    ) -> Result<(), Error> {
        self.print_on(at, self.mcode.consoles.links(), items, out)
    }

    /// PR on these connections.
    ///
    /// # Errors
    /// Those of [`print`](Self::print).
    pub(super) fn print_on(
        &mut self,
        at: Instant,
        links: Vec<Link, MOST>,
        items: &[u8],
        out: &mut dyn Sink,
    ) -> Result<(), Error> {
        let mut speech = Speech::new(at, links, self.check_sums() != 0, out);
        self.print(at, items, &mut speech)?;
        speech.flush();
        Ok(())
    }

    /// L: lists the lines that are stored from a place on, as they are kept (MC 5-40).
    ///
    /// # Errors
    /// 30, 42, 44.
    pub(super) fn list_program(
        &mut self,
        at: Instant,
        link: Link,
        place: Option<Place>,
        out: &mut dyn Sink,
    ) -> Result<(), Error> {
        self.needs_unlocked()?;
        let mut address = place.map_or(Ok(1), |place| self.address(place))?;
        while let Some(next) = self.mcode.program.next(address) {
            let line = self.mcode.program.copy(out.memory(), next).unwrap_or_default();
            let mut speech = Speech::new(at, self.hearers(link), self.check_sums() != 0, out);
            speech.say(&line);
            speech.say(CR_LF);
            speech.flush();
            address = next + 1;
        }
        Ok(())
    }
}

/// What is printed on connections, gathered to messages.
struct Speech<'o> {
    at: Instant,
    links: Vec<Link, MOST>,
    /// A line of the program has room, with its check sum and its end.
    text: Vec<u8, { LINE_BYTES + 3 }>,
    /// What the check sum of a line is made of, where lines have one.
    sum: Option<u8>,
    out: &'o mut dyn Sink,
}

impl<'o> Speech<'o> {
    fn new(at: Instant, links: Vec<Link, MOST>, sums: bool, out: &'o mut dyn Sink) -> Self {
        Self { at, links, text: Vec::new(), sum: sums.then_some(0), out }
    }

    fn put(&mut self, character: u8) {
        if self.text.is_full() {
            self.flush();
        }
        // There is room now.
        let _ = self.text.push(character);
    }

    fn flush(&mut self) {
        let text = mem::take(&mut self.text);
        for link in &self.links {
            say(self.at, *link, &text, self.out);
        }
    }
}

impl Text for Speech<'_> {
    fn say(&mut self, text: &[u8]) {
        if text == CR_LF
            && let Some(sum) = self.sum
        {
            self.sum = Some(0);
            self.put(check_sum(&[sum]));
        }
        for character in text {
            self.put(*character);
            if text != CR_LF {
                self.sum = self.sum.map(|sum| sum.wrapping_add(*character));
            }
        }
    }
}
