//! Reception: joins the bytes that a port received with the outcome that the drive reports, and with the
//! answer.
//!
//! The outcome of a message that silence ends ([`Framing::Silence`]) concerns the bytes of earlier inputs,
//! because the drive looks at the old message before it takes a new byte. So these bytes are noted after the
//! call of the drive; only a drive that starts reports the outcome of the present ones. On other ports the outcome
//! concerns the bytes of the present input, too, and they are noted before the call. The answer is put after the
//! outcome in the same call of the drive; on a port with lines of text over TCP, also before the outcome, because
//! what a line prints comes first.
//!
//! On a shared line every drive receives every frame, most of them for others. So a frame of another drive, and a
//! frame that another drive of the line has reported already, cost a few instructions only.

use std::mem;

use drivetwin_firmware::device::{
    DropReason, Duration, Framing, Instant, Line, Link, LogEvent, Port, Reason, Spec,
};
use drivetwin_protocol::modbus::ascii;

use crate::decode::text::{BACKSPACE, is_key, key_at_end, typed};
use crate::record::journal::{Draft, Entry, NoMessage, Outcome};
use crate::record::own_messages;

/// Maximum number of bytes that wait for an outcome; further bytes are left out.
const LONGEST: usize = 1 << 10;

/// Bytes that a port has received and whose outcome the drive has not reported yet.
#[derive(Debug, Default)]
struct Part {
    bytes: Vec<u8>,
    /// Number of characters with an error.
    unreadable: u8,
    /// End of the last character.
    end: Instant,
    /// True if another drive of the line sent some of the characters.
    overheard: bool,
    /// The outcome, if the drive does not receive the characters, which arrive one by one, or this part of a text.
    missed: Option<Outcome>,
}

impl Part {
    fn is_empty(&self) -> bool {
        self.bytes.is_empty() && self.unreadable == 0 && !self.overheard
    }

    fn clear(&mut self) {
        self.bytes.clear();
        (self.unreadable, self.overheard, self.missed) = (0, false, None);
    }
}

/// Receiving half of a port.
#[derive(Debug)]
struct PortReception {
    framing: Framing,
    ascii: bool,
    /// Bytes whose outcome the drive has not reported yet.
    part: Part,
    /// Connection of the bytes.
    link: Link,
    /// Incomplete lines of other connections.
    others: Vec<(Link, Part)>,
    /// Number of characters with an error that have an entry of their own, and because of which the drive refuses the
    /// present line of text.
    spoiled: u8,
}

impl PortReception {
    fn is_text(&self) -> bool {
        matches!(self.framing, Framing::Character | Framing::Return)
    }

    /// The entry of a part of a text that never becomes a line. `outcome` is that of characters that the drive received.
    fn cut_off(&mut self, number: Port, outcome: Outcome) -> Entry {
        let part = &mut self.part;
        let outcome = part.missed.unwrap_or(outcome);
        let mut draft = Draft::default();
        draft.begin(last_line(self.framing, &part.bytes));
        let mut entry = draft.entry(part.end, number, outcome);
        (entry.unreadable, entry.deaf_for) = (part.unreadable, None);
        part.clear();
        entry
    }
}

/// Message whose outcome is known in the present call.
#[derive(Clone, Copy, Debug)]
struct Open {
    port: Port,
    at: Instant,
    outcome: Outcome,
    unreadable: u8,
    link: Link,
}

/// Reception of a drive.
#[derive(Debug)]
pub(crate) struct Reception {
    ports: Vec<PortReception>,
    open: Option<Open>,
    draft: Draft,
    /// What the drive sent on text ports in the present call, before the outcome.
    before: Vec<u8>,
    /// Entries that the present call has completed before the entry of `open`.
    done: Vec<Entry>,
    /// Port on which the drive does not receive the present characters, and the outcome.
    ignores: Option<(Port, Outcome)>,
    /// True if the present call has outcomes.
    touched: bool,
    /// True while the characters that arrive are those of another drive.
    pub(crate) overhears: bool,
    /// True if text has arrived in the present call, so that what the drive sends may be its echo.
    hears_text: bool,
    /// Port on which the drive sends text by itself in the present call.
    own_port: Option<Port>,
    /// That text.
    own: Vec<u8>,
}

impl Reception {
    pub(super) fn new(spec: &Spec) -> Self {
        let port = |framing| PortReception {
            framing,
            ascii: false,
            part: Part::default(),
            link: Link(0),
            others: Vec::new(),
            spoiled: 0,
        };
        Self {
            ports: spec.ports.iter().map(|spec| port(spec.framing)).collect(),
            open: None,
            draft: Draft::default(),
            before: Vec::new(),
            done: Vec::new(),
            ignores: None,
            touched: false,
            overhears: false,
            hears_text: false,
            own_port: None,
            own: Vec::new(),
        }
    }

