//! Journal: the latest messages that a drive or a line has received, with their outcomes, as raw bytes and
//! codes. [`decode`](crate::decode) makes words of them.

use std::collections::VecDeque;
use std::ops::Deref;

use drivetwin_firmware::device::{DropReason, Duration, Instant, Port, Reason};
use drivetwin_protocol::modbus::tcp::Broken;

use crate::record::early::EarlyRequest;
use crate::record::effects::{FrameEffect, FrameEffects};
use crate::record::trace::make_room;

/// Maximum number of entries of a journal (BENCH-18).
pub const MOST: usize = 10_000;

/// Outcome of a message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Outcome {
    /// The drive accepted the message.
    Accepted,
    /// The drive refused the message with this code.
    Refused(u8),
    /// The drive ignored the message.
    Dropped(DropReason),
    /// The bytes are no message, so the drive has not looked at them.
    NoMessage(NoMessage),
    /// No drive of the line has the address.
    NoDrive,
    /// The drive had no power.
    NoPower,
    /// The drive lost its power before it reported an outcome.
    PowerLost,
    /// The drive was sending on a line on which it cannot receive meanwhile.
    Sending,
    /// The request overlapped other characters on the line.
    Collided(Collision),
    /// The request was too early, and the strict line dropped it.
    TooEarly(EarlyRequest),
    /// A fault of the line or TCP port took the message.
    Lost,
    /// A fault of the line or TCP port refused the message with this code.
    RefusedByFault(u8),
}

impl Outcome {
    /// Returns true if the drive, or a fault, refused the message.
    #[must_use]
    pub const fn is_refusal(self) -> bool {
        matches!(self, Self::Refused(_) | Self::RefusedByFault(_))
    }

    /// Returns true if nobody executed or refused the message, so that its client gets no answer.
    #[must_use]
    pub const fn is_unanswered(self) -> bool {
        !matches!(self, Self::Accepted | Self::Refused(_) | Self::RefusedByFault(_))
    }
}

/// Numbers of messages without success, since the journal began.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Failures {
    /// Messages that were refused.
    pub refused: u64,
    /// Messages that nobody executed or refused.
    pub unanswered: u64,
}

/// What a request overlapped on a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Collision {
    /// The request of another client.
    Request,
    /// The reply of a drive.
    Reply,
    /// Noise.
    Noise,
}

/// Reason why bytes are no message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum NoMessage {
    /// No colon begins a message of Modbus ASCII.
    NoColon,
    /// A colon begins another message of Modbus ASCII before this one has ended.
    NextColon,
    /// A header that no Modbus/TCP message has. The connection is closed.
    Header(Broken),
    /// The client disconnected before the end of the message.
    Disconnected,
}

/// A message with its outcome.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Entry {
    /// Number on the bench, in the order in which the outcomes became known; the first is 1.
    pub number: u64,
    /// Bench time of the end of the message.
    pub at: Instant,
    /// Port of the drive. In the journal of a line, the port of the line's first drive.
    pub port: Port,
    /// Outcome.
    pub outcome: Outcome,
    /// True for Modbus ASCII.
    pub ascii: bool,
    /// Number of characters with an error, up to 255.
    pub unreadable: u8,
    /// Time from the message until the drive receives; zero if it received, `None` if unknown.
    pub deaf_for: Option<Duration>,
    /// Number of bytes of the answer that the drive had sent when it lost its power; `None` if it sent all.
    pub sent_of_answer: Option<u16>,
    /// End of the answer on a serial line.
    pub(crate) answer_until: Instant,
    /// The missing silence, if the request was too early and its line is not strict.
    pub early: Option<Box<EarlyRequest>>,
    /// Effects of faults on the message.
    pub on_message: FrameEffects,
    /// Effects of faults on the answer.
    pub on_answer: FrameEffects,
    /// Length of the message in `bytes`.
    message: u16,
    /// Length of the answer in `bytes`, after the message.
    answer: u16,
    /// The message, the answer, and codes: the reasons of the drive, or the addresses of the line.
    bytes: Bytes,
}

/// Bytes of an entry. Those of a usual request and its answer need no allocation.
#[derive(Clone, Debug)]
enum Bytes {
    Few([u8; Bytes::FEW], u8),
    Many(Box<[u8]>),
}

impl Bytes {
    /// Number of bytes that a read of a few registers, or a write, has together with its answer.
    const FEW: usize = 38;

    fn joined(parts: [&[u8]; 3]) -> Self {
        let length: usize = parts.iter().map(|part| part.len()).sum();
        if length > Self::FEW {
            return Self::Many(parts.concat().into());
        }
        let (mut few, mut from) = ([0; Self::FEW], 0);
        for part in parts {
            few[from..from + part.len()].copy_from_slice(part);
            from += part.len();
        }
        Self::Few(few, length as u8)
    }
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Few(few, length) => &few[..usize::from(*length)],
            Self::Many(many) => many,
        }
    }
}

