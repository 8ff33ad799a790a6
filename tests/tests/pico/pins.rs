//! Edges that are faster than the board can report them to the drive, and edges at the highest rate that it
//! can report.

use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::md3::{at, bit};

use crate::play::{Drive, MS, Nanos, Script, US};
use crate::{START, TURN, expect_written, image, pin, value, write};

/// J2.4, the encoder's index, A and B (J2.9, J2.10 and J2.12), and the input of the over-temperature fault.
const J2_4: u8 = 7;
const INDEX: u8 = 9;
const A: u8 = 10;
const B: u8 = 11;
const OVER_TEMPERATURE: u8 = 16;

/// Function 0000 of pins 4 and 5: J2.4 going low makes a step (7.8).
const STEP_DIRECTION: (u16, u16) = (at::PINS, 0);
/// Every edge of A and B counts (7.11).
const X4: u16 = 1 << 2;

/// Drives J2.4 low and high `times` times, each level for the time `level`. Returns the instant of the end.
fn pulse(script: &mut Script, mut at: Nanos, times: u32, level: Nanos) -> Nanos {
    for _ in 0..times {
        for drive in ["low", "high"] {
            script.at(at, format_args!("pin {J2_4} {drive}"));
            at += level;
        }
    }
    at
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_level_that_finds_no_room_is_reported_later() {
    const PULSES: u32 = 1_000;
    let mut script = Script::fast();
    let begin = write(&mut script, START, &[STEP_DIRECTION]);
    // The pulses are faster than the loop can process them, and more than fit into the queue.
    let over = pulse(&mut script, begin, PULSES, 5 * US);
    script.at(over, format_args!("pin {OVER_TEMPERATURE} low"));
    let asked = over + 100 * MS;
    script.hear(asked, &rtu::read(1, at::MOTION, 1));
    let run = script.play(&image(), asked + TURN);
    expect_written(&run, START, &[STEP_DIRECTION]);
    let steps = run.edges(pin::STEP, Drive::High).len();
    println!("{PULSES} pulses, {steps} steps");
    assert!(steps < PULSES as usize, "all pulses found room: the test forces nothing");
    assert_eq!(value(&run, asked), bit::FAULT);
}

/// Drives pins to `levels`, repeatedly in this order: `edges` levels in all, at `rate` per second. The drive
/// has the encoder configuration `configured`. Returns the value of the register `counted` after the last
/// level.
fn count(configured: u16, levels: &[(u8, &str)], edges: u16, rate: u64, counted: u16) -> u16 {
    let mut script = Script::fast();
    let set_up = [(at::ENCODER, configured)];
    let mut at = write(&mut script, START, &set_up);
    for (pin, level) in levels.iter().cycle().take(usize::from(edges)) {
        script.at(at, format_args!("pin {pin} {level}"));
        at += 1_000 * MS / rate;
    }
    let asked = at + 10 * MS;
    script.hear(asked, &rtu::read(1, counted, 1));
    let run = script.play(&image(), asked + TURN);
    expect_written(&run, START, &set_up);
    value(&run, asked)
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn edges_at_the_promised_rate_are_all_counted() {
    // The rates are those of firmware/boards/rp2040/README.md. A board that is 3 % too slow loses some of so
    // many edges, because its queue has room for only 256.
    const EDGES: u16 = 10_000;
    // If A leads B, the count goes up (7.11).
    let cycle = [(A, "high"), (B, "high"), (A, "low"), (B, "low")];
    assert_eq!(count(X4, &cycle, EDGES, 80_000, at::ENCODER_COUNT), EDGES);
    let index = [(INDEX, "high"), (INDEX, "low")];
    assert_eq!(count(0, &index, EDGES, 60_000, at::INDEX_COUNT + 1), EDGES / 2);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_pulse_that_is_over_before_its_interrupt_is_a_step() {
    const PULSES: u32 = 200;
    let mut script = Script::fast();
    let mut at = write(&mut script, START, &[STEP_DIRECTION]);
    for n in 0..u64::from(PULSES) {
        // Each level lasts from 0.2 to 5.2 µs.
        pulse(&mut script, at, 1, 200 + n * 25);
        at += 100 * US;
    }
    let run = script.play(&image(), at + MS);
    expect_written(&run, START, &[STEP_DIRECTION]);
    assert_eq!(run.edges(pin::STEP, Drive::High).len(), PULSES as usize);
}
