//! Decoder: messages and their outcomes in the words of the manual.
//!
//! Pure functions from bytes and a drive's [`Spec`] to text and fields. Everything that shows messages uses
//! them: the log, the control API, captures. Bytes that are not a message give a text, too.

pub mod messages;
pub(crate) mod modbus;
pub(crate) mod text;

use std::fmt;

use drivetwin_firmware::device::{DropReason, Duration, Effect, Framing, Spec};
use drivetwin_protocol::modbus::tcp::Broken;
use drivetwin_protocol::modbus::{ascii, rtu, tcp};
use drivetwin_protocol::time::TICKS_PER_SECOND;

use crate::record::effects::{FrameEffect, FrameEffects};
use crate::record::journal::{Collision, Entry, NoMessage, Outcome};
use crate::value::Value;

/// Result of a message.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Verdict {
    /// The drive executed the message.
    Done,
    /// The drive refused the message.
    Refused,
    /// The drive accepted the message, and it has no effect.
    WithoutEffect,
    /// The message was for an address that no drive of the line has.
    NotForIt,
    /// The message was corrupt.
    BadFrame,
    /// The request was too early, and the strict line dropped it.
    TooEarly,
    /// The drive could not receive.
    NotListening,
    /// A fault of the line or TCP port took the message.
    Lost,
}

impl Verdict {
    /// All verdicts.
    pub const ALL: [Self; 8] = [
        Self::Done,
        Self::Refused,
        Self::WithoutEffect,
        Self::NotForIt,
        Self::BadFrame,
        Self::TooEarly,
        Self::NotListening,
        Self::Lost,
    ];

    /// The verdict as users see it.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Refused => "refused",
            Self::WithoutEffect => "without effect",
            Self::NotForIt => "not for it",
            Self::BadFrame => "bad frame",
            Self::TooEarly => "too early",
            Self::NotListening => "not listening",
            Self::Lost => "lost",
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A message that a drive sends by itself on a port with text, in words; empty if it has only prompts.
pub(crate) fn own_message(spec: &Spec, framing: Framing, bytes: &[u8]) -> String {
    match framing {
        Framing::Return => text::printed_lines(bytes, &mut None).join(" / "),
        _ => {
            let line = bytes.trim_ascii();
            let words = text::response(spec, line, &mut Request::default());
            words.unwrap_or_else(|| text::printable(line))
        }
    }
}

/// Mark of a message in a picture.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Mark {
    /// The drive executed the message.
    Done,
    /// The drive refused the message.
    Refused,
    /// The drive accepted the message, and it has no effect.
    WithoutEffect,
    /// No drive received the message, or could read it.
    NotReceived,
    /// A fault of the line or TCP port acted on the message or its answer.
    ByFault,
}

impl Mark {
    /// The mark of an entry of a journal with this verdict.
    #[must_use]
    pub fn of(entry: &Entry, verdict: Verdict) -> Self {
        let by_fault = !entry.on_message.of_faults().is_empty()
            || !entry.on_answer.of_faults().is_empty()
            || matches!(entry.outcome, Outcome::Lost | Outcome::RefusedByFault(_));
        match verdict {
            _ if by_fault => Self::ByFault,
            Verdict::Done => Self::Done,
            Verdict::Refused => Self::Refused,
            Verdict::WithoutEffect => Self::WithoutEffect,
            Verdict::NotForIt
            | Verdict::BadFrame
            | Verdict::TooEarly
            | Verdict::NotListening
            | Verdict::Lost => Self::NotReceived,
        }
    }
}

/// A register in a message.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Register {
    /// Row of the register map.
    pub row: usize,
    /// The manual's name; with `High` or `Low` for one word of two, or the number of the word for one of more.
    pub name: String,
    /// The value that is written, or that the answer to a read has.
    pub value: Option<Value>,
    /// True if the message writes the register.
    pub written: bool,
}