    /// Notes nothing from now on.
    pub(crate) fn switch_off(&mut self) {
        self.ports.clear();
    }

    /// Returns true if nothing is noted.
    pub(super) fn is_off(&self) -> bool {
        self.ports.is_empty()
    }

    /// Forgets all bytes without an outcome, at power-on.
    pub(super) fn clear(&mut self) {
        for port in &mut self.ports {
            port.part.clear();
            port.others.clear();
            port.spoiled = 0;
        }
    }

    /// Returns true if the characters of a port are noted after the call of the drive.
    pub(super) fn notes_afterwards(&self, port: Port) -> bool {
        self.ports.get(usize::from(port.0)).is_some_and(|port| port.framing == Framing::Silence)
    }

    /// Notes characters that another drive of the line sends: they are no message to this one.
    pub(super) fn overhear(&mut self, port: Port) {
        // A drive that starts takes none of them for a part of a later message.
        if self.ignores.take().is_some_and(|(ignored, _)| ignored == port) {
            return;
        }
        if let Some(port) = self.ports.get_mut(usize::from(port.0)) {
            port.part.overheard = true;
        }
    }

    /// Notes characters. The first one ends at `at`, each further one after `character`. `is_deaf` tells if the drive
    /// does not receive yet.
    pub(super) fn characters(
        &mut self,
        at: Instant,
        number: Port,
        line: Line,
        character: Duration,
        bytes: &[u8],
        is_deaf: impl FnOnce() -> bool,
    ) {
        let Some(port) = self.ports.get_mut(usize::from(number.0)) else { return };
        port.ascii = port.framing == Framing::Silence && ascii::is_on(line);
        self.hears_text |= port.is_text();
        if port.framing == Framing::Character {
            // A backspace cancels the line, and the errors of its characters.
            let is_cancelled = bytes == [BACKSPACE] && port.part.unreadable > 0;
            if is_cancelled || (port.part.missed.is_some() && !is_deaf()) {
                self.done.push(port.cut_off(number, Outcome::Dropped(DropReason::RxError)));
                self.touched = true;
            }
            port.spoiled = if bytes == [BACKSPACE] { 0 } else { port.spoiled };
        }
        let part = &mut port.part;
        let ignored = self.ignores.take().filter(|(port, _)| *port == number).map(|(_, outcome)| outcome);
        // The drive takes only what it receives for its next message.
        if ignored.is_none() && part.missed.is_some() && port.framing == Framing::Silence {
            part.clear();
        }
        // What another drive began to say ends at the colon of the next message.
        if port.ascii && part.overheard && bytes.contains(&b':') {
            part.clear();
        }
        let room = LONGEST.saturating_sub(part.bytes.len()).min(bytes.len());
        part.bytes.extend_from_slice(&bytes[..room]);
        part.unreadable = part.unreadable.saturating_add(u8::from(bytes.is_empty()));
        part.end = at + character * bytes.len().saturating_sub(1) as u64;
        let is_ascii = port.ascii;
        match ignored {
            Some(outcome) if bytes.len() < 2 => part.missed = part.missed.or(Some(outcome)),
            Some(outcome) => self.begin(number, 0, outcome),
            None if is_ascii => self.take_stray(number),
            None => {}
        }
    }

    /// Enters the characters that are no part of a message of Modbus ASCII, because the drive does not look at
    /// them: those before the last colon, and a text without a colon up to its line feed.
    fn take_stray(&mut self, number: Port) {
        let Some(port) = self.ports.get_mut(usize::from(number.0)) else { return };
        let Part { bytes, end, overheard, .. } = &mut port.part;
        let stray = match bytes.iter().rposition(|&character| character == b':') {
            Some(colon) => colon,
            None if bytes.ends_with(b"\n") || bytes.len() == LONGEST => bytes.len(),
            None => 0,
        };
        if stray == 0 {
            return;
        }
        let why = if bytes.first() == Some(&b':') { NoMessage::NextColon } else { NoMessage::NoColon };
        // An end of a line alone, after a message of which a part was lost, says nothing.
        if !*overheard && bytes[..stray].iter().any(u8::is_ascii_graphic) {
            let mut draft = Draft::default();
            draft.begin(&bytes[..stray]);
            let mut entry = draft.entry(*end, number, Outcome::NoMessage(why));
            entry.ascii = true;
            self.done.push(entry);
            self.touched = true;
        }
        bytes.drain(..stray);
        if bytes.is_empty() {
            port.part.clear();
        }
    }

