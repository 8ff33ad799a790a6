//! Checks the replies of all drives at the moment the drives send them. Each must be valid and answer one
//! request to that drive. What a line then does to a reply does not matter here.

use std::collections::{BTreeMap, VecDeque};

use drivetwin_firmware::device::{Duration, Framing, Instant, Line, Link, Port};
use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::{ascii, rtu, tcp};
use drivetwin_protocol::time::Span;
use drivetwin_sim::record::trace::{Event, InputRecord, OutputRecord, Trace, TraceDrive};

use crate::oracle::Failure;
use crate::plan::Name;

/// First port of a drive. If the drive has Modbus, it is on this port.
const MODBUS: Port = Port(0);

/// Register of an RS drive that delays its replies, in ms (6.4).
pub(crate) const REPLY_DELAY: &str = "TIMEOUT_BROADCAST_MODBUS";

/// Factory address, which a drive takes when its memory is bad.
const FACTORY: u8 = 1;

/// Silence after which a drive no longer answers what it has received before.
const LONGEST: Duration = Duration::secs(10);

/// Longest time in which an MDrive answers on a connection. The manual gives no time for Modbus/TCP. It gives
/// 1 to 5 ms for most commands of MCode (MDRIVE-34).
const LONGEST_TCP: Duration = Duration::millis(5);

/// Longest request on a serial line, in characters.
const LONGEST_REQUEST: usize = 256;

/// Bit that a refusing reply sets in the function code.
const REFUSED: u8 = 0x80;

/// Bytes that a drive receives without an unreadable character among them.
#[derive(Default)]
struct Stretch {
    bytes: Vec<u8>,
    /// End of each character.
    ends: Vec<Instant>,
}

impl Stretch {
    fn last(&self) -> Instant {
        self.ends.last().copied().unwrap_or(Instant::ZERO)
    }
}

/// Bytes and messages that a drive has received and not yet answered.
struct Heard {
    /// Settings of the drive's line.
    line: Line,
    /// True if characters take no time.
    fast: bool,
    /// Delay of replies that is set.
    delay: Duration,
    on_line: VecDeque<Stretch>,
    /// True if the next character begins a new stretch.
    broken: bool,
    on_links: BTreeMap<u8, VecDeque<(Instant, Vec<u8>)>>,
}

impl Heard {
    fn new(drive: &TraceDrive, delay: Duration) -> Self {
        let line = drive.spec.ports.first().and_then(|port| port.line);
        // A TCP port has no line.
        Self { delay, ..Self::on(line.unwrap_or(Line::new(9_600, 8, Parity::None, 1)), drive.fast_line) }
    }

    fn on(line: Line, fast: bool) -> Self {
        let (on_line, on_links) = (VecDeque::new(), BTreeMap::new());
        Self { line, fast, delay: Duration::ZERO, on_line, broken: false, on_links }
    }

    fn hear(&mut self, at: Instant, fed: &InputRecord) {
        match fed {
            InputRecord::Bytes { port: MODBUS, bytes } => {
                // The stamp is the end of the first character.
                let character = if self.fast { Duration::ZERO } else { self.line.character() };
                let ends = (0..bytes.len() as u64).map(|n| at + character * n);
                let goes_on = |stretch: &Stretch| !self.broken && at.since(stretch.last()) < LONGEST;
                if !self.on_line.back().is_some_and(goes_on) {
                    self.on_line.push_back(Stretch::default());
                    self.broken = false;
                }
                if let Some(stretch) = self.on_line.back_mut() {
                    stretch.bytes.extend_from_slice(bytes);
                    stretch.ends.extend(ends);
                }
            }
            InputRecord::RxError { port: MODBUS } => self.broken = true,
            InputRecord::Message { port: MODBUS, link: Link(link), bytes } => {
                self.on_links.entry(*link).or_default().push_back((at, bytes.clone()));
            }
            InputRecord::Opened { port: MODBUS, link: Link(link) } => _ = self.on_links.remove(link),
            _ => {}
        }
    }