/// A request as text and as fields.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Request {
    /// The request: `write Speed = 9000`.
    pub text: String,
    /// Address of the drive, on a Modbus port.
    pub address: Option<u8>,
    /// Function code, on a Modbus port.
    pub function: Option<u8>,
    /// Registers of the request, in its order. Those that the drive does not have are left out.
    pub registers: Vec<Register>,
}

/// A message with its outcome, as text and as fields.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Exchange {
    /// The request. If it is a read request, its registers have the values from the answer.
    pub request: Request,
    /// Verdict.
    pub verdict: Verdict,
    /// Reason of a verdict, or the limit of its effect; `None` if there is no more to say.
    pub reason: Option<String>,
    /// The outcome in one clause: `done`, `Speed = 9000`, `refused: 0x000B Reserved is read only (02)`.
    pub outcome: String,
    /// Rows of the registers that a refusal is about: none if the drive does not have the function, or refuses the request
    /// for another cause than a register.
    pub blamed: Vec<usize>,
}

impl fmt::Display for Exchange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} -> {}", self.request.text, self.outcome)
    }
}

/// A message: a frame on a Modbus port, or a line of text.
#[derive(Clone, Copy, Debug)]
pub struct Message<'a> {
    /// Sign that ends a message on the port.
    pub framing: Framing,
    /// True for Modbus ASCII.
    pub ascii: bool,
    /// The bytes.
    pub bytes: &'a [u8],
}

impl Message<'_> {
    /// Address and PDU of a Modbus message, its checksum not verified; `None` if it is too short, or text.
    fn body(&self) -> Option<(u8, Vec<u8>)> {
        match self.framing {
            Framing::Silence if self.ascii => {
                let body = ascii::decode(self.bytes).or_else(|| hex(self.bytes))?;
                body.split_first().map(|(&address, pdu)| (address, pdu.to_vec()))
            }
            Framing::Silence => match self.bytes {
                [address, pdu @ .., _, _] => Some((*address, pdu.to_vec())),
                _ => None,
            },
            Framing::Mbap => tcp::parse(self.bytes).map(|(header, pdu)| (header.unit, pdu.to_vec())),
            Framing::Character | Framing::Return => None,
        }
    }

    /// Address that the message is for; `None` if it has none.
    #[must_use]
    pub fn address(&self) -> Option<u8> {
        match (self.framing, self.bytes) {
            // The journal asks for the address of each frame.
            (Framing::Silence, [address, _, _, ..]) if !self.ascii => Some(*address),
            _ => self.body().map(|(address, _)| address),
        }
    }

    /// Returns true if the message is a frame with a valid checksum, or a port without frames.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        match self.framing {
            Framing::Silence if self.ascii => ascii::decode(self.bytes).is_some(),
            Framing::Silence => rtu::verify_crc(self.bytes).is_some(),
            Framing::Mbap | Framing::Character | Framing::Return => true,
        }
    }

    /// The request as text and as fields.
    #[must_use]
    pub fn request(&self, spec: &Spec) -> Request {
        match self.framing {
            Framing::Character => text::command(spec, self.bytes),
            Framing::Return => text::line(spec, self.bytes),
            Framing::Silence | Framing::Mbap => match self.body() {
                Some((address, pdu)) if !pdu.is_empty() => {
                    let request = modbus::request(spec, &pdu);
                    let to_all = self.framing == Framing::Silence && address == 0;
                    let text = if to_all { format!("to all: {}", request.text) } else { request.text };
                    Request { text, address: Some(address), ..request }
                }
                _ => Request { text: bytes(self.bytes), ..Request::default() },
            },
        }
    }
}

/// The bytes of the digits of a Modbus ASCII message without its LRC, if they are digits.
fn hex(message: &[u8]) -> Option<drivetwin_protocol::modbus::Frame> {
    let digits = message.strip_prefix(b":")?;
    let digits = digits.strip_suffix(b"\r\n").unwrap_or(digits);
    let mut body = drivetwin_protocol::modbus::Frame::new();
    for pair in digits.chunks_exact(2) {
        let digit = |byte: u8| char::from(byte).to_digit(16);
        body.push((digit(pair[0])? << 4 | digit(pair[1])?) as u8).ok()?;
    }
    body.pop()?;
    Some(body)
}