    /// End of the frame on a half-duplex line whose outcome the drive reports now, if a client sent the frame.
    pub(super) fn frame_end(&self, port: Port) -> Option<Instant> {
        let port = self.ports.get(usize::from(port.0))?;
        (port.framing == Framing::Silence && !port.part.overheard).then_some(port.part.end)
    }

    /// Forgets the frame whose outcome the drive reports now.
    pub(super) fn skip(&mut self, port: Port) {
        self.finish_message();
        if let Some(port) = self.ports.get_mut(usize::from(port.0)) {
            port.part.clear();
        }
    }

    /// Notes a message of the present call. `is_deaf` tells if the drive does not receive yet.
    pub(super) fn message(
        &mut self,
        at: Instant,
        number: Port,
        link: Link,
        bytes: &[u8],
        is_deaf: impl FnOnce() -> bool,
    ) {
        let Some(port) = self.ports.get_mut(usize::from(number.0)) else { return };
        self.hears_text |= port.is_text();
        if port.link != link {
            let old = mem::take(&mut port.part);
            if !old.is_empty() {
                port.others.push((port.link, old));
            }
            if let Some(place) = port.others.iter().position(|(other, _)| *other == link) {
                port.part = port.others.swap_remove(place).1;
            }
            port.link = link;
        }
        if port.part.missed.is_some() && !is_deaf() {
            self.done.push(port.cut_off(number, Outcome::Dropped(DropReason::Starting)));
            self.touched = true;
        }
        let room = LONGEST.saturating_sub(port.part.bytes.len()).min(bytes.len());
        port.part.bytes.extend_from_slice(&bytes[..room]);
        port.part.end = at;
    }

    /// The entry of characters with errors on a port with text, and of those beside them, when no more follow at once.
    /// The drive refuses the line that they are in, whatever follows.
    pub(super) fn unreadable(&mut self, number: Port) -> Option<Entry> {
        let port = self.ports.get_mut(usize::from(number.0))?;
        let unreadable = port.part.unreadable;
        if !port.is_text() || unreadable == 0 {
            return None;
        }
        let entry = port.cut_off(number, Outcome::Dropped(DropReason::RxError));
        if entry.outcome == Outcome::Dropped(DropReason::RxError) {
            port.spoiled = port.spoiled.saturating_add(unreadable);
        }
        Some(entry)
    }

    /// Notes that a program has opened the port at the other end, which resets a QSB: what it received of a line is
    /// lost.
    pub(super) fn opened(&mut self, number: Port) {
        let Some(port) = self.ports.get_mut(usize::from(number.0)) else { return };
        if port.framing == Framing::Character {
            port.spoiled = 0;
            if !last_line(port.framing, &port.part.bytes).is_empty() || port.part.unreadable > 0 {
                self.done.push(port.cut_off(number, Outcome::Dropped(DropReason::Starting)));
                self.touched = true;
            }
            port.part.clear();
        }
    }

    /// Returns true if a port has bytes without an outcome.
    pub(crate) fn has_part(&self, port: Port) -> bool {
        self.ports.get(usize::from(port.0)).is_some_and(|port| !port.part.is_empty())
    }

    /// Returns true if no characters of a port wait for an outcome.
    pub(super) fn is_silent(&self, port: Port) -> bool {
        self.ignores.is_none() && !self.has_part(port)
    }

    /// The entry of the incomplete line of a connection whose client has left.
    pub(crate) fn unfinished(&mut self, number: Port, link: Link) -> Option<Entry> {
        let port = self.ports.get_mut(usize::from(number.0))?;
        if port.link != link {
            let place = port.others.iter().position(|(other, _)| *other == link)?;
            let present = mem::replace(&mut port.part, port.others.swap_remove(place).1);
            if !present.is_empty() {
                port.others.push((port.link, present));
            }
            port.link = link;
        }
        let is_typed = port.part.unreadable > 0 || !last_line(port.framing, &port.part.bytes).is_empty();
        is_typed.then(|| port.cut_off(number, Outcome::NoMessage(NoMessage::Disconnected)))
    }

    /// Forgets the incomplete line of a connection.
    pub(super) fn closed(&mut self, port: Port, link: Link) {
        let Some(port) = self.ports.get_mut(usize::from(port.0)) else { return };
        port.others.retain(|(other, _)| *other != link);
        if port.link == link {
            port.part.clear();
        }
    }

