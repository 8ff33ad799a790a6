//! Messages that drives have received, with their outcomes.
//!
//! A drive has a journal of the messages that it executed or refused, and of those for it that it could not
//! receive or read. A line that several drives share has a journal, too: of corrupt frames, and of frames for
//! an address that no drive of the line has (BENCH-18).

use std::collections::BTreeMap;

use drivetwin_firmware::device::{DropReason, Duration, Framing, Instant, Link, Port, Spec};
use drivetwin_protocol::modbus::ascii;
use drivetwin_protocol::registers::{Named, Order};

use super::{Bench, Bus, DriveId, Outlet};
use crate::decode::{self, Exchange, Message, Register, Request, Verdict};
use crate::line::SerialLine;
use crate::line::collisions::SentRequest;
use crate::record::capture::Medium;
use crate::record::effects::{FrameEffect, FrameEffects};
use crate::record::journal::{Draft, Entry, Failures, Journal, NoMessage, Outcome};
use crate::record::own_messages::OwnMessage;
use crate::record::requests::StartingRequests;
use crate::record::trace::InputRecord;

/// Copy of the latest messages that a drive has received, in the order in which their outcomes became known. The texts
/// of the messages are made only when a caller asks for the messages.
///
/// ```
/// use drivetwin_firmware::md3::Md3;
/// use drivetwin_protocol::{modbus::rtu, time::Span};
/// use drivetwin_sim::bench::Bench;
///
/// let mut bench = Bench::new();
/// let md3 = bench.add::<Md3>("x");
/// bench.ask(md3, &rtu::write(1, 0x11, 1)); // Too early.
/// bench.run_until(2_500.millis());
/// bench.ask(md3, &rtu::write(1, 0x15, 9_000));
/// bench.ask(md3, &rtu::write(1, 0x0b, 5));
/// bench.ask(md3, &rtu::write(1, 0x11, 1));
/// let received = bench.received(md3);
/// let words: Vec<String> = received.messages().map(|message| message.to_string()).collect();
/// assert_eq!(words, [
///     "rs485 <- write MotionControl = 1 -> starting for 2.5 s more",
///     "rs485 <- write SpeedLow = 9000 -> done",
///     "rs485 <- write Reserved = 5 -> refused: 0x000B Reserved is read only (02)",
///     "rs485 <- write MotionControl = 1 -> done",
/// ]);
/// // Was the speed written before Move?
/// assert_eq!(received.written(), ["SpeedLow", "MotionControl"]);
/// let register = |name| bench.spec(md3).find(name).expect("the MD3 has it");
/// assert!(received.wrote_before(register("Speed"), register("MotionControl")));
/// ```
#[derive(Clone, Debug)]
pub struct Received {
    spec: &'static Spec,
    entries: Vec<Entry>,
    lost: u64,
}

/// A message that a drive has received, with its outcome as text.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ReceivedMessage {
    /// Number on the bench, in the order in which the outcomes became known; the first is 1.
    pub number: u64,
    /// Bench time of the end of the message.
    pub at: Instant,
    /// Name of the port.
    pub port: &'static str,
    /// Bytes of the message, without characters that had an error; at most 1,024.
    pub bytes: Vec<u8>,
    /// Bytes of the answer, at most 1,024; empty if there was none.
    pub answer: Vec<u8>,
    /// True if no whole answer reached the client: nobody executed or refused the message, or the answer was lost.
    pub unanswered: bool,
    /// The message and its outcome, as text and as fields.
    pub exchange: Exchange,
}

impl std::fmt::Display for ReceivedMessage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} <- {}", self.port, self.exchange)
    }
}

/// Numbers of requests, whatever their outcomes.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Counts {
    /// By Modbus function.
    pub functions: BTreeMap<u8, u64>,
    /// By register.
    pub registers: BTreeMap<String, Accesses>,
}

/// Numbers of the requests that read and that write a register.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Accesses {
    /// Number of requests that read it.
    pub read: u64,
    /// Number of requests that write it.
    pub written: u64,
}

impl Counts {
    /// Counts a request.
    pub fn add(&mut self, request: &Request) {
        if let Some(function) = request.function {
            *self.functions.entry(function).or_default() += 1;
        }
        for register in &request.registers {
            let accesses = self.registers.entry(register.name.clone()).or_default();
            *(if register.written { &mut accesses.written } else { &mut accesses.read }) += 1;
        }
    }
}

