//! Faults of TCP ports, in the stream between a client and its drive (BENCH-19): a drive receives the disturbed
//! requests, a client the disturbed replies.

use std::collections::VecDeque;

use drivetwin_firmware::device::{Duration, Instant, Line, Port, Spec};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::pdu::EXCEPTION_BIT;
use drivetwin_protocol::modbus::tcp::{self, Header, Splitter};

use super::events::EventKind;
use super::tcp_clients::{Connection, split_off};
use super::{Bench, DriveId, Ended, Outlet};
use crate::line::fault_rules::Content;
use crate::line::faults::{Disturbance, FrameFaults, LineFaults, Party};
use crate::record::capture::Source;
use crate::record::effects::{FrameEffect, FrameEffects};
use crate::record::journal::Outcome;
use crate::scheduler::Phase;

/// A stream has bytes of 8 bits and no parity.
const STREAM: Line = Line::new(9_600, 8, Parity::None, 1);

/// State of the faults on one connection.
pub(super) struct DisturbedStream {
    /// Bytes of requests on which the faults have acted already. They are not scheduled for delivery to the drive yet.
    pub(super) passed: Vec<u8>,
    /// Splitter of `passed`, on a Modbus/TCP port.
    pub(super) splitter: Option<Splitter>,
    /// True if a fault has changed the length of a request, so that `splitter` may have a part of a request.
    altered: bool,
    /// True if a fault has changed the length of the last request.
    pub(super) has_changed: bool,
    /// Content of the last request, if a fault needs it.
    asked: Option<Content>,
    /// The present reply, on a port with lines of text.
    pub(super) reply: Option<TextReply>,
    /// Effects of faults on requests that the drive has not received yet.
    pub(super) on_requests: FrameEffects,
    /// The same for the copy of a request that is sent twice.
    pub(super) on_copy: FrameEffects,
    /// Number of delayed parts of the stream to the client, and of their bytes.
    pub(super) late: usize,
    pub(super) late_bytes: usize,
    /// The journal's entry, if there is one, of the reply that each of these parts belongs to.
    pub(super) late_entries: VecDeque<Option<u64>>,
    /// Time at which the last of these parts arrives.
    late_until: Instant,
}

impl DisturbedStream {
    pub(super) fn new(framed: bool) -> Self {
        Self {
            passed: Vec::new(),
            splitter: framed.then(Splitter::new),
            altered: false,
            has_changed: false,
            asked: None,
            reply: None,
            on_requests: FrameEffects::NONE,
            on_copy: FrameEffects::NONE,
            late: 0,
            late_bytes: 0,
            late_entries: VecDeque::new(),
            late_until: Instant::ZERO,
        }
    }
}

/// A reply on a port with lines of text: all that the drive sends to a client until it takes the next message.
pub(super) struct TextReply {
    fate: Option<FrameFaults>,
    effects: FrameEffects,
    /// The reply so far, if its faults need the whole.
    held: Vec<u8>,
}

/// A part of the stream to a client.
#[derive(Debug)]
pub(crate) enum StreamPart {
    /// Bytes of the drive.
    Bytes(Vec<u8>),
    /// Bytes that no drive has sent.
    Noise(Vec<u8>),
    /// The end of the connection.
    End(Ended),
}

impl StreamPart {
    fn len(&self) -> usize {
        match self {
            Self::Bytes(bytes) | Self::Noise(bytes) => bytes.len(),
            Self::End(_) => 0,
        }
    }
}

/// Faults of lines and TCP ports.
impl Bench {
    /// Sets the faults of a line or TCP port from its next frame on, as
    /// [`set_line_faults`](Self::set_line_faults) does.
    ///
    /// # Panics
    /// If there is no such line or port.
    pub fn set_faults(&mut self, outlet: Outlet, faults: LineFaults) {
        match outlet {
            Outlet::Line(bus) => self.set_line_faults(bus, faults),
            Outlet::Tcp(drive, port) => {
                self.port_disturbance(drive, port).set(faults);
                let all = self.connections.all.values_mut();
                for connection in
                    all.filter(|connection| (connection.drive, connection.port) == (drive, port))
                {
                    connection.disturbed.asked = None;
                }
            }
        }
    }