    /// Takes a note of the drive.
    pub(super) fn note(&mut self, note: LogEvent) {
        if self.is_off() {
            return;
        }
        self.touched = true;
        match note {
            LogEvent::Dropped { port, why: DropReason::Starting } if self.notes_afterwards(port) => {
                self.ignore(port, Outcome::Dropped(DropReason::Starting));
            }
            LogEvent::Reason(Reason(code)) => {
                self.finish_message();
                self.draft.reason(Reason(code));
            }
            LogEvent::Request { port, function, .. } => self.begin(port, function, Outcome::Accepted),
            LogEvent::Refused { port, code, function } => self.begin(port, function, Outcome::Refused(code)),
            LogEvent::Dropped { port, why } => self.begin(port, 0, Outcome::Dropped(why)),
        }
    }

    /// Notes bytes that the drive sends. `link` is `None` on a serial port.
    pub(super) fn sent(&mut self, port: Port, link: Option<Link>, bytes: &[u8]) {
        match self.open {
            Some(open) if open.port == port && link.is_none_or(|link| link == open.link) => {
                self.draft.answer(bytes);
            }
            None => {
                let of = self.ports.get(usize::from(port.0));
                let prints = of.is_some_and(|of| of.framing == Framing::Return && link == Some(of.link));
                if prints && self.before.len() < LONGEST {
                    self.touched = true;
                    self.before.extend_from_slice(bytes);
                }
                if !self.hears_text && of.is_some_and(PortReception::is_text) {
                    let _ = self.own_port.get_or_insert(port);
                    let room = own_messages::LONGEST.saturating_sub(self.own.len()).min(bytes.len());
                    self.own.extend_from_slice(&bytes[..room]);
                }
            }
            Some(_) => {}
        }
    }

    /// Notes that the drive does not receive the noted characters, because it has no power or is sending.
    /// Returns the entry when the message is complete.
    pub(super) fn missed(&mut self, port: Port, outcome: Outcome) -> Option<Entry> {
        self.begin(port, 0, outcome);
        let open = self.open.take()?;
        let mut entry = self.draft.entry(open.at, port, outcome);
        (entry.ascii, entry.deaf_for) = (self.ports.get(usize::from(port.0))?.ascii, None);
        entry.unreadable = open.unreadable;
        Some(entry)
    }

    /// Notes that the drive does not receive the characters that are noted next.
    pub(super) fn ignore(&mut self, port: Port, outcome: Outcome) {
        self.ignores = Some((port, outcome));
    }

    /// The message that the drive had received, wholly or in part, and not reported when its power failed at `at`.
    pub(super) fn power_lost(&mut self, port: Port, at: Instant) -> Option<Entry> {
        let reception = self.ports.get_mut(usize::from(port.0))?;
        if reception.part.is_empty() {
            return None;
        }
        if reception.part.missed.is_some() {
            return reception.is_text().then(|| reception.cut_off(port, Outcome::PowerLost));
        }
        self.begin(port, 0, Outcome::PowerLost);
        let mut entry = self.open_entry()?;
        (entry.at, entry.deaf_for) = (entry.at.min(at), None);
        Some(entry)
    }

    /// The entry of a frame that has ended and whose characters the drive missed one by one.
    pub(super) fn missed_frame(&mut self, port: Port) -> Option<Entry> {
        let outcome = self.ports.get(usize::from(port.0))?.part.missed?;
        self.missed(port, outcome)
    }

    /// Ends the present call, and returns its last entry. `receives_from` is the time from which the drive receives.
    pub(super) fn finish(&mut self, receives_from: impl FnOnce() -> Instant) -> Option<Entry> {
        (self.touched, self.ignores) = (false, None);
        self.before.clear();
        let last = self.open_entry();
        self.draft.clear();
        let mut entry = last.or_else(|| self.done.pop())?;
        if entry.outcome != Outcome::Accepted {
            let from = receives_from();
            entry.deaf_for = (from < Instant::NEVER).then(|| from.since(entry.at));
        }
        Some(entry)
    }

    /// The entries of the present call before that of [`finish`](Self::finish).
    pub(super) fn earlier_entries(&mut self) -> Vec<Entry> {
        mem::take(&mut self.done)
    }

    /// Notes the number of the error with which the drive refused the message.
    pub(super) fn note_error(&mut self, number: impl FnOnce() -> u8) {
        if self.open.is_some_and(|open| matches!(open.outcome, Outcome::Refused(_))) {
            self.draft.reason(Reason(number()));
        }
    }

    /// Ends the present call, and returns what the drive has sent by itself, to be taken.
    pub(super) fn take_own(&mut self) -> Option<(Port, &mut Vec<u8>)> {
        self.hears_text = false;
        Some((self.own_port.take()?, &mut self.own))
    }