impl Received {
    /// The messages, in the order in which their outcomes became known. The outcome of a message may be known
    /// later than that of a message that ended after it, as on a line where characters may collide.
    pub fn messages(&self) -> impl DoubleEndedIterator<Item = ReceivedMessage> + '_ {
        self.entries.iter().map(|entry| words(self.spec, entry))
    }

    /// Names of the registers that executed requests have written, in the order of the requests. A register
    /// that was written several times appears several times.
    #[must_use]
    pub fn written(&self) -> Vec<String> {
        let done = self.messages().filter(|message| message.exchange.verdict == Verdict::Done);
        let registers = done.flat_map(|message| message.exchange.request.registers);
        registers.filter(|register| register.written).map(|register| register.name).collect()
    }

    /// Removes the messages before the first one that ended at `since` or later. The other messages stay, also one that
    /// ended earlier: its outcome became known after `since`. So a reader that passes the end of the newest message that
    /// it has seen misses none.
    #[must_use]
    pub fn since(mut self, since: impl Into<Instant>) -> Self {
        let since = since.into();
        let before = self.entries.iter().take_while(|entry| entry.at < since).count();
        self.entries.drain(..before);
        self
    }

    /// Removes the messages that do not have this Modbus function.
    #[must_use]
    pub fn of_function(self, function: u8) -> Self {
        self.retain(|message| message.exchange.request.function == Some(function))
    }

    /// Removes the messages that neither read nor write a register, or the word of a register (`SpeedLow`).
    #[must_use]
    pub fn of_register(self, register: Named) -> Self {
        let fits = self.fits(register);
        self.retain(|message| message.exchange.request.registers.iter().any(&fits))
    }

    /// A function that tells if a register of a request is this register, or a part of it.
    fn fits(&self, register: Named) -> impl Fn(&Register) -> bool + use<> {
        let row = self.spec.registers.rows.get(register.row).map_or("", |row| row.name);
        let word = register.word.map(|word| {
            let high = (self.spec.registers.layout.order == Order::HighFirst) == (word == 0);
            format!("{row}{}", if high { "High" } else { "Low" })
        });
        move |other: &Register| {
            let whole = other.name == row;
            other.row == register.row && (whole || word.as_ref().is_none_or(|word| *word == other.name))
        }
    }

    /// Returns true if an executed request wrote `first` before the first one that wrote `then`. False if no request
    /// wrote `then`.
    #[must_use]
    pub fn wrote_before(&self, first: Named, then: Named) -> bool {
        let (is_first, is_then) = (self.fits(first), self.fits(then));
        let done = self.messages().filter(|message| message.exchange.verdict == Verdict::Done);
        let written = done.flat_map(|message| message.exchange.request.registers).filter(|one| one.written);
        let written: Vec<Register> = written.collect();
        let place = written.iter().position(is_then);
        place.is_some_and(|place| written[..place].iter().any(is_first))
    }

    /// Numbers of the requests by Modbus function and by register.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let mut counts = Counts::default();
        for message in self.messages() {
            counts.add(&message.exchange.request);
        }
        counts
    }

    fn retain(mut self, wanted: impl Fn(&ReceivedMessage) -> bool) -> Self {
        let spec = self.spec;
        self.entries.retain(|entry| wanted(&words(spec, entry)));
        self
    }

    /// Number of earlier messages that the journals have dropped: each keeps the latest 10,000.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }
}

/// An entry as text and as fields.
fn words(spec: &'static Spec, entry: &Entry) -> ReceivedMessage {
    ReceivedMessage {
        number: entry.number,
        at: entry.at,
        port: spec.ports.get(usize::from(entry.port.0)).map_or("", |port| port.name),
        bytes: entry.message().to_vec(),
        answer: entry.answer().to_vec(),
        unanswered: entry.is_unanswered(),
        exchange: decode::exchange(spec, entry),
    }
}

/// Reason why no drive can read a Modbus frame; `None` for a frame with a valid checksum.
fn flaw(message: &Message<'_>, unreadable: u8) -> Option<Outcome> {
    if unreadable > 0 {
        Some(Outcome::Dropped(DropReason::RxError))
    } else if message.is_whole() {
        None
    } else if message.ascii && !message.bytes.contains(&b':') {
        Some(Outcome::NoMessage(NoMessage::NoColon))
    } else {
        Some(Outcome::Dropped(DropReason::Crc))
    }
}

/// Journal to which an entry belongs.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Receiver {
    /// A drive.
    Drive(DriveId),
    /// All drives of a shared line.
    Line(Bus),
}

/// Entries of all journals after a number, for a reader that follows the bench.
#[derive(Clone, Debug, Default)]
pub struct News {
    entries: Vec<(Receiver, &'static Spec, Entry)>,
    /// Number of the last entry.
    last: u64,
    lost: u64,
}

impl News {
    /// Number of the last entry in this list, for the next call of [`Bench::received_after`].
    #[must_use]
    pub fn last(&self) -> u64 {
        self.last
    }