    /// Checks that a line or TCP port can have these faults: all values are valid there, and the drives and
    /// registers of the rules exist.
    ///
    /// # Errors
    /// One sentence that names the fault and the reason.
    ///
    /// # Panics
    /// If there is no such line or port.
    pub fn check_faults(&self, outlet: Outlet, faults: &LineFaults) -> Result<(), String> {
        match self.port_at(outlet) {
            Some(port) => faults.check_for(port)?,
            None => faults.check()?,
        }
        let party = |id| Party { id, name: self.name(id), spec: self.spec(id) };
        let drives: Vec<Party<'_>> = self.drives_at(outlet).into_iter().map(party).collect();
        faults.check_names(&drives)
    }

    /// Present faults of a line or TCP port; [`LineFaults::NONE`] by default.
    ///
    /// # Panics
    /// If there is no such line.
    #[must_use]
    pub fn faults(&self, outlet: Outlet) -> LineFaults {
        match outlet {
            Outlet::Line(bus) => self.line_faults(bus),
            Outlet::Tcp(drive, port) => {
                let disturbance = self.connections.disturbances.get(&(drive, port));
                disturbance.map_or(LineFaults::NONE, |disturbance| *disturbance.faults())
            }
        }
    }

    /// The faults of a TCP port.
    fn port_disturbance(&mut self, drive: DriveId, port: Port) -> &mut Disturbance {
        let (seed, slot) = (self.settings.seed, &self.slots[drive.0 as usize]);
        self.connections.disturbances.entry((drive, port)).or_insert_with(|| {
            let name = slot.spec.ports.get(usize::from(port.0)).map_or("", |port| port.name);
            Disturbance::of_tcp_port(seed, &format!("{}.{name}", slot.name))
        })
    }

    /// Returns true if the port of a client has faults, or the client's stream has been changed by one.
    pub(super) fn is_disturbed(&self, client: u32) -> bool {
        self.connections.all.get(&client).is_some_and(|connection| {
            let port = self.connections.disturbances.get(&(connection.drive, connection.port));
            connection.disturbed.altered
                || !connection.disturbed.passed.is_empty()
                || port.is_some_and(|port| !port.is_quiet())
        })
    }

    /// The next message of a client that reaches its drive, after faults; `None` if there is none yet.
    pub(super) fn next_disturbed(&mut self, client: u32) -> Result<Option<Vec<u8>>, Ended> {
        loop {
            let Some(connection) = self.connections.all.get_mut(&client) else { return Ok(None) };
            let stream = &mut connection.disturbed;
            if let Some(bytes) =
                split_off(&mut stream.splitter, &mut stream.passed).map_err(Ended::BrokenByFault)?
            {
                return Ok(Some(bytes));
            }
            // Answers of the faults themselves wait for a client that does not read, too.
            if !connection.reads() {
                return Ok(None);
            }
            let Some(bytes) = connection.next().map_err(Ended::Broken)? else { return Ok(None) };
            let (drive, port, framed) = (connection.drive, connection.port, connection.splitter.is_some());
            let altered = connection.disturbed.altered;
            let rest_of_other =
                connection.disturbed.splitter.as_ref().is_some_and(|splitter| !splitter.partial().is_empty());
            connection.disturbed.has_changed = false;
            let swallowed = FrameEffects::NONE.with(FrameEffect::Swallowed, rest_of_other);
            if framed {
                self.note_request(client, &bytes);
            }
            let Some(fate) = self.request_fate(client, (drive, port), framed, &bytes) else {
                if !altered {
                    return Ok(Some(bytes));
                }
                if rest_of_other {
                    self.enter_lost(Outlet::Tcp(drive, port), self.now, &bytes, swallowed);
                }
                self.pass(client, &bytes, 1);
                continue;
            };
            let effects = fate.effects();
            if fate.refused {
                for _ in 0..if fate.twice { 2 } else { 1 } {
                    self.refuse(client, (drive, port), &bytes, effects);
                }
                continue;
            }
            let text = fate.apply(STREAM, &bytes);
            let is_whole = is_whole(framed, &bytes, &text.bytes);
            if fate.lost || fate.is_closing() || !is_whole || rest_of_other {
                let swallowed = if fate.lost { FrameEffects::NONE } else { swallowed };
                self.enter_lost(Outlet::Tcp(drive, port), self.now, &bytes, effects.and(swallowed));
            }
            if let Some(part) = fate.closes_after(&text.bytes) {
                // The drive ignores a part of a request.
                self.record_request(client, part);
                return Err(Ended::ByFault);
            }
            if let Some(connection) = self.connections.all.get_mut(&client) {
                let stream = &mut connection.disturbed;
                stream.has_changed = !fate.lost && !is_whole;
                stream.altered |= stream.has_changed;
                if !fate.lost {
                    stream.on_requests = stream.on_requests.and(effects);
                    stream.on_copy = if fate.twice { effects } else { FrameEffects::NONE };
                }
            }
            self.pass(client, &text.bytes, if fate.twice { 2 } else { 1 });
        }
    }