    /// Returns true if the present call has outcomes.
    pub(super) fn is_touched(&self) -> bool {
        self.touched
    }

    /// Begins the entry of the bytes that an outcome concerns. `function` is that of the message.
    fn begin(&mut self, number: Port, function: u8, outcome: Outcome) {
        self.finish_message();
        let Some(port) = self.ports.get_mut(usize::from(number.0)) else { return };
        let is_text = port.is_text();
        let part = &mut port.part;
        if is_text {
            // The drive reports a character with an error before the line has ended.
            if outcome == Outcome::Dropped(DropReason::RxError) {
                return;
            }
            if is_missed(outcome) {
                // What was typed before is lost, on all connections.
                let parts = port.others.iter_mut().map(|(_, part)| part).chain([&mut *part]);
                for part in parts.filter(|part| !part.is_empty()) {
                    part.missed = Some(outcome);
                }
                port.spoiled = 0;
                if !matches!(part.bytes.last(), Some(b'\r' | b'\n')) {
                    return;
                }
            }
        }
        // A key of MCode acts without the end of a line; more may follow it.
        let is_key = port.framing == Framing::Return && is_key(function);
        let key = part.bytes.iter().position(|&byte| is_key && byte == function);
        let rest = key.map(|key| part.bytes.split_off(key + 1)).unwrap_or_default();
        let bytes = match port.framing {
            Framing::Character | Framing::Return => last_line(port.framing, &part.bytes),
            Framing::Silence | Framing::Mbap => &part.bytes,
        };
        if (bytes.is_empty() && part.unreadable == 0) || part.overheard {
            self.draft.clear();
        } else {
            self.draft.begin(bytes);
            self.draft.answer(&self.before);
            let Part { end, unreadable, .. } = *part;
            let unreadable = unreadable.saturating_add(port.spoiled);
            self.open = Some(Open { port: number, at: end, outcome, unreadable, link: port.link });
        }
        self.before.clear();
        port.spoiled = 0;
        part.clear();
        part.bytes = rest;
    }

    /// Completes the entry whose outcome is known, because the call has another one.
    fn finish_message(&mut self) {
        if self.open.is_some() {
            let entry = self.open_entry();
            self.done.extend(entry);
        }
    }

    /// The entry whose outcome is known.
    fn open_entry(&mut self) -> Option<Entry> {
        let Open { port, at, outcome, unreadable, .. } = self.open.take()?;
        let ascii = self.ports.get(usize::from(port.0)).is_some_and(|port| port.ascii);
        let mut entry = self.draft.entry(at, port, outcome);
        (entry.ascii, entry.unreadable) = (ascii, unreadable);
        Some(entry)
    }
}

/// Returns true if the drive does not receive what has this outcome.
fn is_missed(outcome: Outcome) -> bool {
    matches!(outcome, Outcome::Dropped(DropReason::Starting) | Outcome::NoPower | Outcome::Sending)
}

/// The last line of text, without the line ends before it; empty if nothing is left of it. In a line of a QSB a
/// backspace cancels the text before it.
fn last_line(framing: Framing, text: &[u8]) -> &[u8] {
    let is_end = |byte: &u8| matches!(byte, b'\r' | b'\n');
    let end = text.iter().rposition(|byte| !is_end(byte)).map_or(0, |place| place + 1);
    let cancels = |byte: &u8| framing == Framing::Character && *byte == BACKSPACE;
    let begin =
        text[..end].iter().rposition(|byte| is_end(byte) || cancels(byte)).map_or(0, |place| place + 1);
    let is_empty = match framing {
        Framing::Return => typed(&text[begin..end]).is_empty() && key_at_end(&text[begin..end]).is_none(),
        _ => begin == end,
    };
    if is_empty { &[] } else { &text[begin..] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_line_is_what_the_drive_took() {
        let (qsb, mcode) = (Framing::Character, Framing::Return);
        for (framing, text, line) in [
            (qsb, &b"R00\r"[..], &b"R00\r"[..]),
            (qsb, b"\nR00\r\n", b"R00\r\n"),
            (qsb, b"R0\x08R01\r", b"R01\r"),
            (qsb, b"R0\x09\r", b"R0\x09\r"),
            (qsb, b"\x00\r", b"\x00\r"),
            (mcode, b"PR PV\x08\r\n", b"PR PV\x08\r\n"),
            (mcode, b"P\x08\r\n", b""),
            (qsb, b"\r\n", b""),
            (qsb, b"", b""),
            (qsb, b"R\x08\r", b""),
        ] {
            assert_eq!(last_line(framing, text), line, "{}", text.escape_ascii());
        }
    }
}
