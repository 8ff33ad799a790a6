//! The serial port: Modbus RTU, or ASCII on a line of 7 data bits (6.4).

use standin_protocol::modbus::{Frame, Why, ascii, rtu};

use super::RS485;
use crate::device::{Duration, Instant, Line, Note, Output, Sink};

/// What hears messages, one for each framing.
#[derive(Clone, Debug)]
enum Ears {
    Rtu(rtu::Receiver),
    Ascii(ascii::Receiver),
}

/// The serial port of the drive.
#[derive(Clone, Debug)]
pub(super) struct Serial {
    /// The time of a character.
    character: Duration,
    ears: Ears,
    /// What ends before is lost.
    hears_from: Instant,
}

impl Serial {
    /// A port on a silent line.
    pub(super) const fn new(line: Line) -> Self {
        let ears = if ascii::is_on(line) {
            Ears::Ascii(ascii::Receiver::new(line))
        } else {
            Ears::Rtu(rtu::Receiver::new(line))
        };
        Self { character: line.character(), ears, hears_from: Instant::ZERO }
    }

    /// Power has come, or comes again: the line is `line`, and what had come of a message is forgotten. Characters
    /// that end before `hears_from` are lost.
    pub(super) fn power_on(&mut self, at: Instant, line: Line, hears_from: Instant, out: &mut dyn Sink) {
        *self = Self { hears_from, ..Self::new(line) };
        out.put(at, Output::Line { port: RS485, line });
    }

    /// What had come of a message is forgotten, and all that comes is lost until
    /// [`power_on`](Self::power_on).
    pub(super) fn mute(&mut self) {
        self.hears_from = Instant::NEVER;
        match &mut self.ears {
            Ears::Rtu(receiver) => receiver.clear(),
            Ears::Ascii(receiver) => receiver.clear(),
        }
    }

    /// Characters that follow each other without a gap; `at` is the end of the first one. In ASCII none
    /// follows a line feed. A message that is over before them is [taken](Self::take) first.
    pub(super) fn bytes(&mut self, at: Instant, bytes: &[u8], out: &mut dyn Sink) {
        let (first, heard) = self.heard(at, bytes);
        if heard.len() < bytes.len() {
            out.put(at, Output::Note(Note::Dropped { port: RS485, why: Why::Starting }));
        }
        match &mut self.ears {
            Ears::Rtu(receiver) => receiver.bytes(first, heard),
            Ears::Ascii(receiver) => receiver.bytes(first, heard),
        }
    }

    /// A character that nobody could read ended at `at`. Whether the drive heard it.
    pub(super) fn spoiled(&mut self, at: Instant) -> bool {
        let hears = at >= self.hears_from;
        if hears {
            match &mut self.ears {
                Ears::Rtu(receiver) => receiver.spoiled(at),
                Ears::Ascii(receiver) => receiver.spoiled(at),
            }
        }
        hears
    }

    /// What is heard of characters of which the first ends at `at`, and when that one ends.
    fn heard<'a>(&self, at: Instant, bytes: &'a [u8]) -> (Instant, &'a [u8]) {
        if at >= self.hears_from {
            return (at, bytes);
        }
        let lost = (self.hears_from - Duration::TICK).since(at) / self.character + 1;
        let heard = usize::try_from(lost).ok().and_then(|lost| bytes.get(lost..)).unwrap_or(&[]);
        (at + self.character * lost, heard)
    }

    /// When a message is over, should nothing more come: in RTU after a silence, in ASCII with its line feed.
    /// [`Instant::NEVER`] otherwise.
    pub(super) fn deadline(&self) -> Instant {
        match &self.ears {
            Ears::Rtu(receiver) => receiver.deadline(),
            Ears::Ascii(receiver) => receiver.deadline(),
        }
    }

    /// Whether a message is over at `at`, or before a character that ends then.
    pub(super) fn is_over(&self, at: Instant) -> bool {
        self.deadline() <= at
    }

    /// Hands over the message that is over, or that the line itself has ended: address and PDU, whose check
    /// sum holds. `None` if there is none: in ASCII half a message waits for its rest all the same.
    ///
    /// # Errors
    /// Why it is no message.
    pub(super) fn take(&mut self) -> Option<Result<&[u8], Why>> {
        match &mut self.ears {
            Ears::Rtu(receiver) => {
                Some(receiver.take()?.and_then(|frame| rtu::checked(frame).ok_or(Why::Crc)))
            }
            Ears::Ascii(receiver) => receiver.take(),
        }
    }

    /// Answers at `at`, when `delay` has passed: `body` is an address and a PDU. Returns when the answer has
    /// left, if the port was sending nothing else.
    pub(super) fn reply(&self, at: Instant, delay: Duration, body: &Frame, out: &mut dyn Sink) -> Instant {
        let at = at + delay;
        let length = match self.ears {
            Ears::Rtu(_) => {
                let mut frame = body.clone();
                rtu::seal(&mut frame);
                out.put(at, Output::Bytes { port: RS485, bytes: &frame });
                frame.len()
            }
            Ears::Ascii(_) => {
                let message = ascii::encode(body);
                out.put(at, Output::Bytes { port: RS485, bytes: &message });
                message.len()
            }
        };
        at + self.character * length as u64
    }
}