    /// Fails unless the line allows a reply of `unit` at `at` to a request whose last character ended at
    /// `end`. In RTU a reply follows 3.5 characters of silence (serial 2.5.1.1), and begins one character
    /// later at most (PROJECT-3). In ASCII it follows the request's line feed at once (RS434-4). The drive's
    /// own delay comes after that, unless its memory is bad.
    fn is_timely(&self, end: Instant, at: Instant, unit: u8, is_ascii: bool) -> Result<(), &'static str> {
        let end = if unit == FACTORY { end } else { end + self.delay };
        let character = self.line.character();
        let silence = match (is_ascii, self.line.baud) {
            (true, _) => Duration::ZERO,
            (false, ..=19_200) => Duration::from_ticks(character.ticks() * 7 / 2),
            (false, _) => Duration::micros(1_750),
        };
        let (least, most) = match (self.fast, is_ascii) {
            (true, _) => (Duration::ZERO, silence + character),
            (false, true) => (silence, silence),
            (false, false) => (silence, silence + character + Duration::TICK),
        };
        if at < end + least {
            return Err("it is too early for its request");
        }
        if at > end + most { Err("it is too late for its request") } else { Ok(()) }
    }

    /// Removes the request that this reply on a line answers. Fails if there is none.
    fn take_request(&mut self, at: Instant, unit: u8, reply: &[u8], ascii: bool) -> Result<(), &'static str> {
        // The timestamp of a reply may be later than the call that outputs it, and earlier than bytes
        // received after its request. So old stretches stay for a while.
        self.on_line.retain(|stretch| at < stretch.last() + LONGEST);
        let mut wrong = "nobody asked for it";
        for place in 0..self.on_line.len() {
            let stretch = &self.on_line[place];
            for (end, pdu) in requests(&stretch.bytes, unit, reply[0] & !REFUSED, ascii) {
                if !answers(reply, &pdu) {
                    wrong = "it does not fit its request";
                    continue;
                }
                match self.is_timely(stretch.ends[end - 1], at, unit, ascii) {
                    Ok(()) => {
                        let stretch = &mut self.on_line[place];
                        stretch.bytes.drain(..end);
                        stretch.ends.drain(..end);
                        return Ok(());
                    }
                    Err(untimely) => wrong = untimely,
                }
            }
        }
        Err(wrong)
    }

    /// Removes the request that this ADU answers. Fails if there is none.
    fn take_message(&mut self, at: Instant, link: u8, reply: &[u8]) -> Result<(), &'static str> {
        let (header, pdu) = tcp::parse(reply).ok_or("it is no ADU")?;
        let waiting = self.on_links.entry(link).or_default();
        while let Some((received, request)) = waiting.pop_front() {
            // A drive does not answer bytes that are no ADU.
            let Some((asked, request)) = tcp::parse(&request) else { continue };
            if asked != header || !answers(pdu, request) {
                return Err("it does not fit its request");
            }
            let is_timely = received <= at && at <= received + LONGEST_TCP;
            return if is_timely { Ok(()) } else { Err("it is too early or too late for its request") };
        }
        Err("nobody asked for it")
    }
}

/// PDUs of all valid requests to a unit with a function code, each with the index of its end.
fn requests(bytes: &[u8], unit: u8, function: u8, is_ascii: bool) -> Vec<(usize, Vec<u8>)> {
    let starts = 0..bytes.len();
    // A request whose function code has the bit `REFUSED` is refused, too, so the bit is ignored here.
    let is_asked =
        |body: &[u8]| body.first() == Some(&unit) && body.get(1).is_some_and(|it| it & !REFUSED == function);
    if is_ascii {
        let message = |start: usize| {
            let length = bytes[start..].windows(2).position(|end| end == b"\r\n")? + 2;
            let body = ascii::decode(&bytes[start..start + length])?;
            is_asked(&body).then(|| (start + length, body[1..].to_vec()))
        };
        return starts.filter(|&start| bytes[start] == b':').filter_map(message).collect();
    }
    let frames = starts.filter(|&start| is_asked(&bytes[start..])).flat_map(|start| {
        let ends = start + 4..=bytes.len().min(start + LONGEST_REQUEST);
        ends.filter_map(move |end| Some((end, rtu::verify_crc(&bytes[start..end])?.get(1..)?.to_vec())))
    });
    frames.collect()
}

