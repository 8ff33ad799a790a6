//! CAPTURE, and trigger pulses on DIO0.

use drivetwin_protocol::time::{Duration, Span};

use crate::rig::{Rig, TICK};

/// Register 02: bits 3:0 select the edge (1 = falling), bits 7:4 enable. Each input captures only at its
/// selected edge.
#[test]
fn each_input_captures_at_its_edge() {
    for (kind, inputs) in [("qsb-d", 1), ("qsb-m", 4)] {
        for input in 0..inputs {
            for falling in [false, true] {
                let mut rig = Rig::ready(kind);
                let pin = format!("DIO{input}");
                rig.write("W0343");
                rig.write(&format!("W02{:X}", 0x10 << input | u32::from(falling) << input));
                rig.turn(5);
                rig.low(&pin);
                rig.turn(5);
                rig.high(&pin);
                rig.turn(5);
                let captured = if falling { 5 } else { 10 };
                assert_eq!(rig.read("05"), captured, "{kind} {pin}, falling: {falling}");
                rig.low(&pin);
                rig.turn(5);
                rig.high(&pin);
                let captured = if falling { 15 } else { 20 };
                assert_eq!(rig.read("05"), captured, "{kind} {pin}, falling: {falling}");
            }
        }
    }
}

/// An input that is not enabled does not capture, and an output does not either (QSB-24).
#[test]
fn what_does_not_capture() {
    for config in ["W0200F", "W02EEE", "W021FF"] {
        let mut rig = Rig::ready("qsb-m");
        rig.write("W0343");
        rig.write(config);
        rig.turn(5);
        rig.low("DIO0");
        rig.high("DIO0");
        rig.open("DIO0");
        assert_eq!(rig.read("05"), 0, "{config}");
    }
}

/// Four inputs, each with its own edge, share the one register.
#[test]
fn all_inputs_at_once() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W0343");
    // All inputs are enabled: 0 and 2 at the falling edge, 1 and 3 at the rising edge.
    rig.write("W020F5");
    for (count, pin, high, captured) in [
        (1, "DIO0", false, 1),
        (2, "DIO1", false, 1),
        (3, "DIO2", false, 3),
        (4, "DIO3", false, 3),
        (5, "DIO0", true, 3),
        (6, "DIO1", true, 6),
        (7, "DIO2", true, 6),
        (8, "DIO3", true, 8),
    ] {
        rig.turn(1);
        rig.hold(pin, high);
        assert_eq!((rig.read("0E"), rig.read("05")), (count, captured), "{pin}");
    }
}

/// QSB-24: inputs capture CNTR in every MODE.
#[test]
fn inputs_capture_in_every_mode() {
    for mode in ["W000", "W001", "W002"] {
        let mut rig = Rig::ready("qsb-m");
        rig.write("W0343");
        rig.write(mode);
        rig.write("W02011");
        rig.turn(40);
        rig.low("DIO0");
        assert_eq!(rig.read("05"), 40, "{mode}");
    }
}

/// Step pulses of the drive's own motor do not capture, at either edge (QSB-24).
#[test]
fn steps_of_the_motor_do_not_capture() {
    for config in ["W02060", "W02066"] {
        let mut rig = Rig::ready("qsb-m");
        for command in ["W0343", config, "W1114", "W162"] {
            rig.write(command);
        }
        rig.turn(5);
        rig.write("W168");
        rig.after(2.secs());
        assert_eq!((rig.position(), rig.read("0E"), rig.read("05")), (20, 5, 0), "{config}");
    }
}

/// Example 5.2: the index captures, although its function is disabled by factory default (QSB-19).
#[test]
fn the_index_captures() {
    let mut rig = Rig::ready("qsb-s");
    rig.turn(100);
    rig.high("I");
    // Bit 4 of 04 is not set.
    assert_eq!(rig.read("05"), 0);
    rig.low("I");
    rig.write("W04010");
    rig.turn(100);
    rig.high("I");
    rig.low("I");
    rig.turn(4);
    rig.says(&[("R05", "r 05 000000C8 !"), ("R0E", "r 0E 000000CC !")]);
}

/// QSB-19: the capture precedes the reset or load by the same index.
#[test]
fn the_index_captures_before_it_resets() {
    for (function, left) in [("W0363", 0), ("W0353", 0x1F3), ("W0373", 100)] {
        let mut rig = Rig::ready("qsb-s");
        rig.write(function);
        rig.write("W04010");
        rig.turn(100);
        rig.high("I");
        assert_eq!((rig.read("05"), rig.read("0E")), (100, left), "{function}");
    }
}

/// "Streaming: a new value is output when the register value changes."
#[test]
fn captures_are_streamed() {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W0343");
    rig.write("W02011");
    rig.says(&[("S05", "s 05 00000000 !")]);
    for count in [10, 20, 30] {
        rig.turn(10);
        rig.low("DIO0");
        rig.high("DIO0");
        assert_eq!(rig.texts(10.millis()), [format!("s 05 {count:08X} !")]);
    }
    // Capturing the same value again is not a change.
    rig.low("DIO0");
    assert_eq!(rig.texts(10.millis()), [""; 0]);
}