impl PartialEq for Bytes {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl Eq for Bytes {}

impl Entry {
    /// Bytes of the message, without the characters that had an error.
    #[must_use]
    pub fn message(&self) -> &[u8] {
        self.bytes.get(..self.message.into()).unwrap_or_default()
    }

    /// Returns true if no whole answer reached the client: nobody executed or refused the message, or the answer was lost.
    #[must_use]
    pub fn is_unanswered(&self) -> bool {
        let took = [FrameEffect::Dropped, FrameEffect::Muted, FrameEffect::Closed];
        let is_lost = took.into_iter().any(|effect| self.on_answer.contains(effect));
        self.outcome.is_unanswered() || is_lost || self.sent_of_answer.is_some()
    }

    /// Bytes of the answer.
    #[must_use]
    pub fn answer(&self) -> &[u8] {
        let from = usize::from(self.message);
        self.bytes.get(from..from + usize::from(self.answer)).unwrap_or_default()
    }

    /// Reasons why the drive does not do what the message says, although it accepts the message.
    pub fn reasons(&self) -> impl Iterator<Item = Reason> {
        let codes = if self.outcome == Outcome::Accepted { self.codes() } else { &[] };
        codes.iter().map(|&code| Reason(code))
    }

    /// Number of the drive's last error when it refused the message, if it has such a number.
    #[must_use]
    pub fn error(&self) -> Option<u8> {
        if matches!(self.outcome, Outcome::Refused(_)) { self.codes().first().copied() } else { None }
    }

    /// Addresses of the drives of the line, if no drive has the address of the message; otherwise empty.
    #[must_use]
    pub fn addresses(&self) -> &[u8] {
        if self.outcome == Outcome::NoDrive { self.codes() } else { &[] }
    }

    fn codes(&self) -> &[u8] {
        self.bytes.get(usize::from(self.message) + usize::from(self.answer)..).unwrap_or_default()
    }

    /// The entry of a message that is addressed to no drive, for the journal of a line. Instead of codes it
    /// has `addresses`, those of the drives on the line.
    pub(crate) fn without_drive(self, addresses: &[u8]) -> Self {
        let bytes = Bytes::joined([self.message(), addresses, &[]]);
        Self { outcome: Outcome::NoDrive, answer: 0, bytes, ..self }
    }
}

/// An entry that is being made. Its buffers are used again.
#[derive(Debug, Default)]
pub(crate) struct Draft {
    message: Vec<u8>,
    answer: Vec<u8>,
    codes: Vec<u8>,
}

/// Maximum length of a message or an answer in an entry; further bytes are left out.
const LONGEST: usize = 1 << 10;

impl Draft {
    /// Sets the message, and clears the rest but the codes.
    pub(crate) fn begin(&mut self, message: &[u8]) {
        self.message.clear();
        self.answer.clear();
        extend(&mut self.message, message);
    }

    /// Appends bytes of the answer.
    pub(crate) fn answer(&mut self, bytes: &[u8]) {
        extend(&mut self.answer, bytes);
    }

    /// Adds a reason, once.
    pub(crate) fn reason(&mut self, reason: Reason) {
        if !self.codes.contains(&reason.0) {
            self.codes.push(reason.0);
        }
    }

    /// Removes everything.
    pub(crate) fn clear(&mut self) {
        self.message.clear();
        self.answer.clear();
        self.codes.clear();
    }

    /// The entry, which takes the bytes of this draft. Its number is set by the [`Journal`].
    pub(crate) fn entry(&mut self, at: Instant, port: Port, outcome: Outcome) -> Entry {
        let (message, answer) = (self.message.len(), self.answer.len());
        let bytes = Bytes::joined([&self.message, &self.answer, &self.codes]);
        self.clear();
        Entry {
            number: 0,
            at,
            port,
            outcome,
            ascii: false,
            unreadable: 0,
            deaf_for: Some(Duration::ZERO),
            sent_of_answer: None,
            answer_until: Instant::ZERO,
            early: None,
            on_message: FrameEffects::NONE,
            on_answer: FrameEffects::NONE,
            message: message as u16,
            answer: answer as u16,
            bytes,
        }
    }
}

/// Appends bytes up to [`LONGEST`].
fn extend(to: &mut Vec<u8>, bytes: &[u8]) {
    let room = LONGEST.saturating_sub(to.len()).min(bytes.len());
    to.extend_from_slice(&bytes[..room]);
}

/// The latest entries of a drive or a line.
#[derive(Clone, Debug, Default)]
pub(crate) struct Journal {
    entries: VecDeque<Entry>,
    lost: u64,
    failures: Failures,
    /// Number of the last entry whose outcome is recorded.
    recorded: u64,
}

impl Journal {
    /// Adds an entry as the bench's next one after number `last`, and drops the oldest one if the ring is
    /// full.
    pub(crate) fn push(&mut self, last: &mut u64, mut entry: Entry) {
        if self.entries.len() == MOST {
            self.entries.pop_front();
            self.lost += 1;
        }
        self.failures.refused += u64::from(entry.outcome.is_refusal());
        self.failures.unanswered += u64::from(entry.outcome.is_unanswered());
        *last += 1;
        entry.number = *last;
        make_room(&mut self.entries);
        self.entries.push_back(entry);
    }

