use drivetwin_protocol::line::Parity;
use drivetwin_protocol::modbus::RtuOrAscii;
use drivetwin_protocol::modbus::pdu::Exception;

use super::*;

use crate::testing::{Recorder, Treatment};

const RS485: Port = Port(0);
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
fn powered(line: Line, out: &mut Recorder) -> ModbusPort<RtuOrAscii> {
    let mut port = ModbusPort::new(RS485, RTU);
    port.start(Instant::ZERO, line, START - Duration::TICK, out);
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
        assert_eq!(out.lines, [(Instant::ZERO, RS485, line)]);
        assert_eq!(port.deadline(), Instant::NEVER);
        let first = START + ticks(character);
        port.bytes(first, message, &mut out);
        let over = first + over;
        assert_eq!(port.deadline(), over);
        assert!(!port.is_over(over - Duration::TICK) && port.is_over(over));
        assert_eq!(port.receiver.take_body(), Some(Ok(&BODY[..])));
        assert_eq!(port.deadline(), Instant::NEVER);
        let delay = Duration::millis(3);
        let (outcome, mut reply) = (Outcome::Dropped(DropReason::Crc), Frame::from_slice(&BODY).unwrap());
        let sent = port.answer(over, delay, outcome, &mut reply, &mut out);
        assert_eq!(out.sent(RS485), [(over + delay, message.to_vec())]);
        assert_eq!(port.duration(sent), ticks(character * message.len() as u64));
        assert_eq!(out.notes, [(over, LogEvent::of(RS485, outcome))]);
    }
}

#[test]
fn a_check_sum_that_does_not_hold() {
    for (line, message) in [(RTU, &[1, 3, 0x50, 0, 0, 1, 0x95, 0x0B][..]), (ASCII, b":010350000001AA\r\n")] {
        let mut out = recorder();
        let mut port = powered(line, &mut out);
        port.bytes(START + Duration::TICK, message, &mut out);
        assert_eq!(port.receiver.take_body(), Some(Err(DropReason::Crc)));
    }
}

#[test]
fn a_spoiled_character_spoils_the_message() {
    for (line, message) in [(RTU, &RTU_BODY[..]), (ASCII, ASCII_BODY)] {
        let mut out = recorder();
        let mut port = powered(line, &mut out);
        let (spoiled, character) = (Input::RxError { port: RS485 }, line.character());
        // The port does not receive it yet, or another port receives it.
        assert!(!port.input(START - Duration::TICK, &spoiled, &mut out));
        assert!(!port.input(START, &Input::RxError { port: Port(7) }, &mut out));
        port.bytes(START + Duration::TICK, message, &mut out);
        assert_eq!(port.receiver.take_body(), Some(Ok(&BODY[..])));
        let first = START + Duration::secs(1);
        port.bytes(first, &message[..3], &mut out);
        assert!(!port.input(first + character * 3, &spoiled, &mut out));
        port.bytes(first + character * 4, &message[4..], &mut out);
        assert_eq!(port.receiver.take_body(), Some(Err(DropReason::RxError)));
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
            port.start(Instant::ZERO, line, START - Duration::TICK, &mut out);
            port.bytes(first, &burst[..cut], &mut out);
            port.bytes(first + character * cut as u64, &burst[cut..], &mut out);
            assert_eq!(port.receiver.take_body(), Some(Ok(&BODY[..])), "{line}, cut at {cut}");
        }
        out.notes.clear();
        port.bytes(START + Duration::secs(1), &message[..3], &mut out);
        port.mute();
        assert_eq!(port.receiver.take_body(), None);
        port.bytes(START + Duration::secs(9), message, &mut out);
        assert_eq!((port.deadline(), port.receiver.take_body()), (Instant::NEVER, None));
        let deaf = LogEvent::Dropped { port: RS485, why: DropReason::Starting };
        assert_eq!(out.notes, [(START + Duration::secs(9), deaf)]);
    }
}

#[test]
fn a_frame_for_others_is_one_that_the_slave_only_drops() {
    let rules = Rules {
        functions: &[],
        broadcast: Some(0),
        max_read: 0,
        max_written: 0,
        bits_per_word: 16,
        partial_writes: false,
        bad_quantity: Exception::IllegalDataValue,
        bad_value: Exception::IllegalDataValue,
        read_only: Exception::IllegalDataAddress,
    };
    let mut out = recorder();
    let mut port = powered(RTU, &mut out);
    let before = START - Duration::TICK;
    for (at, address, is_for_others) in
        [(START, 2, true), (START, 1, false), (START, 0, false), (before, 2, false)]
    {
        assert_eq!(port.is_for_others(at, 1, &rules, address), is_for_others, "{at:?} {address}");
    }
    // A part of a frame becomes a longer one, with an error.
    port.bytes(START, &RTU_BODY[..3], &mut out);
    assert!(!port.is_for_others(START + Duration::millis(1), 1, &rules, 2));
}