/// Bytes as people write them, a few of them.
fn bytes(bytes: &[u8]) -> String {
    const MOST: usize = 16;
    let shown: Vec<String> = bytes.iter().take(MOST).map(|byte| format!("{byte:02X}")).collect();
    let dots = if bytes.len() > MOST { " …" } else { "" };
    match bytes.len() {
        0 => "nothing that could be read".to_owned(),
        1 => format!("1 byte {}", shown.join(" ")),
        length => format!("{length} bytes {}{dots}", shown.join(" ")),
    }
}

/// An entry of a journal as text and as fields. `spec` describes the drive, or a drive of the line.
#[must_use]
pub fn exchange(spec: &Spec, entry: &Entry) -> Exchange {
    let framing = spec.ports.get(usize::from(entry.port.0)).map_or(Framing::Return, |port| port.framing);
    let message = Message { framing, ascii: entry.ascii, bytes: entry.message() };
    let is_corrupt = match entry.outcome {
        Outcome::Dropped(why) => why != DropReason::Starting && why != DropReason::Address,
        Outcome::NoMessage(_) => true,
        _ => false,
    };
    let is_text = matches!(framing, Framing::Character | Framing::Return);
    let mut request = if (is_corrupt && !is_text) || entry.message().is_empty() {
        // The text for a corrupt frame is its bytes; a description would be a guess.
        Request { text: bytes(entry.message()), ..Request::default() }
    } else {
        message.request(spec)
    };
    if is_stored(spec, entry) || entry.outcome == Outcome::NoMessage(NoMessage::Disconnected) {
        // A stored line neither reads nor writes a register before the program runs, and a part of a line never does.
        request.registers.clear();
    }
    let (verdict, reason) = match entry.outcome {
        Outcome::Accepted if modbus::is_read_of_all(&message) => {
            (Verdict::WithoutEffect, Some("no drive answers a request to all".to_owned()))
        }
        Outcome::Accepted => accepted(spec, entry),
        Outcome::Refused(code) => (Verdict::Refused, Some(refusal(spec, &message, entry, code))),
        Outcome::Dropped(why) => dropped(&message, entry, why),
        Outcome::NoMessage(why) => (Verdict::BadFrame, Some(no_message(entry.message(), why))),
        Outcome::NoDrive => (Verdict::NotForIt, Some(nobody(&message, entry.addresses()))),
        Outcome::NoPower => (Verdict::NotListening, Some("no power".to_owned())),
        Outcome::PowerLost => (Verdict::NotListening, Some("power lost before the answer".to_owned())),
        Outcome::Sending => (Verdict::NotListening, Some("it was sending".to_owned())),
        Outcome::Collided(with) => (Verdict::BadFrame, Some(collision(with).to_owned())),
        Outcome::TooEarly(early) => (Verdict::TooEarly, Some(early.to_string())),
        Outcome::Lost => (Verdict::Lost, None),
        Outcome::RefusedByFault(code) => (Verdict::Refused, Some(format!("by a fault ({code:02})"))),
    };
    let mut outcome = match (verdict, &reason) {
        (Verdict::Done, Some(reason)) => format!("accepted, {reason}"),
        (Verdict::WithoutEffect, Some(reason)) => format!("accepted, without effect: {reason}"),
        (Verdict::Refused, Some(reason)) => format!("refused: {reason}"),
        (_, Some(reason)) => reason.clone(),
        (verdict, None) => verdict.to_string(),
    };
    if verdict == Verdict::Done
        && let Some(answer) = answer(spec, &message, entry, &mut request)
        && reason.is_none()
    {
        outcome = answer;
    }
    let early = entry.early.as_ref().map(ToString::to_string);
    let clauses: Vec<String> = [early, unsent(entry), disturbed(entry)].into_iter().flatten().collect();
    let (reason, outcome) = match clauses.join("; ") {
        clauses if clauses.is_empty() => (reason, outcome),
        clauses => {
            let reason = reason.map_or_else(|| clauses.clone(), |reason| format!("{reason}; {clauses}"));
            (Some(reason), format!("{outcome}; {clauses}"))
        }
    };
    let blamed = match entry.outcome {
        Outcome::Refused(code) => blamed(spec, &message, entry, code, &request.registers),
        _ => Vec::new(),
    };
    Exchange { request, verdict, reason, outcome, blamed }
}