/// Returns true if one PDU may answer the other (application 6, 7).
fn answers(reply: &[u8], request: &[u8]) -> bool {
    let (&[function, ref rest @ ..], &[asked, ref data @ ..]) = (reply, request) else { return false };
    if function == asked | REFUSED {
        return rest.len() == 1 && rest[0] > 0;
    }
    let count = || data.get(2..4).map(|count| usize::from(count[0]) << 8 | usize::from(count[1]));
    function == asked
        && match function {
            1 | 2 => count().is_some_and(|count| rest.len() == 1 + count.div_ceil(8)),
            // In some drives a register holds two words, so the reply may be longer.
            3 | 4 => rest.len() % 2 == 1 && count().is_some_and(|count| rest.len() > 2 * count),
            5 | 6 => rest == data,
            15 | 16 => rest.len() == 4 && data.starts_with(rest),
            _ => true,
        }
        && (function > 4 || rest.first().is_some_and(|&count| usize::from(count) + 1 == rest.len()))
}

/// Checks all replies of one run of the emulator. `addresses` and `delays` are those of the drives.
pub(crate) fn judge(
    trace: &Trace,
    addresses: &BTreeMap<Name, u8>,
    delays: &BTreeMap<Name, u64>,
) -> Result<(), Failure> {
    let delay = |drive: &TraceDrive| delays.get(&*drive.name).copied().unwrap_or_default().millis();
    let mut heard: Vec<Heard> = trace.drives.iter().map(|drive| Heard::new(drive, delay(drive))).collect();
    for entry in trace.events() {
        let (drive, heard) = (&trace.drives[entry.drive], &mut heard[entry.drive]);
        let result = match &entry.event {
            Event::Input(fed) => {
                heard.hear(entry.at, fed);
                Ok(())
            }
            Event::Output(OutputRecord::Bytes { port: MODBUS, bytes })
                if drive.spec.ports.first().is_some_and(|port| port.framing == Framing::Silence) =>
            {
                let own = addresses.get(&*drive.name).copied();
                reply_on_line(heard, entry.at, own, bytes).map_err(|wrong| (wrong, bytes))
            }
            Event::Output(OutputRecord::Message { port: MODBUS, link: Link(link), bytes }) => {
                heard.take_message(entry.at, *link, bytes).map_err(|wrong| (wrong, bytes))
            }
            &Event::Output(OutputRecord::Line { port: MODBUS, line }) => {
                heard.line = line;
                Ok(())
            }
            Event::Output(_) | Event::Shaft { .. } | Event::Received(_) | Event::Missing { .. } => Ok(()),
        };
        result.map_err(|(wrong, bytes)| {
            let detail = format!("{} says {bytes:02X?} at {:?}: {wrong}", drive.name, entry.at);
            Failure::new("a wrong reply", detail)
        })?;
    }
    Ok(())
}