/// A QSB with DIO0 as a high output, trigger pulses enabled, and these settings.
fn triggered(script: &[&str]) -> Rig {
    let mut rig = Rig::ready("qsb-m");
    rig.write("W0343");
    rig.write("W021100");
    for command in script {
        rig.write(command);
    }
    rig.past_tick(3_000);
    rig
}

/// Returns true if DIO0 is high, and asserts that register 01 shows the same.
#[track_caller]
fn dio0(rig: &mut Rig) -> bool {
    let high = rig.is_high("DIO0");
    let reads = rig.read("01") & 1 == 1;
    assert_eq!(reads, high);
    high
}

/// Asserts a pulse of 8 ticks: the output leaves the level `rest` and returns. The pulse depends on INTERVAL
/// RATE, bit 12 of 02 and the event's flag.
#[track_caller]
fn assert_pulses(rig: &mut Rig, rest: bool) {
    assert_eq!(dio0(rig), !rest, "it begins");
    rig.after(TICK * 7 - 100.micros());
    assert_eq!(dio0(rig), !rest, "it lasts 7 to 8 ticks");
    rig.after(TICK + 200.micros());
    assert_eq!(dio0(rig), rest, "it has ended");
    rig.after(TICK * 20);
    assert_eq!(dio0(rig), rest);
}

#[test]
fn a_match_makes_a_pulse() {
    for (output, rest) in [("W011", true), ("W010", false)] {
        let mut rig = triggered(&["W04020", "W0C8", "W08A", output]);
        rig.turn(9);
        assert_eq!(dio0(&mut rig), rest);
        rig.turn(1);
        assert_pulses(&mut rig, rest);
        // There is no pulse while the count goes down (QSB-17).
        rig.turn(5);
        rig.turn(-5);
        assert_eq!(dio0(&mut rig), rest);
    }
}

#[test]
fn the_index_an_overflow_and_an_underflow_make_pulses() {
    let mut rig = triggered(&["W04010", "W0C8"]);
    rig.high("I");
    assert_pulses(&mut rig, true);
    rig.low("I");
    assert!(dio0(&mut rig));

    let mut rig = triggered(&["W04040", "W0C8"]);
    rig.turn(-1);
    assert_pulses(&mut rig, true);

    let mut rig = triggered(&["W04080", "W0C8", "W08FFFFFFFE", "W0A0"]);
    rig.turn(1);
    assert_pulses(&mut rig, true);
}

/// No pulse without bit 12 of 02, without the flag, or if DIO0 is an input (QSB-25).
#[test]
fn what_makes_no_pulse() {
    for script in [["W02100", "W04020"], ["W021100", "W040D0"], ["W021000", "W04020"]] {
        let mut rig = triggered(&["W0C8", "W08A"]);
        for command in script {
            rig.write(command);
        }
        rig.turn(10);
        assert!(dio0(&mut rig), "{script:?}");
    }
}

/// INTERVAL RATE 0 "only toggles the digital output", once for each event.
#[test]
fn interval_0_toggles() {
    let mut rig = triggered(&["W04020", "W0C0", "W08A"]);
    rig.turn(10);
    for high in [false, true, false, true, false] {
        assert_eq!(dio0(&mut rig), high);
        rig.after(1.secs());
        assert_eq!(dio0(&mut rig), high);
        rig.turn(-2);
        assert_eq!(dio0(&mut rig), high);
        rig.turn(2);
    }
}

/// A wrap is two events, because CY is set at the count before the wrap and at the wrap (QSB-25).
#[test]
fn a_wrap_toggles_twice() {
    let mut rig = triggered(&["W04080", "W0C0", "W08FFFFFFFE", "W0A0"]);
    for (count, high) in [(0xFFFF_FFFF, false), (0, true), (1, true)] {
        rig.turn(1);
        assert_eq!((rig.read("0E"), dio0(&mut rig)), (count, high));
    }
}

/// A new event during a pulse restarts the pulse.
#[test]
fn an_event_in_a_pulse_restarts_it() {
    let mut rig = triggered(&["W04020", "W0C8", "W08A"]);
    rig.turn(10);
    assert!(!dio0(&mut rig));
    rig.after(TICK * 5);
    rig.turn(-2);
    rig.turn(2);
    rig.after(TICK * 6);
    assert!(!dio0(&mut rig));
    rig.after(TICK * 3);
    assert!(dio0(&mut rig));
}

/// INTERVAL RATE FFFF is a pulse of 65,535 ticks: 128 s.
#[test]
fn the_longest_pulse() {
    let mut rig = triggered(&["W04020", "W08A"]);
    rig.turn(10);
    rig.after(TICK * 65_533);
    assert!(!dio0(&mut rig));
    rig.after(TICK * 3);
    assert!(dio0(&mut rig));
}

/// A pulse of one tick, while edges continue at 1 MHz.
#[test]
fn pulses_while_it_turns() {
    let mut rig = triggered(&["W04020", "W0C1", "W08A", "W0347"]);
    // 0x47 is single-cycle in x4, so each count is passed once.
    rig.turn(9);
    assert!(dio0(&mut rig));
    rig.turn(1_000);
    assert!(!dio0(&mut rig));
    rig.after(TICK);
    assert!(dio0(&mut rig));
    rig.after(Duration::secs(1));
    assert!(dio0(&mut rig));
}
