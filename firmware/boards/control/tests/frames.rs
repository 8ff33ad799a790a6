//! Frames among garbage, and messages of every size.

use drivetwin_control::{
    Answer, Call, Course, Decoder, Event, Events, FRAME, Hello, Message, PIECE, Refused, Reply, Request,
    Stimulus, Stretch, encode,
};
use proptest::prelude::*;

/// The numbers of the requests that a board finds in a stream.
fn found(stream: &[u8]) -> Vec<u16> {
    let mut decoder = Decoder::new();
    stream
        .iter()
        .filter_map(|byte| decoder.push::<Request<'_>>(*byte).map(|request| request.number))
        .collect()
}

fn framed(number: u16, call: Call<'_>) -> Vec<u8> {
    encode(&Request { number, call }, &mut [0; FRAME]).unwrap().to_vec()
}

#[test]
fn a_frame_is_a_message_a_crc_and_a_zero() {
    // Number 1 and Call::Hello are the bytes 01 00, and their CRC of Modbus is 20 00, lower byte first. COBS replaces
    // each of the two zeros by the distance to the next one.
    assert_eq!(framed(1, Call::Hello), [2, 1, 1, 2, 0x20, 0]);
}

#[test]
fn a_board_that_does_not_say_its_name_has_none() {
    let hello = |board| Hello { version: 1, kind: "md3", image: "0.1.0", tables: 5, fast_boot: true, board };
    let read = |frame: &[u8]| {
        let mut decoder = Decoder::new();
        let (end, bytes) = frame.split_last().unwrap();
        assert!(bytes.iter().all(|byte| decoder.push::<Message<'_>>(*byte).is_none()));
        match decoder.push(*end) {
            Some(Message::Reply(Reply { number: 7, answer: Ok(Answer::Hello(hello)) })) => {
                hello.board.to_owned()
            }
            other => panic!("{other:?}"),
        }
    };
    let reply = |board| Message::Reply(Reply { number: 7, answer: Ok(Answer::Hello(hello(board))) });
    assert_eq!(read(encode(&reply("pico2"), &mut [0; FRAME]).unwrap()), "pico2");
    // The fields of older images: those of the reply, and of the hello without its last one.
    let older = (0_u8, 7_u16, 0_u8, 1_u8, (1_u16, "md3", "0.1.0", 5_u16, true));
    assert_eq!(read(encode(&older, &mut [0; FRAME]).unwrap()), "");
}

#[test]
fn the_longest_pieces_fit() {
    let piece = [0xA5; PIECE];
    let write = framed(u16::MAX, Call::WriteMemory { offset: u16::MAX, bytes: &piece });
    assert_eq!(found(&write), [u16::MAX]);
    let reply = |answer| Message::Reply(Reply { number: u16::MAX, answer: Ok(answer) });
    for answer in [Answer::Memory(&piece), Answer::Words(&piece)] {
        assert!(encode(&reply(answer), &mut [0; FRAME]).is_ok());
    }
    let events = Message::Events(Events { number: u32::MAX, at: u64::MAX, bytes: &piece });
    assert!(encode(&events, &mut [0; FRAME]).is_ok());
    let long = [1; FRAME];
    assert!(encode(&reply(Answer::Memory(&long)), &mut [0; FRAME]).is_err());
}

#[test]
fn a_plan_fits_into_one_event() {
    let stretch = Stretch {
        ticks: u64::MAX,
        acceleration: i32::MIN,
        start_speed: i64::MAX,
        base: i32::MIN,
        phase_offset: i64::MAX,
        reverse: true,
    };
    let plan = Event::Plan(0, Course { start: u64::MAX, stretches: [Some(stretch); 3] });
    let mut bytes = [0; PIECE];
    let used = postcard::to_slice(&(i64::MIN, plan), &mut bytes).unwrap().len();
    let decoded: Vec<_> = Events { number: 0, at: 0, bytes: &bytes[..used] }.decode().collect();
    assert_eq!(decoded, [(1 << 63, plan)]);
}

#[test]
fn events_have_the_times_of_the_board() {
    let mut bytes = Vec::new();
    let events = [
        (0_i64, Event::Received(0, 0x55)),
        (16, Event::Idle(0)),
        (3, Event::Sent(0, &[1, 2])),
        (-19, Event::Lost(9)),
    ];
    for event in events {
        let mut room = [0; 32];
        bytes.extend_from_slice(postcard::to_slice(&event, &mut room).unwrap());
    }
    let decoded: Vec<_> = Events { number: 0, at: 1_000, bytes: &bytes }.decode().collect();
    let expected = [
        (1_000, Event::Received(0, 0x55)),
        (1_016, Event::Idle(0)),
        (1_019, Event::Sent(0, &[1, 2])),
        (1_000, Event::Lost(9)),
    ];
    assert_eq!(decoded, expected);
}

#[test]
fn a_refusal_and_a_stimulus_survive() {
    let call = Call::Drive { pin: 63, stimulus: Stimulus::Millivolts(i32::MIN) };
    let frame = framed(2, call);
    let mut decoder = Decoder::new();
    let back =
        frame.iter().find_map(|byte| decoder.push::<Request<'_>>(*byte).map(|request| request.call == call));
    assert_eq!(back, Some(true));
    let reply = Message::Reply(Reply { number: 3, answer: Err(Refused::Driven) });
    let mut room = [0; FRAME];
    let frame = encode(&reply, &mut room).unwrap();
    let mut decoder = Decoder::new();
    assert!(frame.iter().any(|byte| decoder.push::<Message<'_>>(*byte) == Some(reply)));
}

proptest! {
    #[test]
    fn garbage_hides_no_later_frame(garbage in prop::collection::vec(any::<u8>(), 0..700), number in any::<u16>()) {
        // Garbage without a zero at its end spoils the frame behind it, as its beginning. The next one is found.
        let stream = [garbage, framed(number, Call::State), framed(number, Call::Hello)].concat();
        prop_assert_eq!(found(&stream).last().copied(), Some(number));
    }

    #[test]
    fn a_flipped_bit_makes_no_message(row in any::<u16>(), value in any::<i64>(), bit in 0..64_usize) {
        let mut frame = framed(9, Call::Preset { row, value });
        let bit = bit % (8 * (frame.len() - 1));
        frame[bit / 8] ^= 1 << (bit % 8);
        prop_assert!(found(&frame).is_empty());
    }
}