    /// Number of entries among them that full journals have dropped, or that a list of the newest leaves out.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// The receiver of each message.
    pub fn receivers(&self) -> impl Iterator<Item = Receiver> + '_ {
        self.entries.iter().map(|(receiver, ..)| *receiver)
    }

    /// The messages with their texts, in the order in which their outcomes became known.
    pub fn messages(&self) -> impl Iterator<Item = (Receiver, ReceivedMessage)> + '_ {
        self.entries.iter().map(|(receiver, spec, entry)| (*receiver, words(spec, entry)))
    }
}

/// Messages that drives have sent by themselves, for a reader that follows the bench.
#[derive(Clone, Debug, Default)]
pub struct OwnNews {
    entries: Vec<(DriveId, &'static Spec, OwnMessage)>,
    last: u64,
    left_out: u64,
}

/// A message that a drive has sent by itself, with its text.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SentMessage {
    /// The drive.
    pub drive: DriveId,
    /// Bench time at which the drive has sent it.
    pub at: Instant,
    /// Name of the port.
    pub port: &'static str,
    /// Bytes of the message, at most 1,024.
    pub bytes: Vec<u8>,
    /// The message in words; empty if it has only prompts.
    pub text: String,
}

impl OwnNews {
    /// Number of the last message, for the next call of [`Bench::own_messages`].
    #[must_use]
    pub fn last(&self) -> u64 {
        self.last
    }

    /// Number of messages that are left out.
    #[must_use]
    pub fn left_out(&self) -> u64 {
        self.left_out
    }

    /// The messages with their texts, in the order in which they were sent.
    pub fn messages(&self) -> impl Iterator<Item = SentMessage> + '_ {
        self.entries.iter().filter_map(|(drive, spec, message)| {
            let OwnMessage { at, port, bytes, .. } = message;
            let port = spec.ports.get(usize::from(port.0))?;
            let text = decode::own_message(spec, port.framing, bytes);
            Some(SentMessage { drive: *drive, at: *at, port: port.name, bytes: bytes.clone(), text })
        })
    }
}

/// Messages that drives have received.
impl Bench {
    /// The latest messages that a drive has received on all its ports, and those of its shared line that were
    /// for no drive or corrupt. The journals keep the latest 10,000 messages of each drive and each line.
    #[must_use]
    pub fn received(&self, drive: DriveId) -> Received {
        let slot = self.at(drive);
        let lines = (0..slot.spec.ports.len() as u8).filter_map(|port| self.bus(drive, Port(port)));
        let lines = lines.map(|Bus(bus)| &self.buses[bus as usize].journal);
        let journals: Vec<_> = std::iter::once(&slot.state.journal).chain(lines).collect();
        let mut entries: Vec<Entry> =
            journals.iter().flat_map(|journal| journal.entries().cloned()).collect();
        entries.sort_by_key(|entry| entry.number);
        Received { spec: slot.spec, entries, lost: journals.iter().map(|journal| journal.lost()).sum() }
    }

    /// The latest entries of all journals, each entry with its drive. An entry of a line's own journal is in the list
    /// once for each drive of the line. The journals give about 100,000 entries together, so on a bench of many drives
    /// each journal gives fewer.
    #[must_use]
    pub fn outcomes(&self) -> Vec<(DriveId, Entry)> {
        const MOST_IN_ALL: usize = 100_000;
        let most = MOST_IN_ALL / (self.slots.len() + self.buses.len()).max(1);
        let own = self.drives().flat_map(|drive| {
            self.at(drive).state.journal.entries().rev().take(most).map(move |entry| (drive, entry.clone()))
        });
        let of_lines = self.buses.iter().flat_map(|line| {
            let ports = &line.ports;
            line.journal.entries().rev().take(most).flat_map(move |entry| {
                ports.iter().map(move |&(drive, port)| {
                    let mut entry = entry.clone();
                    entry.port = port;
                    (drive, entry)
                })
            })
        });
        own.chain(of_lines).collect()
    }

    /// Requests to a drive so far that it did not receive because it was starting.
    #[must_use]
    pub fn starting_requests(&self, drive: DriveId) -> StartingRequests {
        self.at(drive).state.starting
    }

    /// Number of requests to all drives so far that they did not receive because they were starting.
    #[must_use]
    pub fn starting_count(&self) -> u64 {
        self.starting_count
    }

    /// Numbers of messages that a drive has refused so far, and that it did not receive or read.
    #[must_use]
    pub fn failures(&self, drive: DriveId) -> Failures {
        self.at(drive).state.journal.failures()
    }