    /// Appends a request to the stream to the drive.
    fn pass(&mut self, client: u32, bytes: &[u8], times: usize) {
        if let Some(connection) = self.connections.all.get_mut(&client) {
            connection.disturbed.passed.extend(bytes.repeat(times));
        }
    }

    /// Faults of a request.
    fn request_fate(
        &mut self,
        client: u32,
        (drive, port): (DriveId, Port),
        framed: bool,
        bytes: &[u8],
    ) -> Option<FrameFaults> {
        let spec = self.spec(drive);
        let disturbance = self.port_disturbance(drive, port);
        let pdu = if framed { tcp::parse(bytes).map_or(&[][..], |(_, pdu)| pdu) } else { &[] };
        // On TCP a drive answers a request of a wrong length, too (MDRIVE-5).
        let refusable = pdu.first().is_some_and(|function| function & EXCEPTION_BIT == 0);
        let content = disturbance.needs_content().then(|| Content::of_request(vec![(drive, spec)], pdu));
        let fate = disturbance.request(bytes.len(), content.as_ref(), refusable);
        if let Some(connection) = self.connections.all.get_mut(&client) {
            connection.disturbed.asked = content;
        }
        fate
    }

    /// Answers a request in place of the drive, with the Modbus exception that the fault `exception` sends
    /// (BENCH-12).
    fn refuse(&mut self, client: u32, at: (DriveId, Port), request: &[u8], effects: FrameEffects) {
        let code = self.port_disturbance(at.0, at.1).faults().exception_code;
        let Some((header, &[function, ..])) = tcp::parse(request) else { return };
        self.record_request(client, request);
        let exception = tcp::frame(header, &[function | EXCEPTION_BIT, code]);
        let outcome = Outcome::RefusedByFault(code);
        self.enter_refused(at, self.now, (request, &exception), outcome, effects);
        self.reply_to_client(client, &exception);
    }

    /// Records a request that does not reach its drive.
    fn record_request(&mut self, client: u32, bytes: &[u8]) {
        if let Some(&Connection { drive, port, link, .. }) = self.connections.all.get(&client) {
            self.record_message((drive, port, link), Source::Client, bytes);
        }
    }

    /// Handles what a drive sends to a client. On a port with lines of text it is a part of a reply.
    pub(super) fn reply_to_client(&mut self, client: u32, bytes: &[u8]) {
        let Some(connection) = self.connections.all.get_mut(&client) else { return };
        let (drive, port) = (connection.drive, connection.port);
        if connection.splitter.is_some() {
            let fate = self.reply_fate(client, bytes, bytes.len());
            if let Some(fate) = &fate {
                self.note_reply(drive, port, bytes, fate.effects());
            }
            return self.send_reply(client, bytes, fate.as_ref());
        }
        let mut reply = connection.disturbed.reply.take().unwrap_or_else(|| {
            // If the drive does not take the next message yet, the reply has more characters.
            let count = bytes.len() + usize::from(!self.at(drive).takes(port));
            let fate = self.reply_fate(client, bytes, count);
            if let Some(tcp) = self.at_mut(drive).state.tcp(port) {
                tcp.replied_to.push(client);
            }
            let effects = fate.as_ref().map_or(FrameEffects::NONE, FrameFaults::effects);
            TextReply { fate, effects, held: Vec::new() }
        });
        match &mut reply.fate {
            Some(fate) if fate.needs_whole_frame() => reply.held.extend_from_slice(bytes),
            fate => {
                self.send_reply(client, bytes, fate.as_ref());
                if let Some(fate) = fate {
                    fate.clear_noise();
                }
            }
        }
        if let Some(connection) = self.connections.all.get_mut(&client) {
            connection.disturbed.reply = Some(reply);
        }
    }

