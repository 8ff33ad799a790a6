//! Messages that a drive sends by itself on a port with text: a stream, and what a program prints. They are no answers, so
//! the journal does not have them.

use std::collections::VecDeque;
use std::mem;

use drivetwin_firmware::device::{Instant, Port};

/// Maximum number of messages that are kept of each drive.
pub const MOST: usize = 100;

/// Maximum length of a message; further bytes are left out.
pub(crate) const LONGEST: usize = 1 << 10;

/// A message that a drive has sent by itself.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct OwnMessage {
    /// Number on the bench; the first is 1.
    pub number: u64,
    /// Bench time at which the drive has sent it.
    pub at: Instant,
    /// Port of the drive.
    pub port: Port,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// The latest messages of a drive.
#[derive(Debug, Default)]
pub(crate) struct OwnMessages(VecDeque<OwnMessage>);

impl OwnMessages {
    /// Adds a message as the bench's next one after number `last`. Its bytes are taken out of `bytes`, which gets the
    /// memory of the oldest message if that one is dropped.
    pub(crate) fn push(&mut self, last: &mut u64, at: Instant, port: Port, bytes: &mut Vec<u8>) {
        let mut free = Vec::new();
        if self.0.len() == MOST
            && let Some(oldest) = self.0.pop_front()
        {
            free = oldest.bytes;
            free.clear();
        }
        *last += 1;
        self.0.push_back(OwnMessage { number: *last, at, port, bytes: mem::replace(bytes, free) });
    }

    /// The messages after that number, the oldest first.
    pub(crate) fn after(
        &self,
        number: u64,
    ) -> impl DoubleEndedIterator<Item = &OwnMessage> + ExactSizeIterator {
        let from = self.0.partition_point(|message| message.number <= number);
        self.0.range(from..)
    }
}