    /// Number of messages so far on a line of several drives that were corrupt, or for an address that none of them has.
    #[must_use]
    pub fn unanswered_on(&self, Bus(bus): Bus) -> u64 {
        self.buses[bus as usize].journal.failures().unanswered
    }

    /// Number of messages that all journals have taken so far.
    #[must_use]
    pub fn received_count(&self) -> u64 {
        self.outputs.entries
    }

    /// The messages after number `after`, at most the first `most` of them.
    #[must_use]
    pub fn received_after(&self, after: u64, most: usize) -> News {
        let last = self.received_count();
        if last <= after {
            return News { last: after, ..News::default() };
        }
        let drives = self.slots.iter().zip(self.drives());
        let drives = drives.map(|(slot, id)| (Receiver::Drive(id), slot.spec, &slot.state.journal));
        let lines = self.buses.iter().zip(0..).filter_map(|(line, number)| {
            let &(drive, _) = line.ports.first()?;
            Some((Receiver::Line(Bus(number)), self.spec(drive), &line.journal))
        });
        let mut entries = Vec::new();
        for (receiver, spec, journal) in drives.chain(lines) {
            let new = journal.entries().rev().take_while(|entry| entry.number > after);
            entries.extend(new.map(|entry| (receiver, spec, entry)));
        }
        entries.sort_by_key(|(_, _, entry)| entry.number);
        let all = entries.len() <= most;
        entries.truncate(most);
        let last = entries.last().map_or(last, |(_, _, entry)| if all { last } else { entry.number });
        let lost = last - after - entries.len() as u64;
        let entries = entries.into_iter().map(|(receiver, spec, entry)| (receiver, spec, entry.clone()));
        News { entries: entries.collect(), last, lost }
    }

    /// The newest messages after number `after`, at most `most`: to all drives, or to one drive and on its
    /// lines. [`News::lost`] is the number of those that are left out.
    #[must_use]
    pub fn received_lately(&self, after: u64, most: usize, drive: Option<DriveId>) -> News {
        let last = self.received_count();
        if last <= after {
            return News { last: after, ..News::default() };
        }
        let drives = self.drives().filter(|&id| drive.is_none_or(|only| only == id));
        let drives = drives.map(|id| (Receiver::Drive(id), self.spec(id), &self.at(id).state.journal));
        let lines = self.buses.iter().zip(0..).filter_map(|(line, number)| {
            let (of, _) = match drive {
                None => line.ports.first()?,
                Some(drive) => line.ports.iter().find(|(id, _)| *id == drive)?,
            };
            Some((Receiver::Line(Bus(number)), self.spec(*of), &line.journal))
        });
        let (mut entries, mut held) = (Vec::new(), 0);
        for (receiver, spec, journal) in drives.chain(lines) {
            let new = journal.after(after);
            held += new.len() as u64;
            entries.extend(new.rev().take(most).map(|entry| (receiver, spec, entry)));
        }
        entries.sort_by_key(|(_, _, entry)| entry.number);
        entries.drain(..entries.len().saturating_sub(most));
        // Of all drives the numbers say how many full journals have dropped.
        let all = if drive.is_none() { last - after } else { held };
        let lost = all - entries.len() as u64;
        let entries = entries.into_iter().map(|(receiver, spec, entry)| (receiver, spec, entry.clone()));
        News { entries: entries.collect(), last, lost }
    }

    /// Like [`received_after`](Self::received_after), but only until the first message behind the time until which
    /// [recordings are complete](Self::recorded_until), so that a reader of both has all in the order of time.
    #[must_use]
    pub fn recorded_after(&self, after: u64, most: usize) -> News {
        let mut news = self.received_after(after, most);
        let until = self.recorded_until();
        if let Some(count) = news.entries.iter().position(|(_, _, entry)| entry.at > until)
            && let Some((_, _, first)) = news.entries.get(count)
        {
            news.last = first.number - 1;
            news.entries.truncate(count);
            news.lost = news.last - after - count as u64;
        }
        news
    }

    /// The newest messages after number `after` that all drives, or one drive, have sent by themselves on ports with text,
    /// at most `most`: records of a stream, what a program prints. The latest 100 of each drive are kept.
    #[must_use]
    pub fn own_messages(&self, after: u64, most: usize, drive: Option<DriveId>) -> OwnNews {
        let last = self.outputs.own_messages;
        if last <= after {
            return OwnNews { last: after, ..OwnNews::default() };
        }
        let (mut entries, mut held) = (Vec::new(), 0);
        for id in self.drives().filter(|&id| drive.is_none_or(|only| only == id)) {
            let slot = self.at(id);
            let new = slot.state.own_messages.after(after);
            held += new.len() as u64;
            entries.extend(new.rev().take(most).map(|message| (id, slot.spec, message)));
        }
        entries.sort_by_key(|(_, _, message)| message.number);
        entries.drain(..entries.len().saturating_sub(most));
        // Of all drives the numbers say how many are no longer kept.
        let all = if drive.is_none() { last - after } else { held };
        let left_out = all - entries.len() as u64;
        let entries = entries.into_iter().map(|(id, spec, message)| (id, spec, message.clone()));
        OwnNews { entries: entries.collect(), last, left_out }
    }