    /// Ends the replies on a port with lines of text, because the drive takes the next message.
    pub(super) fn end_text_replies(&mut self, drive: DriveId, port: Port) {
        let entries = self.outputs.entries;
        let Some(tcp) = self.at_mut(drive).state.tcp(port) else { return };
        let before = std::mem::replace(&mut tcp.entries, entries);
        for client in std::mem::take(&mut tcp.replied_to) {
            let effects = self.end_text_reply(client);
            self.note_text_reply(drive, port, before, effects);
        }
    }

    /// Ends a reply on a port with lines of text. Returns the effects of faults on the reply.
    pub(super) fn end_text_reply(&mut self, client: u32) -> FrameEffects {
        let connection = self.connections.all.get_mut(&client);
        let reply = connection.and_then(|connection| connection.disturbed.reply.take());
        let Some(TextReply { fate, effects, held }) = reply else { return FrameEffects::NONE };
        if !held.is_empty() {
            self.send_reply(client, &held, fate.as_ref());
        }
        effects
    }

    /// Faults of a reply of `count` characters that begins with these bytes.
    fn reply_fate(&mut self, client: u32, bytes: &[u8], count: usize) -> Option<FrameFaults> {
        let connection = self.connections.all.get(&client)?;
        let (drive, port, framed) = (connection.drive, connection.port, connection.splitter.is_some());
        let content = self.tcp_reply_content(client, (drive, self.spec(drive)), framed, bytes);
        self.port_disturbance(drive, port).reply(count, content.as_ref())
    }

    /// Sends a reply to a client, changed by the faults in `fate`.
    fn send_reply(&mut self, client: u32, bytes: &[u8], fate: Option<&FrameFaults>) {
        let Some(fate) = fate else {
            return self.send_part(client, Duration::ZERO, StreamPart::Bytes(bytes.to_vec()));
        };
        let Some(connection) = self.connections.all.get(&client) else { return };
        let (drive, framed) = (connection.drive, connection.splitter.is_some());
        let own_address = self.spec(drive).address.map(|row| self.peek(drive, row));
        let rewritten = if framed { readdressed(bytes, fate, own_address) } else { None };
        let sound = rewritten.as_deref().unwrap_or(bytes);
        let delay = fate.delay;
        if fate.lost || fate.muted {
            return;
        }
        if let Some(noise) = fate.noise(STREAM) {
            self.send_part(client, delay, StreamPart::Noise(noise.bytes));
        }
        let text = fate.apply(STREAM, sound);
        if let Some(part) = fate.closes_after(&text.bytes) {
            self.send_part(client, delay, StreamPart::Bytes(part.to_vec()));
            return self.send_part(client, delay, StreamPart::End(Ended::ByFault));
        }
        let times = if fate.twice { 2 } else { 1 };
        for _ in 0..times {
            self.send_part(client, delay, StreamPart::Bytes(text.bytes.clone()));
        }
    }