fn reply_on_line(heard: &mut Heard, at: Instant, own: Option<u8>, bytes: &[u8]) -> Result<(), &'static str> {
    let decoded = ascii::decode(bytes);
    let is_ascii = decoded.is_some();
    match decoded.as_deref().or_else(|| rtu::verify_crc(bytes)) {
        Some(&[unit, ref pdu @ ..]) if !pdu.is_empty() => {
            if unit != FACTORY && own.is_some_and(|own| own != unit) {
                return Err("that is another one's address");
            }
            heard.take_request(at, unit, pdu, is_ascii)
        }
        _ => Err("it is no frame"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: u8 = 7;

    /// The line of an MD3. A character takes 18,333 ticks, and 3.5 of them 64,165.5.
    const LINE: Line = Line::new(9_600, 8, Parity::Even, 1);

    /// Judges a reply to the received bytes.
    fn judged(heard: &[&[u8]], reply: &[u8]) -> Result<(), &'static str> {
        let mut drive = Heard::on(LINE, true);
        for bytes in heard {
            drive.hear(Instant::ZERO, &InputRecord::Bytes { port: MODBUS, bytes: (*bytes).into() });
        }
        reply_on_line(&mut drive, Instant::ZERO, Some(OWN), reply)
    }

    #[test]
    fn a_reply_answers_a_request_in_any_pieces_behind_any_noise() {
        let request = rtu::read(OWN, 1, 2);
        let reply = rtu::frame(OWN, &[3, 4, 0, 1, 0, 2]);
        assert_eq!(judged(&[&[OWN, 3, 9], &request[..3], &request[3..]], &reply), Ok(()));
        assert_eq!(judged(&[&request], &rtu::frame(OWN, &[0x83, 2])), Ok(()));
        let (ask, answer) = (ascii::frame(OWN, &[6, 0, 1, 0, 2]), ascii::frame(OWN, &[6, 0, 1, 0, 2]));
        assert_eq!(judged(&[&ask], &answer), Ok(()));
    }

    #[test]
    fn a_reply_of_another_kind_is_wrong() {
        let request = rtu::write(OWN, 1, 2);
        let spoiled = [&request[..7], &[!request[7]]].concat();
        let (nobody, fits) = (Err("nobody asked for it"), Err("it does not fit its request"));
        assert_eq!(judged(&[], &request), nobody);
        assert_eq!(judged(&[&spoiled], &request), nobody);
        assert_eq!(judged(&[&rtu::write(0, 1, 2)], &request), nobody);
        assert_eq!(judged(&[&request], &rtu::write(OWN, 1, 3)), fits);
        assert_eq!(judged(&[&rtu::read(OWN, 1, 2)], &rtu::frame(OWN, &[3, 2, 0, 1])), fits);
        assert_eq!(judged(&[&request], &spoiled), Err("it is no frame"));
        let broadcast = rtu::write(0, 1, 2);
        assert_eq!(judged(&[&broadcast], &broadcast), Err("that is another one's address"));
    }

    #[test]
    fn a_request_is_answered_once() {
        let request = rtu::write(OWN, 1, 2);
        let mut drive = Heard::on(LINE, true);
        drive.hear(Instant::ZERO, &InputRecord::Bytes { port: MODBUS, bytes: request[..].into() });
        let mut answer = || reply_on_line(&mut drive, Instant::ZERO, Some(OWN), &request);
        assert_eq!((answer(), answer()), (Ok(()), Err("nobody asked for it")));
    }

    #[test]
    fn a_reply_begins_after_the_silence_and_before_another_character() {
        let request = rtu::write(OWN, 1, 2);
        let begins = |ticks: u64| {
            let mut drive = Heard::on(LINE, false);
            for (at, bytes) in [(18_333, &request[..3]), (4 * 18_333, &request[3..])] {
                let fed = InputRecord::Bytes { port: MODBUS, bytes: bytes.into() };
                drive.hear(Instant::from_ticks(at), &fed);
            }
            // The request has eight characters.
            reply_on_line(&mut drive, Instant::from_ticks(8 * 18_333 + ticks), Some(OWN), &request)
        };
        let (early, late) = (Err("it is too early for its request"), Err("it is too late for its request"));
        assert_eq!((begins(64_164), begins(64_165), begins(64_166 + 18_333)), (early, Ok(()), Ok(())));
        assert_eq!(begins(64_166 + 18_333 + 2), late);
    }

    #[test]
    fn an_unreadable_character_is_in_no_request() {
        let request = rtu::write(OWN, 1, 2);
        let mut drive = Heard::on(LINE, true);
        for fed in [
            InputRecord::Bytes { port: MODBUS, bytes: request[..4].into() },
            InputRecord::RxError { port: MODBUS },
            InputRecord::Bytes { port: MODBUS, bytes: request[4..].into() },
        ] {
            drive.hear(Instant::ZERO, &fed);
        }
        let answer = reply_on_line(&mut drive, Instant::ZERO, Some(OWN), &request);
        assert_eq!(answer, Err("nobody asked for it"));
    }

    #[test]
    fn on_a_connection_the_header_comes_back() {
        let header = tcp::Header { transaction: 5, unit: 1 };
        let (request, reply) = (tcp::frame(header, &[3, 0, 1, 0, 1]), tcp::frame(header, &[3, 2, 0, 7]));
        let other = tcp::frame(tcp::Header { transaction: 6, ..header }, &[3, 2, 0, 7]);
        let asked = || {
            let mut drive = Heard::on(LINE, true);
            let bytes = request.to_vec();
            drive.hear(Instant::ZERO, &InputRecord::Message { port: MODBUS, link: Link(0), bytes });
            drive
        };
        assert_eq!(asked().take_message(Instant::ZERO, 0, &reply), Ok(()));
        assert_eq!(asked().take_message(Instant::ZERO, 1, &reply), Err("nobody asked for it"));
        assert_eq!(asked().take_message(Instant::ZERO, 0, &other), Err("it does not fit its request"));
    }
}