    /// A message on one line of text, for logs. On a bench of several drives it begins with the name of the
    /// drive, or of the line: `x.rs485 <- read Speed -> Speed = 5000`.
    #[must_use]
    pub fn received_line(&self, receiver: Receiver, message: &ReceivedMessage) -> String {
        match receiver {
            Receiver::Drive(_) if self.slots.len() == 1 => message.to_string(),
            Receiver::Drive(drive) => format!("{}.{message}", self.name(drive)),
            Receiver::Line(bus) => {
                format!("{} <- {}", self.bus_name(bus), message.exchange)
            }
        }
    }

    /// Records the outcomes of the new entries of a journal, in the trace and in the capture.
    #[inline]
    pub(super) fn record_outcomes(&mut self, receiver: Receiver) {
        if !self.settings.outcomes && !self.capture.is_on() {
            return;
        }
        while let Some(entry) = self.journal(receiver).next_new() {
            self.record_outcome(receiver, &entry);
        }
    }

    fn journal(&mut self, of: Receiver) -> &mut Journal {
        match of {
            Receiver::Drive(DriveId(drive)) => &mut self.slots[drive as usize].state.journal,
            Receiver::Line(Bus(bus)) => &mut self.buses[bus as usize].journal,
        }
    }

    /// Records the outcome of a message, or its change.
    pub(super) fn record_outcome(&mut self, receiver: Receiver, entry: &Entry) {
        let line = match receiver {
            Receiver::Drive(drive) => self.bus(drive, entry.port),
            Receiver::Line(bus) => Some(bus),
        };
        self.capture.receive(
            |medium| match (medium, receiver) {
                (Medium::Line(bus), _) => Some(bus) == line,
                (Medium::Tcp(drive, port, _), Receiver::Drive(of)) => (drive, port) == (of, entry.port),
                (Medium::Tcp(..), Receiver::Line(_)) => false,
            },
            entry,
        );
        if self.settings.outcomes {
            let drives = match receiver {
                Receiver::Drive(drive) => vec![(drive, entry.port)],
                Receiver::Line(bus) => self.ports(bus).to_vec(),
            };
            for (DriveId(drive), port) in drives {
                let mut entry = entry.clone();
                entry.port = port;
                self.trace.record_received(self.now, drive, entry);
            }
        }
    }

    /// Notes characters that a drive does not receive.
    pub(super) fn missed(&mut self, index: u32, input: &InputRecord) {
        let (now, fast) = (self.now, self.fast());
        let Some(entry) = self.slots[index as usize].misses(now, input, fast) else { return };
        self.slots[index as usize].state.enter(entry, &mut self.outputs);
        self.route_outputs();
        self.record_outcomes(Receiver::Drive(DriveId(index)));
    }

