//! Silences on the serial line, and the direction of RS-485.

use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::md3::at;

use crate::play::{Drive, Nanos, Script, US};
use crate::{CHARACTER, START, TURN, expect_written, image, pin, write};

/// A baud rate: its code in 7.22, the duration of a character, and t1.5 and t3.5 of the Modbus serial line
/// specification, 2.5.1.1.
struct Rate {
    code: u16,
    character: Nanos,
    t15: Nanos,
    t35: Nanos,
}

/// The rate 9600 8E1: a character has 11 bits, and the silences have 16.5 and 38.5 bits.
const SLOW: Rate =
    Rate { code: 0x21, character: CHARACTER, t15: 16_500_000_000 / 9_600, t35: 38_500_000_000 / 9_600 };
/// 115,200 8E1: "fixed values […] of 750 µs […] and 1.750 ms".
const FAST: Rate = Rate { code: 0x25, character: 11_000_000_000 / 115_200, t15: 750 * US, t35: 1_750 * US };

/// Tested silences: up to so many µs below and above the limit.
const AROUND: i64 = 12;
/// Within so many µs of the limit a silence may count as either side. Timestamps are whole µs, and an
/// interrupt takes a part of one.
const TOLERANCE: i64 = 2;

/// Sends a request repeatedly. Its silence gets 1 µs longer each time, from [`AROUND`] µs below `edge` to as
/// much above. `request` sends the characters with such a silence at an instant. Returns the differences from
/// `edge`, in µs, for which the drive replied.
fn answered(rate: &Rate, edge: Nanos, request: impl Fn(&mut Script, Nanos, Nanos)) -> Vec<i64> {
    let mut script = Script::fast();
    let set_up = [(at::SERIAL_PORT, rate.code)];
    let first = write(&mut script, START, &set_up);
    let instants = |n: i64| first + (n + AROUND) as u64 * TURN;
    for n in -AROUND..=AROUND {
        request(&mut script, instants(n), edge.saturating_add_signed(n * US as i64));
    }
    let run = script.play(&image(), instants(AROUND + 1));
    expect_written(&run, START, &set_up);
    let reply = rtu::frame(1, &[3, 2, 0x27, 0x10]);
    (-AROUND..=AROUND)
        .filter(|&n| {
            let (_, sent) = run.sent(instants(n), instants(n + 1));
            assert!(sent.is_empty() || sent == reply.as_slice(), "{sent:02x?}");
            !sent.is_empty()
        })
        .collect()
}

/// Reads MoveSteps of a new drive, 10,000 (7.16).
fn question() -> Vec<u8> {
    rtu::read(1, at::MOVE_STEPS + 1, 1).to_vec()
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_silence_longer_than_t15_breaks_a_frame() {
    for rate in [SLOW, FAST] {
        let answered = answered(&rate, rate.t15, |script, at, silence| {
            let question = question();
            let (head, tail) = question.split_at(4);
            script.hear(at, head);
            script.hear(at + 4 * rate.character + silence, tail);
        });
        println!("t1.5 at code {:#x}: whole up to {:+} µs", rate.code, answered.last().unwrap_or(&-AROUND));
        for n in -AROUND..=-TOLERANCE {
            assert!(answered.contains(&n), "broken {n} µs from t1.5");
        }
        assert!(answered.iter().all(|&n| n < TOLERANCE), "whole beyond t1.5: {answered:?}");
    }
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_silence_of_t35_ends_a_frame() {
    for rate in [SLOW, FAST] {
        let answered = answered(&rate, rate.t35, |script, at, silence| {
            // The board receives a character for another device, then a request.
            script.hear(at, &[0x55]);
            script.hear(at + rate.character + silence, &question());
        });
        println!("t3.5 at code {:#x}: two from {:+} µs", rate.code, answered.first().unwrap_or(&AROUND));
        for n in TOLERANCE..=AROUND {
            assert!(answered.contains(&n), "one frame {n} µs beyond t3.5");
        }
        assert!(answered.iter().all(|&n| n > -TOLERANCE), "two frames below t3.5: {answered:?}");
    }
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn the_transceiver_is_turned_around_in_time() {
    let mut script = Script::fast();
    let asked = START;
    script.hear(asked, &question());
    let run = script.play(&image(), asked + TURN);
    let (begins, reply) = run.sent(asked, asked + TURN);
    assert_eq!(reply, rtu::frame(1, &[3, 2, 0x27, 0x10]).as_slice());

    // PROJECT-3: the reply starts 4.5 characters after the last character of the request.
    let last = asked + 7 * CHARACTER;
    let due = last + 4_500 * CHARACTER / 1_000;
    println!("reply {} ns late", begins - due);
    assert!((due..due + 60 * US).contains(&begins), "due {due}, begins {begins}");

    let ends = begins + reply.len() as u64 * CHARACTER;
    let [rise] = run.edges(pin::DE, Drive::High)[..] else { panic!("DE does not rise once") };
    let falls = run.edges(pin::DE, Drive::Low);
    let fall = *falls.last().expect("DE falls");
    println!("DE rises {} ns before the reply, falls {} ns behind it", begins - rise, fall - ends);
    assert!(rise <= begins && begins - rise < 20 * US, "DE rises at {rise}, the reply begins at {begins}");
    // DE falls before the master may send again, but not before the end of the last stop bit. Divisors are
    // rounded by 0.1 %.
    assert!(
        fall + 10 * US >= ends && fall < ends + CHARACTER,
        "the reply ends at {ends}, DE falls at {fall}"
    );
}