    /// The latest entry.
    pub(crate) fn last_mut(&mut self) -> Option<&mut Entry> {
        self.entries.back_mut()
    }

    /// The latest entry of a port, if these bytes are in its answer.
    pub(crate) fn answered_with(&mut self, port: Port, bytes: &[u8]) -> Option<&mut Entry> {
        let kept = &bytes[..bytes.len().min(LONGEST)];
        let last = self.entries.iter_mut().rev().find(|entry| entry.port == port);
        last.filter(|entry| {
            let answer = entry.answer();
            answer.windows(kept.len().max(1)).any(|part| part == kept)
        })
    }

    /// The latest entry of a port that has an answer.
    pub(crate) fn last_answered(&mut self, port: Port) -> Option<&mut Entry> {
        self.entries.iter_mut().rev().find(|entry| entry.port == port && entry.answer > 0)
    }

    /// The entries of a port whose answers end after `now`, the newest first.
    pub(crate) fn answered_after(&mut self, port: Port, now: Instant) -> impl Iterator<Item = &mut Entry> {
        let answered =
            self.entries.iter_mut().rev().filter(move |entry| entry.port == port && entry.answer > 0);
        answered.take_while(move |entry| entry.answer_until > now)
    }

    /// The entry with that number.
    pub(crate) fn numbered(&mut self, number: u64) -> Option<&mut Entry> {
        let index = self.entries.binary_search_by_key(&number, |entry| entry.number).ok()?;
        self.entries.get_mut(index)
    }

    /// The oldest entry whose outcome is not recorded yet. It counts as recorded from now on.
    pub(crate) fn next_new(&mut self) -> Option<Entry> {
        let recorded = self.recorded;
        let new = self.entries.iter().rev().take_while(|entry| entry.number > recorded).last()?;
        self.recorded = new.number;
        Some(new.clone())
    }

    /// The latest entry of a port after number `before`.
    pub(crate) fn last_after(&mut self, port: Port, before: u64) -> Option<&mut Entry> {
        let new = self.entries.iter_mut().rev().take_while(|entry| entry.number > before);
        new.into_iter().find(|entry| entry.port == port)
    }

    /// The entries after that number, the oldest first.
    pub(crate) fn after(&self, number: u64) -> impl DoubleEndedIterator<Item = &Entry> + ExactSizeIterator {
        let from = self.entries.partition_point(|entry| entry.number <= number);
        self.entries.range(from..)
    }

    /// The entries, the oldest first.
    pub(crate) fn entries(&self) -> impl DoubleEndedIterator<Item = &Entry> + Clone {
        self.entries.iter()
    }

    /// Numbers of refused and of unanswered messages among all entries so far.
    pub(crate) fn failures(&self) -> Failures {
        self.failures
    }

    /// Number of entries that the ring has dropped.
    pub(crate) fn lost(&self) -> u64 {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_journal_drops_its_oldest_entries_and_counts_them() {
        let (mut journal, mut draft, mut last) = (Journal::default(), Draft::default(), 0);
        for n in 0..10_003_u64 {
            draft.begin(&n.to_be_bytes());
            journal.push(&mut last, draft.entry(Instant::from_ticks(n), Port(0), Outcome::Accepted));
        }
        assert_eq!((journal.entries().count(), journal.lost(), last), (10_000, 3, 10_003));
        let first = journal.entries().next().unwrap();
        assert_eq!((first.number, first.message()), (4, &3_u64.to_be_bytes()[..]));
        // The ring uses all of its capacity in turn.
        assert!(journal.entries.capacity() <= 11_000, "{}", journal.entries.capacity());
    }

    #[test]
    fn an_entry_has_message_answer_and_reasons_apart() {
        let mut draft = Draft::default();
        draft.reason(Reason(7));
        draft.begin(b"ask");
        draft.answer(b"an");
        draft.answer(b"swer");
        draft.reason(Reason(2));
        draft.reason(Reason(7));
        let entry = draft.entry(Instant::ZERO, Port(1), Outcome::Accepted);
        assert_eq!((entry.message(), entry.answer()), (&b"ask"[..], &b"answer"[..]));
        assert_eq!(entry.reasons().collect::<Vec<_>>(), [Reason(7), Reason(2)]);
        assert_eq!(draft.entry(Instant::ZERO, Port(1), Outcome::Accepted).message(), b"");
    }

    #[test]
    fn a_long_message_is_cut() {
        let mut draft = Draft::default();
        draft.begin(&[1; 5_000]);
        draft.answer(&[2; 100_000]);
        let entry = draft.entry(Instant::ZERO, Port(0), Outcome::Accepted);
        assert_eq!((entry.message().len(), entry.answer().len()), (1_024, 1_024));
    }
}