    /// Enters a message on a half-duplex line that a drive did not execute. If the message is for this drive,
    /// it goes to the drive's journal. Otherwise it goes to the journal of the line at the end of the turn,
    /// unless another drive takes it.
    pub(super) fn enter_unclaimed(&mut self, drive: u32, mut entry: Entry) {
        let drive = DriveId(drive);
        let Some(Bus(bus)) = self.bus(drive, entry.port) else {
            self.count_starting(drive, &entry);
            return self.enter(drive, entry);
        };
        let SerialLine { on_request, on_early, noise_of_reply: (begin, end), .. } = self.buses[bus as usize];
        let is_noise = begin < entry.at && entry.at <= end;
        entry.early = on_early.filter(|_| !is_noise).map(Box::new);
        entry.on_message =
            if is_noise { FrameEffects::NONE.with(FrameEffect::IsNoise, true) } else { on_request };
        let alone = self.buses[bus as usize].ports.len() == 1;
        let own = self.address(drive);
        let framing = self.spec(drive).ports.get(usize::from(entry.port.0)).map(|port| port.framing);
        let framing = framing.unwrap_or(Framing::Silence);
        let message = Message { framing, ascii: entry.ascii, bytes: entry.message() };
        let address = message.address();
        let listened = !matches!(
            entry.outcome,
            Outcome::Dropped(DropReason::Starting) | Outcome::NoPower | Outcome::PowerLost | Outcome::Sending
        );
        // A corrupt frame has no address.
        let flaw = if listened { None } else { flaw(&message, entry.unreadable) };
        // What drives hear of a request that collided is in the entry of this request.
        let collisions = &self.buses[bus as usize].collisions;
        if collisions.as_ref().is_some_and(|collisions| collisions.has_collided())
            && (entry.unreadable > 0 || !message.is_whole())
        {
            return;
        }
        if let (false, true) = (alone, is_noise) {
            if listened {
                entry.outcome = flaw.unwrap_or(entry.outcome);
                self.enter_noise(bus, entry);
            }
            return;
        }
        let is_own = flaw.is_some() || address.is_none_or(|address| address == 0 || own == Some(address));
        let for_other = match entry.outcome {
            Outcome::Dropped(DropReason::Address) => true,
            _ => !listened && !is_own,
        };
        if let (false, Some(flaw)) = (alone, flaw) {
            entry.outcome = flaw;
            let _ = self.buses[bus as usize].unheard.get_or_insert_with(|| Box::new((entry, false)));
            return;
        }
        if is_own && address != Some(0) {
            self.count_starting(drive, &entry);
        }
        if let (false, Outcome::NoMessage(_)) = (alone, entry.outcome) {
            return self.enter_stray(bus, entry);
        }
        match (alone, for_other) {
            (true, true) => {
                let addresses: Vec<u8> = own.into_iter().collect();
                self.enter(drive, entry.without_drive(&addresses));
            }
            (true, _) => self.enter(drive, entry),
            (false, false) if !matches!(entry.outcome, Outcome::Dropped(why) if why != DropReason::Starting) =>
            {
                self.buses[bus as usize].claimed = true;
                self.enter(drive, entry);
            }
            (false, _) => {
                let line = &mut self.buses[bus as usize];
                let frame = if listened { &mut line.unclaimed } else { &mut line.unheard };
                let _ = frame.get_or_insert_with(|| Box::new((entry, for_other)));
            }
        }
    }

    /// Adds an entry to the journal of a drive.
    fn enter(&mut self, drive: DriveId, entry: Entry) {
        self.slots[drive.0 as usize].state.journal.push(&mut self.outputs.entries, entry);
    }

    /// Counts a message for a drive that is starting.
    fn count_starting(&mut self, drive: DriveId, entry: &Entry) {
        if matches!(entry.outcome, Outcome::Dropped(DropReason::Starting)) {
            let starting = &mut self.at_mut(drive).state.starting;
            *starting = StartingRequests { count: starting.count + 1, left: entry.deaf_for };
            self.starting_count += 1;
        }
    }

    /// Enters characters with errors on a line with text, when no more follow at once.
    pub(super) fn enter_unreadable(&mut self, bus: u32) {
        for n in 0..self.ports(Bus(bus)).len() {
            let (drive, port) = self.ports(Bus(bus))[n];
            let Some(entry) = self.at_mut(drive).unreadable(port) else { continue };
            self.slots[drive.0 as usize].state.enter(entry, &mut self.outputs);
            self.route_outputs();
            self.record_outcomes(Receiver::Drive(drive));
        }
    }

    /// Enters the line of text that a client leaves incomplete on a TCP connection.
    pub(super) fn enter_unfinished(&mut self, drive: DriveId, port: Port, link: Link) {
        let Some(entry) = self.at_mut(drive).state.reception.unfinished(port, link) else { return };
        self.slots[drive.0 as usize].state.enter(entry, &mut self.outputs);
        self.route_outputs();
        self.record_outcomes(Receiver::Drive(drive));
    }

    /// Enters characters of a shared line that are no message in the journal of the line, once: every drive of the
    /// line reports them.
    fn enter_stray(&mut self, bus: u32, entry: Entry) {
        let SerialLine { journal, strayed, .. } = &mut self.buses[bus as usize];
        *strayed = true;
        let is_known = journal.last_mut().is_some_and(|last| {
            (last.at, last.outcome, last.message()) == (entry.at, entry.outcome, entry.message())
        });
        if !is_known {
            journal.push(&mut self.outputs.entries, entry);
            self.record_outcomes(Receiver::Line(Bus(bus)));
        }
    }

    /// Enters noise that followed a reply in the journal of the line, once: every drive of the line reports it, after the
    /// end of the turn.
    fn enter_noise(&mut self, bus: u32, entry: Entry) {
        let SerialLine { journal, noise_entered, .. } = &mut self.buses[bus as usize];
        if std::mem::replace(noise_entered, entry.at) < entry.at {
            journal.push(&mut self.outputs.entries, entry);
            self.record_outcomes(Receiver::Line(Bus(bus)));
        }
    }

