//! A board whose cable is in full use: its line, control and the trace at once, while it moves.

use drivetwin_control::{Answer, Call, Decoder, Event, FRAME, Message, Request, encode};
use drivetwin_firmware::device::{Instant, Plan};
use drivetwin_firmware::motion::Limits;
use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::md3::{at, bit};
use fixed::types::U24F8;

use crate::motion::{ACCELERATION, MOVE, SPEED, STEPS, lateness, steps, taken};
use crate::play::{Drive, MS, Nanos, Run, Script, US};
use crate::{TURN, image, pin, write};

/// Time at which the computer can use the ports.
const READY: Nanos = 200 * MS;
/// A second, in each of which the line and control are busy.
const PERIOD: Nanos = 1_000 * MS;
/// A move of 0.4 s begins in one of so many seconds, because each pulse is two lines of output.
const MOVES: u64 = 10;
/// Requests to the control port in a millisecond: more than the board can answer are not sent.
const CALLS: u64 = 2;
/// Least and greatest delay of a pulse, in ns, with and without a cable (firmware/boards/rp2040/README.md).
const DELAYS: std::ops::RangeInclusive<i64> = 0..=1_300;

fn call(number: u16, call: Call<'_>) -> Vec<u8> {
    encode(&Request { number, call }, &mut [0; FRAME]).expect("it fits").to_vec()
}

/// Messages from the control port.
#[derive(Default)]
struct Got {
    replies: Vec<u16>,
    events: u32,
    /// Events of which the board said that it had left them out.
    lost: u32,
    /// Received characters, and those sent, among the events.
    characters: [usize; 2],
}

/// Decodes the control port's bytes. Events have consecutive numbers.
fn got(run: &Run, from: Nanos, to: Nanos) -> Got {
    let (mut decoder, mut got, mut next) = (Decoder::new(), Got::default(), None);
    for byte in run.got("control ", from, to) {
        match decoder.push::<Message<'_>>(byte) {
            None => {}
            Some(Message::Reply(reply)) => {
                assert!(matches!(reply.answer, Ok(Answer::State(_) | Answer::Done)), "{reply:?}");
                got.replies.push(reply.number);
            }
            Some(Message::Events(events)) => {
                assert!(next.is_none_or(|next| next == events.number), "events are missing without a word");
                let mut count = 0;
                for (_, event) in events.decode() {
                    count += 1;
                    match event {
                        Event::Lost(lost) => got.lost += lost,
                        Event::Received(..) => got.characters[0] += 1,
                        Event::Sent(_, bytes) => got.characters[1] += bytes.len(),
                        _ => {}
                    }
                }
                got.events += count;
                next = Some(events.number.wrapping_add(count));
            }
        }
    }
    got
}

/// Plays `seconds` with full load. Returns the least and the greatest delay of a pulse, and what the computer got.
fn load(seconds: u64) -> (i64, i64, Got) {
    let mut script = Script::fast();
    script.at(0, "usb plug");
    for what in ["usb line 9600 8E1", "usb open bus", "usb open control"] {
        script.at(READY, what);
    }
    script.send(READY + MS, "control", &call(0, Call::Trace(true)));
    let begin = write(&mut script, READY + 20 * MS, &MOVE);
    let read = rtu::read(1, at::MOTION, 1);
    let mut number = 0;
    for second in 0..seconds {
        let start = begin + second * PERIOD;
        if second.is_multiple_of(MOVES) {
            script.hear(start, &rtu::write(1, at::MOTION, bit::MOVE));
        }
        for millisecond in 0..PERIOD / MS {
            let now = start + millisecond * MS + US;
            for _ in 0..CALLS {
                number += 1;
                script.send(now, "control", &call(number as u16, Call::State));
            }
            // A request on the line at each turn: the UART's master and that of the cable take turns.
            if millisecond > 0 && millisecond % (TURN / MS) == 0 && millisecond + TURN / MS <= PERIOD / MS {
                if (millisecond / (TURN / MS)).is_multiple_of(2) {
                    script.hear(now + US, &read);
                } else {
                    script.send(now + US, "bus", &read);
                }
            }
        }
    }
    let end = begin + seconds * PERIOD + 200 * MS;
    let run = script.play(&image(), end);

    let plan =
        Plan::profile(Instant::ZERO, 0, STEPS as i32, Limits::even(U24F8::from_num(SPEED), ACCELERATION));
    let planned = steps(&plan);
    let (mut least, mut most) = (i64::MAX, i64::MIN);
    let rises = run.edges(pin::STEP, Drive::High);
    let moves = (0..seconds).step_by(MOVES as usize);
    for second in moves.clone() {
        let start = begin + second * PERIOD;
        let from = rises.partition_point(|rise| *rise < start);
        let to = rises.partition_point(|rise| *rise < start + PERIOD);
        let (_, first, last) = lateness(&rises[from..to], &planned, taken(start));
        (least, most) = (least.min(first), most.max(last));
    }
    // Every request on the line is answered on the line and at the cable: a write of 8 characters, and reads of 7.
    let reads = PERIOD / TURN - 1;
    let expected = 8 * moves.count() + (7 * reads * seconds) as usize;
    assert_eq!(run.sent(begin, end).1.len(), expected);
    assert_eq!(run.got("bus ", begin, end).len(), expected);
    let got = got(&run, READY, end);
    let all: Vec<u16> = (0..=number).map(|number| number as u16).collect();
    assert_eq!(got.replies, all, "every call is answered, in order");
    (least, most, got)
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_cable_in_full_use_delays_no_pulse_and_loses_nothing_unannounced() {
    // A longer look: DRIVETWIN_LOAD_SECONDS=600.
    let seconds = std::env::var("DRIVETWIN_LOAD_SECONDS").map_or(1, |text| text.parse().expect("seconds"));
    let (least, most, got) = load(seconds);
    let Got { replies, events, lost, characters: [received, sent] } = got;
    println!(
        "{seconds} s: pulses {least} to {most} ns late, {} calls answered, {events} events, {lost} announced as lost, \
             {received} characters received and {sent} sent",
        replies.len()
    );
    assert!(DELAYS.contains(&least) && DELAYS.contains(&most), "pulses are {least} to {most} ns late");
}
