//! The serial port: Modbus RTU, or ASCII on a line of 7 data bits (6.4).

use drivetwin_protocol::modbus::{DropReason, Frame, ascii, rtu};

use super::RS485;
use crate::device::{Context, Duration, Instant, Line, LogEvent, Output};

/// Receivers of messages, one for each framing.
#[derive(Clone, Debug)]
enum Receivers {
    Rtu(rtu::RtuReceiver),
    Ascii(ascii::AsciiReceiver),
}

/// The serial port of the drive.
#[derive(Clone, Debug)]
pub(super) struct Serial {
    /// Duration of a character.
    character: Duration,
    receiver_kind: Receivers,
    /// Time before which characters are lost.
    receives_from: Instant,
}

impl Serial {
    /// A port on a silent line.
    pub(super) const fn new(line: Line) -> Self {
        let receiver_kind = if ascii::is_on(line) {
            Receivers::Ascii(ascii::AsciiReceiver::new(line))
        } else {
            Receivers::Rtu(rtu::RtuReceiver::new(line))
        };
        Self { character: line.character(), receiver_kind, receives_from: Instant::ZERO }
    }

    /// Starts the port at power-on or at a restart, with the line settings `line`. Drops an incomplete
    /// message. Characters that end before `receives_from` are lost.
    pub(super) fn power_on(
        &mut self,
        at: Instant,
        line: Line,
        receives_from: Instant,
        out: &mut dyn Context,
    ) {
        *self = Self { receives_from, ..Self::new(line) };
        out.put(at, Output::Line { port: RS485, line });
    }

    /// Drops an incomplete message, and all characters until the next [`power_on`](Self::power_on).
    pub(super) fn mute(&mut self) {
        self.receives_from = Instant::NEVER;
        match &mut self.receiver_kind {
            Receivers::Rtu(receiver) => receiver.clear(),
            Receivers::Ascii(receiver) => receiver.clear(),
        }
    }

    /// Handles received characters that follow each other without a gap; `at` is the end of the first one. In
    /// ASCII a line feed is the last of them. If a message has ended before them, the caller must
    /// [take](Self::take) it first.
    pub(super) fn bytes(&mut self, at: Instant, bytes: &[u8], out: &mut dyn Context) {
        let (first, received) = self.received(at, bytes);
        if received.len() < bytes.len() {
            out.put(at, Output::Log(LogEvent::Dropped { port: RS485, why: DropReason::Starting }));
        }
        match &mut self.receiver_kind {
            Receivers::Rtu(receiver) => receiver.bytes(first, received),
            Receivers::Ascii(receiver) => receiver.bytes(first, received),
        }
    }

    /// Handles a character with an error that ended at `at`. Returns true if the drive was receiving.
    pub(super) fn rx_error(&mut self, at: Instant) -> bool {
        let is_receiving = at >= self.receives_from;
        if is_receiving {
            match &mut self.receiver_kind {
                Receivers::Rtu(receiver) => receiver.rx_error(at),
                Receivers::Ascii(receiver) => receiver.rx_error(at),
            }
        }
        is_receiving
    }