    /// Marks the present frame of a line as one that a drive has executed or refused, with or without an answer.
    pub(super) fn claim(&mut self, drive: u32, port: Port, answers: bool) {
        let Some(Bus(bus)) = self.bus(DriveId(drive), port) else { return };
        let line = &mut self.buses[bus as usize];
        line.claimed = true;
        if !answers {
            line.requests.answer();
        }
        let (effects, early) = (line.on_request, line.on_early);
        if let Some(entry) = self.at_mut(DriveId(drive)).state.journal.last_mut()
            && entry.port == port
        {
            (entry.on_message, entry.early) = (effects, early.map(Box::new));
        }
    }

    /// Enters a message that no drive receives whole because of a fault.
    pub(super) fn enter_lost(&mut self, outlet: Outlet, at: Instant, bytes: &[u8], effects: FrameEffects) {
        self.enter_undelivered(outlet, at, bytes, Outcome::Lost, effects);
    }

    /// Enters a message that the line or TCP port did not deliver at `at`: in the journal of the drive that it was for
    /// or, if there is none or it was for all, in that of the line.
    pub(super) fn enter_undelivered(
        &mut self,
        outlet: Outlet,
        at: Instant,
        bytes: &[u8],
        outcome: Outcome,
        effects: FrameEffects,
    ) {
        if !self.settings.journals {
            return;
        }
        let (ports, ascii) = match outlet {
            Outlet::Tcp(drive, port) => (vec![(drive, port)], false),
            Outlet::Line(bus) => (self.ports(bus).to_vec(), self.framed(bus.0).is_some_and(ascii::is_on)),
        };
        let message = Message { framing: Framing::Silence, ascii, bytes };
        let receiver = match ports[..] {
            [one] => Some(one),
            _ => ports.iter().copied().find(|&(drive, _)| self.address(drive) == message.address()),
        };
        let Some(&(_, first)) = ports.first() else { return };
        let mut draft = Draft::default();
        draft.begin(bytes);
        let mut entry = draft.entry(at, receiver.map_or(first, |(_, port)| port), outcome);
        (entry.ascii, entry.on_message) = (ascii, effects);
        match (receiver, outlet) {
            (Some((drive, _)), _) => {
                self.enter(drive, entry);
                self.record_outcomes(Receiver::Drive(drive));
            }
            (None, Outlet::Line(bus)) => {
                self.buses[bus.0 as usize].journal.push(&mut self.outputs.entries, entry);
                self.record_outcomes(Receiver::Line(bus));
            }
            (None, Outlet::Tcp(..)) => {}
        }
    }

    /// Enters bytes on a Modbus/TCP connection that are no message.
    pub(super) fn enter_broken(&mut self, drive: DriveId, port: Port, bytes: &[u8], why: NoMessage) {
        if !self.settings.journals {
            return;
        }
        let mut draft = Draft::default();
        draft.begin(bytes);
        let entry = draft.entry(self.now, port, Outcome::NoMessage(why));
        self.enter(drive, entry);
        self.record_outcomes(Receiver::Drive(drive));
    }

    /// Enters a request to a drive that ended at `at`, with the answer of a fault, if there is one.
    pub(super) fn enter_refused(
        &mut self,
        (drive, port): (DriveId, Port),
        at: Instant,
        (request, answer): (&[u8], &[u8]),
        outcome: Outcome,
        effects: FrameEffects,
    ) {
        if !self.settings.journals {
            return;
        }
        let mut draft = Draft::default();
        draft.begin(request);
        draft.answer(answer);
        let mut entry = draft.entry(at, port, outcome);
        if let Some(bus) = self.bus(drive, port) {
            entry.ascii = ascii::is_on(self.line(bus));
            entry.early = self.buses[bus.0 as usize].on_early.map(Box::new);
        }
        entry.on_message = effects;
        self.enter(drive, entry);
        self.record_outcomes(Receiver::Drive(drive));
    }

    /// Notes the effects that faults had on a drive's reply. The note is in the journal's entry of the request.
    pub(super) fn note_reply(&mut self, drive: DriveId, port: Port, bytes: &[u8], effects: FrameEffects) {
        if let Some(entry) = self.at_mut(drive).state.journal.answered_with(port, bytes) {
            entry.on_answer = entry.on_answer.and(effects);
            let entry = entry.clone();
            self.record_outcome(Receiver::Drive(drive), &entry);
        }
    }