/// Part of the answer that the drive has sent, if it lost its power before the end.
fn unsent(entry: &Entry) -> Option<String> {
    let sent = entry.sent_of_answer.filter(|_| !entry.answer().is_empty())?;
    Some(format!("power lost after {sent} of {} bytes of the reply", entry.answer().len()))
}

/// Effects of the line or TCP port on a message and its answer.
fn disturbed(entry: &Entry) -> Option<String> {
    let clause = |frame: &str, effects: FrameEffects| {
        let effects = effects.of_faults();
        (!effects.is_empty()).then(|| format!("by a fault, the {frame} {effects}"))
    };
    let collided = entry.on_answer.contains(FrameEffect::Collided);
    let collided = collided.then(|| "the reply collided with other characters".to_owned());
    let clauses = [collided, clause("request", entry.on_message), clause("reply", entry.on_answer)];
    let clauses: Vec<String> = clauses.into_iter().flatten().collect();
    (!clauses.is_empty()).then(|| clauses.join("; "))
}

/// Returns true if the drive has stored the message as a line of a program.
fn is_stored(spec: &Spec, entry: &Entry) -> bool {
    let mut reasons = entry.reasons().filter_map(|reason| spec.reasons.get(usize::from(reason.0)));
    reasons.any(|reason| reason.effect == Effect::Stored)
}

/// Verdict on an accepted message, by the reasons of the drive.
fn accepted(spec: &Spec, entry: &Entry) -> (Verdict, Option<String>) {
    let reasons = || entry.reasons().filter_map(|reason| spec.reasons.get(usize::from(reason.0)));
    let texts = |effect: Effect| {
        reasons().filter(|reason| reason.effect == effect).map(|reason| reason.text).collect::<Vec<_>>()
    };
    let (nothing, later, other) = (texts(Effect::Nothing), texts(Effect::Later), texts(Effect::Other));
    let stored = texts(Effect::Stored);
    if !nothing.is_empty() {
        return (Verdict::WithoutEffect, Some(nothing.join("; ")));
    }
    let parts = [("with effect later: ", later), ("with another effect: ", other), ("", stored)];
    let parts: Vec<String> = parts
        .into_iter()
        .filter(|(_, texts)| !texts.is_empty())
        .map(|(how, texts)| format!("{how}{}", texts.join("; ")))
        .collect();
    (Verdict::Done, (!parts.is_empty()).then(|| parts.join("; ")))
}

/// Reason of a refusal as text, with its code.
fn refusal(spec: &Spec, message: &Message<'_>, entry: &Entry, code: u8) -> String {
    match message.framing {
        Framing::Silence | Framing::Mbap => {
            if let Some(left) = entry.deaf_for.filter(|left| *left > Duration::ZERO) {
                return format!("{} ({code:02})", starting(Some(left)));
            }
            let pdu = message.body().map(|(_, pdu)| pdu).unwrap_or_default();
            modbus::refusal(spec, &pdu, code, entry.error())
        }
        Framing::Character if entry.unreadable > 0 => {
            format!("the line has {} ({})", unreadable(entry.unreadable), char::from(code).escape_default())
        }
        Framing::Character => text::refused_command(spec, message.bytes, code),
        Framing::Return => {
            error(spec, code).map_or_else(|| format!("error {code}"), |text| format!("{text} (error {code})"))
        }
    }
}