    /// Removes the characters that end before reception starts. Returns the end of the first remaining
    /// character, and the remaining characters.
    fn received<'a>(&self, at: Instant, bytes: &'a [u8]) -> (Instant, &'a [u8]) {
        if at >= self.receives_from {
            return (at, bytes);
        }
        let missed = (self.receives_from - Duration::TICK).since(at) / self.character + 1;
        let received = usize::try_from(missed).ok().and_then(|missed| bytes.get(missed..)).unwrap_or(&[]);
        (at + self.character * missed, received)
    }

    /// Time at which a message ends if no more characters follow: in RTU after a silence, in ASCII with its
    /// line feed (RS434-4). [`Instant::NEVER`] if there is no message.
    pub(super) fn deadline(&self) -> Instant {
        match &self.receiver_kind {
            Receivers::Rtu(receiver) => receiver.deadline(),
            Receivers::Ascii(receiver) => receiver.deadline(),
        }
    }

    /// Returns true if a message has ended at `at`, or before a character that ends at `at`.
    pub(super) fn is_over(&self, at: Instant) -> bool {
        self.deadline() <= at
    }

    /// Takes the message that has ended, or whose end the line has detected. Returns its address and PDU, if
    /// its checksum is right; `None` if there is no message. In ASCII an incomplete message stays in the
    /// receiver.
    ///
    /// # Errors
    /// The reason why the received characters are not a message.
    pub(super) fn take(&mut self) -> Option<Result<&[u8], DropReason>> {
        match &mut self.receiver_kind {
            Receivers::Rtu(receiver) => {
                Some(receiver.take()?.and_then(|frame| rtu::verify_crc(frame).ok_or(DropReason::Crc)))
            }
            Receivers::Ascii(receiver) => receiver.take(),
        }
    }

    /// Sends a reply `delay` after `at`; `body` is an address and a PDU. Returns the end of the reply, if the
    /// port was not sending already.
    pub(super) fn reply(&self, at: Instant, delay: Duration, body: &Frame, out: &mut dyn Context) -> Instant {
        let at = at + delay;
        let length = match self.receiver_kind {
            Receivers::Rtu(_) => {
                let mut frame = body.clone();
                rtu::append_crc(&mut frame);
                out.put(at, Output::Bytes { port: RS485, bytes: &frame });
                frame.len()
            }
            Receivers::Ascii(_) => {
                let message = ascii::encode(body);
                out.put(at, Output::Bytes { port: RS485, bytes: &message });
                message.len()
            }
        };
        at + self.character * length as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivetwin_protocol::line::Parity;

    use crate::testing::{Recorder, Treatment};

    const RTU: Line = Line::new(115_200, 8, Parity::Even, 1);
    const ASCII: Line = Line::new(9_600, 7, Parity::Even, 1);
    /// Duration of a character in ticks of 62.5 ns: 11 bits at 115,200 baud, and 10 bits at 9,600.
    const RTU_CHARACTER: u64 = 1_528;
    const ASCII_CHARACTER: u64 = 16_667;
    const START: Instant = Instant::from_ticks(10_000_000);

    /// Request to read 5000h of slave 1, and the same as an RTU frame. The CRC was computed by another
    /// program.
    const BODY: [u8; 6] = [1, 3, 0x50, 0, 0, 1];
    const RTU_BODY: [u8; 8] = [1, 3, 0x50, 0, 0, 1, 0x95, 0x0A];
    /// LRC: 01 + 03 + 50 + 00 + 00 + 01 = 55h, and 55h + ABh = 100h.
    const ASCII_BODY: &[u8] = b":010350000001AB\r\n";

    fn recorder() -> Recorder {
        Recorder::default().ruled(|output| match output {
            Output::Bytes { port: RS485, .. } | Output::Line { port: RS485, .. } | Output::Log(_) => {
                Treatment::Keep
            }
            _ => Treatment::Refuse,
        })
    }

    /// A port that receives from [`START`] on.
    fn powered(line: Line, out: &mut Recorder) -> Serial {
        let mut port = Serial::new(RTU);
        port.power_on(START, line, START, out);
        port
    }

    fn ticks(n: u64) -> Duration {
        Duration::from_ticks(n)
    }

    #[test]
    fn a_message_is_heard_and_answered_in_either_framing() {
        // RTU: 1.75 ms of silence and one more character. ASCII: the line feed.
        let silence = ticks(28_000 + RTU_CHARACTER);
        for (line, message, over, character) in [
            (RTU, &RTU_BODY[..], ticks(7 * RTU_CHARACTER) + silence, RTU_CHARACTER),
            (ASCII, ASCII_BODY, ticks(16 * ASCII_CHARACTER), ASCII_CHARACTER),
        ] {
            let mut out = recorder();
            let mut port = powered(line, &mut out);
            assert_eq!(out.lines, [(START, RS485, line)]);
            assert_eq!(port.deadline(), Instant::NEVER);
            let first = START + ticks(character);
            port.bytes(first, message, &mut out);
            let over = first + over;
            assert_eq!(port.deadline(), over);
            assert!(!port.is_over(over - Duration::TICK) && port.is_over(over));
            assert_eq!(port.take(), Some(Ok(&BODY[..])));
            assert_eq!(port.deadline(), Instant::NEVER);
            let delay = Duration::millis(3);
            let left = port.reply(over, delay, &Frame::from_slice(&BODY).unwrap(), &mut out);
            assert_eq!(out.sent(RS485), [(over + delay, message.to_vec())]);
            assert_eq!(left, over + delay + ticks(character * message.len() as u64));
            assert_eq!(out.notes, []);
        }
    }

    #[test]
    fn a_check_sum_that_does_not_hold() {
        for (line, message) in
            [(RTU, &[1, 3, 0x50, 0, 0, 1, 0x95, 0x0B][..]), (ASCII, b":010350000001AA\r\n")]
        {
            let mut out = recorder();
            let mut port = powered(line, &mut out);
            port.bytes(START + Duration::TICK, message, &mut out);
            assert_eq!(port.take(), Some(Err(DropReason::Crc)));
        }
    }

    #[test]
    fn a_spoiled_character_is_told_and_spoils_the_message() {
        for (line, message) in [(RTU, &RTU_BODY[..]), (ASCII, ASCII_BODY)] {
            let mut out = recorder();
            let mut port = powered(line, &mut out);
            assert!(!port.rx_error(START - Duration::TICK), "not before it has ears");
            let (first, character) = (START + Duration::TICK, line.character());
            port.bytes(first, &message[..3], &mut out);
            assert!(port.rx_error(first + character * 3));
            port.bytes(first + character * 4, &message[4..], &mut out);
            assert_eq!(port.take(), Some(Err(DropReason::RxError)));
        }
    }

    #[test]
    fn what_ends_before_it_hears_is_lost() {
        for (line, message) in [(RTU, &RTU_BODY[..]), (ASCII, ASCII_BODY)] {
            let mut out = recorder();
            let mut port = powered(line, &mut out);
            let character = line.character();
            // Three characters that end before START, and are lost. Directly after them a message.
            let burst = [&[0x30, 0x31, 0x32][..], message].concat();
            let first = START - character * 3;
            for cut in 0..burst.len() {
                port.power_on(first, line, START, &mut out);
                port.bytes(first, &burst[..cut], &mut out);
                port.bytes(first + character * cut as u64, &burst[cut..], &mut out);
                assert_eq!(port.take(), Some(Ok(&BODY[..])), "{line}, cut at {cut}");
            }
            out.notes.clear();
            port.bytes(START + Duration::secs(1), &message[..3], &mut out);
            port.mute();
            assert_eq!(port.take(), None);
            port.bytes(START + Duration::secs(9), message, &mut out);
            assert_eq!((port.deadline(), port.take()), (Instant::NEVER, None));
            let deaf = LogEvent::Dropped { port: RS485, why: DropReason::Starting };
            assert_eq!(out.notes, [(START + Duration::secs(9), deaf)]);
        }
    }
}