    /// Notes in the journal that other characters on the line overlapped the present reply of a drive.
    pub(super) fn note_collision(&mut self, drive: DriveId, port: Port) {
        if let Some(entry) = self.at_mut(drive).state.journal.last_answered(port) {
            entry.on_answer = entry.on_answer.with(FrameEffect::Collided, true);
            let entry = entry.clone();
            self.record_outcome(Receiver::Drive(drive), &entry);
        }
    }

    /// Enters the requests on a line that have collided.
    fn enter_collided(&mut self, bus: u32) {
        let now = self.now;
        let Some(collisions) = &mut self.buses[bus as usize].collisions else { return };
        for SentRequest { end, bytes, effects, with, .. } in collisions.take_ended(now) {
            if let Some(with) = with {
                let outcome = Outcome::Collided(with);
                self.enter_undelivered(Outlet::Line(Bus(bus)), end, &bytes, outcome, effects);
            }
        }
    }

    /// Notes in the journal which answers of a serial port, whose characters last so long, end after now, when the drive
    /// loses its power.
    pub(super) fn note_unsent(&mut self, drive: DriveId, port: Port, character: Duration) {
        let now = self.now;
        let entries = self.at_mut(drive).state.journal.answered_after(port, now).map(|entry| {
            let unsent = entry.answer_until.since(now).ticks().div_ceil(character.ticks());
            let unsent = u16::try_from(unsent).unwrap_or(u16::MAX);
            entry.sent_of_answer = Some((entry.answer().len() as u16).saturating_sub(unsent));
            entry.clone()
        });
        for entry in entries.collect::<Vec<_>>() {
            self.record_outcome(Receiver::Drive(drive), &entry);
        }
    }

    /// Notes in the journal that a drive lost its power before delayed answers, the entries with these numbers, reached a
    /// client of a TCP port.
    pub(super) fn note_lost_replies(&mut self, drive: DriveId, numbers: impl IntoIterator<Item = u64>) {
        for number in numbers {
            if let Some(entry) = self.at_mut(drive).state.journal.numbered(number) {
                entry.sent_of_answer = Some(0);
                let entry = entry.clone();
                self.record_outcome(Receiver::Drive(drive), &entry);
            }
        }
    }

    /// Notes the effects of faults on a reply on a port with lines of text in the entry after number `before`, or in
    /// the next one if the line has not ended yet.
    pub(super) fn note_text_reply(&mut self, drive: DriveId, port: Port, before: u64, effects: FrameEffects) {
        let state = &mut self.at_mut(drive).state;
        if let Some(entry) = state.journal.last_after(port, before) {
            entry.on_answer = entry.on_answer.and(effects);
            let entry = entry.clone();
            self.record_outcome(Receiver::Drive(drive), &entry);
        } else if state.reception.has_part(port)
            && let Some(port) = state.ports.get_mut(usize::from(port.0))
        {
            port.on_echo = port.on_echo.and(effects);
        }
    }

    /// Ends a frame on a shared line: enters it in the journal of the line if no drive has taken it.
    pub(super) fn enter_frame(&mut self, bus: u32) {
        if std::mem::take(&mut self.buses[bus as usize].in_characters) {
            self.enter_missed_frames(bus);
        }
        self.enter_collided(bus);
        let line = &mut self.buses[bus as usize];
        let claimed = std::mem::take(&mut line.claimed);
        let strayed = std::mem::take(&mut line.strayed);
        let unheard = line.unheard.take().filter(|_| !strayed);
        let frame = line.unclaimed.take().or(unheard);
        let Some((entry, for_other)) = frame.filter(|_| !claimed).map(|frame| *frame) else { return };
        let entry = if for_other {
            let addresses: Vec<u8> =
                self.ports(Bus(bus)).iter().filter_map(|&(drive, _)| self.address(drive)).collect();
            entry.without_drive(&addresses)
        } else {
            entry
        };
        let line = &mut self.buses[bus as usize];
        line.journal.push(&mut self.outputs.entries, entry);
        self.record_outcomes(Receiver::Line(Bus(bus)));
    }

    /// Enters a frame whose characters arrived one by one for the drives that did not receive them.
    fn enter_missed_frames(&mut self, bus: u32) {
        for n in 0..self.ports(Bus(bus)).len() {
            let (drive, port) = self.ports(Bus(bus))[n];
            let Some(entry) = self.at_mut(drive).missed_frame(port) else { continue };
            self.enter_unclaimed(drive.0, entry);
            self.record_outcomes(Receiver::Drive(drive));
        }
    }

    /// Address of a drive on its line, from its register.
    pub(crate) fn address(&self, drive: DriveId) -> Option<u8> {
        u8::try_from(self.peek(drive, self.spec(drive).address?)).ok()
    }
}