/// Rows of the registers that a refusal is about.
fn blamed(spec: &Spec, message: &Message<'_>, entry: &Entry, code: u8, registers: &[Register]) -> Vec<usize> {
    match message.framing {
        // A drive that starts would refuse anything.
        _ if entry.deaf_for.is_some_and(|left| left > Duration::ZERO) || entry.unreadable > 0 => Vec::new(),
        Framing::Silence | Framing::Mbap => {
            let pdu = message.body().map(|(_, pdu)| pdu).unwrap_or_default();
            modbus::blamed(spec, &pdu, code, registers)
        }
        Framing::Character | Framing::Return => registers.iter().map(|register| register.row).collect(),
    }
}

/// The text of an error of a drive, by its number.
fn error(spec: &Spec, number: u8) -> Option<&'static str> {
    spec.errors.iter().find(|(known, _)| *known == number).map(|(_, text)| *text)
}

/// Verdict on a message that the drive ignored.
fn dropped(message: &Message<'_>, entry: &Entry, why: DropReason) -> (Verdict, Option<String>) {
    let reason = match why {
        DropReason::Starting => return (Verdict::NotListening, Some(starting(entry.deaf_for))),
        DropReason::Address => return (Verdict::NotForIt, Some(nobody(message, &[]))),
        DropReason::Crc if is_too_short(message) => "no frame has this length".to_owned(),
        DropReason::Crc => wrong_sum(message),
        DropReason::Gap if message.ascii => "more than 1 s between two characters".to_owned(),
        DropReason::Gap => "a gap of more than 1.5 characters inside the frame".to_owned(),
        DropReason::Length if message.is_whole() => "the length is not that of its function".to_owned(),
        DropReason::Length => "no frame has this length".to_owned(),
        DropReason::RxError if entry.unreadable == 0 => "a character is not allowed in a message".to_owned(),
        DropReason::RxError => unreadable(entry.unreadable),
    };
    (Verdict::BadFrame, Some(reason))
}

/// Reason why no drive can read a request that collided.
fn collision(with: Collision) -> &'static str {
    match with {
        Collision::Request => "collision with the request of another client",
        Collision::Reply => "collision with the reply of a drive",
        Collision::Noise => "collision with noise",
    }
}

/// A number of characters with an error, and the possible causes.
fn unreadable(count: u8) -> String {
    let count = match count {
        1 => "1 character with an error".to_owned(),
        255 => "255 or more characters with errors".to_owned(),
        count => format!("{count} characters with errors"),
    };
    format!("{count}: baud rate, parity, or a disturbance")
}

/// Reason why bytes are no message.
fn no_message(bytes: &[u8], why: NoMessage) -> String {
    match why {
        NoMessage::NoColon => "a message in Modbus ASCII begins with a colon".to_owned(),
        NoMessage::NextColon => "a colon begins the next message before the end of this one".to_owned(),
        NoMessage::Disconnected => "the client disconnected before the end of the message".to_owned(),
        NoMessage::Header(why) => {
            let (name, allowed, place) = match why {
                Broken::Protocol => ("protocol identifier", "not 0", 2),
                Broken::Length => ("length", "not from 2 to 254", 4),
            };
            match bytes.get(place..place + 2) {
                Some(&[high, low]) => {
                    let number = u16::from_be_bytes([high, low]);
                    format!("the {name} in the header is {number}, {allowed}; the connection is closed")
                }
                _ => format!("the {name} in the header is {allowed}; the connection is closed"),
            }
        }
    }
}

/// The wrong checksum of a message, and the right one.
fn wrong_sum(message: &Message<'_>) -> String {
    match (message.framing, message.bytes) {
        (Framing::Silence, [body @ .., low, high]) if !message.ascii && !body.is_empty() => {
            let [right_low, right_high] = rtu::crc(body).to_le_bytes();
            format!("CRC wrong: {low:02X} {high:02X} instead of {right_low:02X} {right_high:02X}")
        }
        (Framing::Silence, _) if message.ascii => "LRC wrong".to_owned(),
        (Framing::Silence, _) => "CRC wrong".to_owned(),
        _ => "checksum wrong".to_owned(),
    }
}