    /// Content of a reply, if a fault needs it.
    fn tcp_reply_content(
        &self,
        client: u32,
        drive: (DriveId, &'static Spec),
        framed: bool,
        bytes: &[u8],
    ) -> Option<Content> {
        let connection = self.connections.all.get(&client)?;
        let disturbance = self.connections.disturbances.get(&(connection.drive, connection.port))?;
        if !disturbance.needs_content() {
            return None;
        }
        let pdu = if framed { tcp::parse(bytes).map_or(&[][..], |(_, pdu)| pdu) } else { &[] };
        let asked = connection.disturbed.asked.as_ref();
        Some(asked.map_or_else(|| Content::of_lone_reply(drive, pdu), |asked| asked.of_reply(drive)))
    }

    /// Ends a connection for its client when all earlier replies have reached the client.
    pub(super) fn end_after_replies(&mut self, client: u32, ended: Ended) {
        self.end_text_reply(client);
        self.send_part(client, Duration::ZERO, StreamPart::End(ended));
    }

    /// Sends a part of the stream to a client after a delay, but not before earlier parts.
    fn send_part(&mut self, client: u32, delay: Duration, part: StreamPart) {
        let now = self.now;
        let Some(connection) = self.connections.all.get_mut(&client) else { return };
        let (index, stream) = (connection.drive.0, &mut connection.disturbed);
        if delay == Duration::ZERO && stream.late == 0 {
            return self.deliver_part(client, part);
        }
        let at = (now + delay).max(stream.late_until);
        let (drive, port) = (connection.drive, connection.port);
        let number = self.entry_of_reply(drive, port).filter(|_| matches!(part, StreamPart::Bytes(_)));
        let Some(connection) = self.connections.all.get_mut(&client) else { return };
        let stream = &mut connection.disturbed;
        stream.late_entries.push_back(number);
        stream.late_until = at;
        stream.late += 1;
        stream.late_bytes += part.len();
        self.busy += 1;
        self.schedule(at, Phase::Turn, index, EventKind::StreamPart { client, part });
    }

    /// The number of the journal's entry of the reply that a drive sends now.
    fn entry_of_reply(&mut self, drive: DriveId, port: Port) -> Option<u64> {
        let state = &mut self.at_mut(drive).state;
        let tcp = state.tcp(port)?;
        let before = if tcp.framed { 0 } else { tcp.entries };
        state.journal.last_after(port, before).map(|entry| entry.number)
    }

    /// Delivers a delayed part of the stream to a client.
    pub(super) fn stream_part_arrives(&mut self, client: u32, part: StreamPart) {
        self.busy -= 1;
        let Some(connection) = self.connections.all.get_mut(&client) else { return };
        connection.disturbed.late -= 1;
        connection.disturbed.late_entries.pop_front();
        connection.disturbed.late_bytes -= part.len();
        // What is under way when a connection breaks is lost.
        if connection.ended.is_none() {
            self.deliver_part(client, part);
        }
        self.resume_client(client);
    }

    fn deliver_part(&mut self, client: u32, part: StreamPart) {
        let Some(connection) = self.connections.all.get(&client) else { return };
        let drive = connection.drive;
        match part {
            StreamPart::Bytes(bytes) => self.deliver_to_client(client, Source::Drive(drive), &bytes),
            StreamPart::Noise(bytes) => self.deliver_to_client(client, Source::Noise, &bytes),
            StreamPart::End(ended) => {
                // A drive that has not closed the connection itself is told of its end.
                self.close_connection(client);
                self.end_from_drive(client, ended);
            }
        }
    }
}

/// Returns true if a request that a fault changed is still one message.
fn is_whole(framed: bool, request: &[u8], changed: &[u8]) -> bool {
    if framed {
        let mut rest = changed;
        matches!(Splitter::new().next(&mut rest), Ok(Some(_))) && rest.is_empty()
    } else {
        is_whole_line(request, changed)
    }
}

/// Returns true if `changed`, which a fault has made of `text`, still ends the line that `text` ends, and has no more
/// control characters, which could end or cancel the line earlier.
pub(super) fn is_whole_line(text: &[u8], changed: &[u8]) -> bool {
    let controls = |text: &[u8]| text.iter().filter(|byte| byte.is_ascii_control()).count();
    !ends_line(text) || (ends_line(changed) && controls(changed) <= controls(text))
}

/// Returns true if the last character of a text ends a line.
pub(super) fn ends_line(text: &[u8]) -> bool {
    matches!(text.last(), Some(b'\r' | b'\n'))
}

/// The same reply with another address or the number of another transaction; `None` if it stays unchanged.
fn readdressed(reply: &[u8], fate: &FrameFaults, address: Option<i64>) -> Option<Vec<u8>> {
    if !fate.wrong_address && !fate.wrong_transaction {
        return None;
    }
    let (Header { transaction, unit }, pdu) = tcp::parse(reply)?;
    // The next one up to 247, as on a line (BENCH-13).
    let mut others = (1..247).map(|up| ((u32::from(unit) + up - 1) % 247 + 1) as u8);
    let other = others.find(|&other| address != Some(i64::from(other)));
    let header = Header {
        transaction: if fate.wrong_transaction { transaction.wrapping_add(1) } else { transaction },
        unit: if fate.wrong_address { other.unwrap_or(unit) } else { unit },
    };
    Some(tcp::frame(header, pdu).to_vec())
}
