//! Checks the replies of all drives at the moment the drives send them. Each must be valid and answer one
//! request to that drive. What a line then does to a reply does not matter here.

use std::collections::{BTreeMap, VecDeque};

use drivetwin_firmware::device::{Duration, Framing, Instant, Link, Port};
use drivetwin_protocol::modbus::{ascii, rtu, tcp};
use drivetwin_sim::record::trace::{Event, InputRecord, OutputRecord, Trace};

use crate::oracle::Failure;

/// First port of a drive. If the drive has Modbus, it is on this port.
const MODBUS: Port = Port(0);

/// Factory address, which a drive takes when its memory is bad.
const FACTORY: u8 = 1;

/// Longer than any drive takes to answer, also after messages of others at the lowest baud rate.
const LONGEST: Duration = Duration::secs(10);

/// Longest request on a serial line, in characters.
const LONGEST_REQUEST: usize = 256;

/// Bit that a refusing reply sets in the function code.
const REFUSED: u8 = 0x80;

/// Bytes that a drive receives without an unreadable character among them.
struct Stretch {
    last: Instant,
    bytes: Vec<u8>,
}

/// Bytes and messages that a drive has received and not yet answered.
#[derive(Default)]
struct Heard {
    on_line: VecDeque<Stretch>,
    /// True if the next character begins a new stretch.
    broken: bool,
    on_links: BTreeMap<u8, VecDeque<Vec<u8>>>,
}

impl Heard {
    fn hear(&mut self, at: Instant, fed: &InputRecord) {
        match fed {
            InputRecord::Bytes { port: MODBUS, bytes } => match self.on_line.back_mut() {
                Some(stretch) if !self.broken && at.since(stretch.last) < LONGEST => {
                    stretch.bytes.extend(bytes);
                    stretch.last = at;
                }
                _ => {
                    self.on_line.push_back(Stretch { last: at, bytes: bytes.clone() });
                    self.broken = false;
                }
            },
            InputRecord::RxError { port: MODBUS } => self.broken = true,
            InputRecord::Message { port: MODBUS, link: Link(link), bytes } => {
                self.on_links.entry(*link).or_default().push_back(bytes.clone());
            }
            InputRecord::Opened { port: MODBUS, link: Link(link) } => _ = self.on_links.remove(link),
            _ => {}
        }
    }

    /// Removes the request that this reply on a line answers. Fails if there is none.
    fn take_request(&mut self, at: Instant, unit: u8, reply: &[u8], ascii: bool) -> Result<(), &'static str> {
        // The timestamp of a reply may be later than the call that outputs it, and earlier than bytes
        // received after its request. So old stretches stay for a while.
        self.on_line.retain(|stretch| at < stretch.last + LONGEST);
        let mut wrong = "nobody asked for it";
        for stretch in &mut self.on_line {
            for (end, pdu) in requests(&stretch.bytes, unit, reply[0] & !REFUSED, ascii) {
                if answers(reply, &pdu) {
                    stretch.bytes.drain(..end);
                    return Ok(());
                }
                wrong = "it does not fit its request";
            }
        }
        Err(wrong)
    }

    /// Removes the request that this ADU answers. Fails if there is none.
    fn take_message(&mut self, link: u8, reply: &[u8]) -> Result<(), &'static str> {
        let (header, pdu) = tcp::parse(reply).ok_or("it is no ADU")?;
        let waiting = self.on_links.entry(link).or_default();
        while let Some(request) = waiting.pop_front() {
            // A drive does not answer bytes that are no ADU.
            let Some((asked, request)) = tcp::parse(&request) else { continue };
            let fits = asked == header && answers(pdu, request);
            return if fits { Ok(()) } else { Err("it does not fit its request") };
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

/// Checks all replies of one run of the emulator. `addresses` are those of the drives.
pub(crate) fn judge(trace: &Trace, addresses: &BTreeMap<&'static str, u8>) -> Result<(), Failure> {
    let mut heard: Vec<Heard> = trace.drives.iter().map(|_| Heard::default()).collect();
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
                heard.take_message(*link, bytes).map_err(|wrong| (wrong, bytes))
            }
            Event::Output(_) | Event::Shaft { .. } => Ok(()),
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

    /// Judges a reply to the received bytes.
    fn judged(heard: &[&[u8]], reply: &[u8]) -> Result<(), &'static str> {
        let mut drive = Heard::default();
        for bytes in heard {
            drive.hear(Instant::ZERO, &InputRecord::Bytes { port: MODBUS, bytes: bytes.to_vec() });
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
        let mut drive = Heard::default();
        drive.hear(Instant::ZERO, &InputRecord::Bytes { port: MODBUS, bytes: request.to_vec() });
        let mut answer = || reply_on_line(&mut drive, Instant::ZERO, Some(OWN), &request);
        assert_eq!((answer(), answer()), (Ok(()), Err("nobody asked for it")));
    }

    #[test]
    fn an_unreadable_character_is_in_no_request() {
        let request = rtu::write(OWN, 1, 2);
        let mut drive = Heard::default();
        for fed in [
            InputRecord::Bytes { port: MODBUS, bytes: request[..4].to_vec() },
            InputRecord::RxError { port: MODBUS },
            InputRecord::Bytes { port: MODBUS, bytes: request[4..].to_vec() },
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
            let mut drive = Heard::default();
            let bytes = request.to_vec();
            drive.hear(Instant::ZERO, &InputRecord::Message { port: MODBUS, link: Link(0), bytes });
            drive
        };
        assert_eq!(asked().take_message(0, &reply), Ok(()));
        assert_eq!(asked().take_message(1, &reply), Err("nobody asked for it"));
        assert_eq!(asked().take_message(0, &other), Err("it does not fit its request"));
    }
}