/// Reason of the silence of a drive that starts, with the time until it receives.
#[must_use]
pub fn starting(left: Option<Duration>) -> String {
    let Some(left) = left.filter(|left| *left > Duration::ZERO) else { return "starting".to_owned() };
    // A drive receives from the tick after its start-up.
    let ticks = u128::from((left - Duration::TICK).ticks()).max(1);
    let milliseconds = (ticks * 1_000).div_ceil(u128::from(TICKS_PER_SECOND));
    match milliseconds {
        ..100 => format!("starting for {milliseconds} ms more"),
        // Rounded up to a tenth of a second.
        _ => {
            let tenths = milliseconds.div_ceil(100);
            format!("starting for {}.{} s more", tenths / 10, tenths % 10)
        }
    }
}

/// Reason why nobody answers a message for an address that no drive has.
fn nobody(message: &Message<'_>, addresses: &[u8]) -> String {
    let address =
        message.address().map_or("another address".to_owned(), |address| format!("address {address}"));
    let mut addresses = addresses.to_vec();
    addresses.sort_unstable();
    addresses.dedup();
    match addresses.as_slice() {
        [] => format!("for {address}, nobody here"),
        [one] => format!("for {address}, nobody here (the drive has {one})"),
        many => format!("for {address}, nobody here (the drives have {})", ranges(many)),
    }
}

/// Numbers in ascending order as people write them: `1, 3 to 7`.
fn ranges(numbers: &[u8]) -> String {
    let runs = numbers.chunk_by(|a, b| a.checked_add(1) == Some(*b));
    let run = |run: &[u8]| match run {
        [first, .., last] if run.len() > 2 => format!("{first} to {last}"),
        _ => run.iter().map(u8::to_string).collect::<Vec<_>>().join(", "),
    };
    runs.map(run).collect::<Vec<_>>().join(", ")
}

/// What an answer says, if more than that the request is done. Adds its values to the registers of `request`.
fn answer(spec: &Spec, message: &Message<'_>, entry: &Entry, request: &mut Request) -> Option<String> {
    let reply = Message { bytes: entry.answer(), ..*message };
    match message.framing {
        Framing::Silence | Framing::Mbap => {
            let ((_, pdu), (_, reply)) = (message.body()?, reply.body()?);
            modbus::answer(spec, &pdu, &reply, request)
        }
        Framing::Character => text::response(spec, reply.bytes, request),
        Framing::Return => text::printed(spec, message.bytes, reply.bytes, request),
    }
}

/// The reason why nobody can read a Modbus frame on a serial line; empty for a valid frame, and on other ports.
#[must_use]
pub fn flaw(message: &Message<'_>) -> String {
    match message.is_whole() {
        true => String::new(),
        false if is_too_short(message) => "no frame has this length".to_owned(),
        false => wrong_sum(message),
    }
}

/// Returns true if a message is too short for address, function and checksum.
fn is_too_short(message: &Message<'_>) -> bool {
    // In ASCII with a colon, CR and LF.
    message.framing == Framing::Silence && message.bytes.len() < if message.ascii { 9 } else { 4 }
}

/// Words for a reply alone, of which the request is not known.
#[must_use]
pub fn reply(spec: &Spec, request: Option<&Message<'_>>, reply: &Message<'_>) -> String {
    let Some((_, answer)) = reply.body() else { return String::new() };
    let asked = request.and_then(Message::body);
    match (asked, answer.as_slice()) {
        (Some((_, pdu)), [function, code, ..]) if function & 0x80 != 0 => {
            format!("refused: {}", modbus::refusal(spec, &pdu, *code, None))
        }
        (Some((_, pdu)), _) => {
            let mut request = modbus::request(spec, &pdu);
            modbus::answer(spec, &pdu, &answer, &mut request).unwrap_or_else(|| "done".to_owned())
        }
        (None, _) => String::new(),
    }
}

#[cfg(test)]
mod tests;
