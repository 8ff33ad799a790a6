//! Digital port, captures, and pulses of triggers.

use super::*;

#[test]
fn inputs_read_their_pins_and_outputs_are_open_drains() {
    let mut bed = Bed::ready(Qsb::m());
    bed.pin(DIO1, false);
    assert_eq!(bed.ask("R01"), "r 01 0000000D !");
    bed.write("W02F00");
    bed.write("W015");
    let levels = [DIO0, DIO1, DIO2, DIO3].map(|pin| bed.level(pin));
    assert_eq!(levels, [Level::Float, Level::Low, Level::Float, Level::Low]);
    assert_eq!(bed.ask("R01"), "r 01 00000005 !");
    // An output of 1 that is pulled low from outside reads 0.
    bed.pin(DIO0, false);
    assert_eq!(bed.ask("R01"), "r 01 00000004 !");
    bed.pin(DIO0, true);
    // A write of the configuration lets all go.
    bed.write("W02F00");
    assert_eq!(bed.ask("R01"), "r 01 0000000D !");
    assert_eq!(bed.level(DIO3), Level::Float);
}

#[test]
fn a_write_sets_the_latches_of_inputs_too() {
    let mut bed = Bed::ready(Qsb::m());
    bed.write("W02100");
    bed.write("W010");
    assert_eq!(bed.level(DIO0), Level::Low);
    assert_eq!(bed.level(DIO3), Level::Float);
    assert_eq!(bed.ask("R01"), "r 01 0000000E !");
}

#[test]
fn a_qsb_d_has_one_line() {
    let mut bed = Bed::ready(Qsb::d());
    bed.write("W02F00");
    bed.write("W010");
    assert_eq!(bed.ask("R01"), "r 01 0000000E !");
    assert!(bed.world.levels.iter().all(|(_, pin, _)| *pin == DIO0));
    bed.pin(DIO2, false);
    assert_eq!(bed.ask("R01"), "r 01 0000000E !");
}

#[test]
fn an_input_captures_the_edge_that_it_is_set_to() {
    let mut bed = Bed::ready(Qsb::m());
    bed.write("W0343");
    // DIO0 and DIO3 capture, DIO0 the falling edge, DIO3 the rising one.
    bed.write("W0291");
    bed.turn(4);
    bed.pin(DIO0, false);
    assert_eq!(bed.ask("R05"), "r 05 00000004 !");
    bed.turn(4);
    bed.pin(DIO0, true);
    bed.pin(DIO3, false);
    bed.pin(DIO1, false);
    assert_eq!(bed.ask("R05"), "r 05 00000004 !");
    bed.pin(DIO3, true);
    assert_eq!(bed.ask("R05"), "r 05 00000008 !");
    // In every MODE.
    bed.write("W0002");
    bed.turn(4);
    bed.pin(DIO0, false);
    assert_eq!(bed.ask("R05"), "r 05 0000000C !");
    bed.pin(DIO0, true);
    // Not while it is an output.
    bed.write("W02191");
    bed.turn(4);
    bed.pin(DIO0, false);
    assert_eq!(bed.ask("R05"), "r 05 0000000C !");
}

#[test]
fn the_index_captures_the_count_before_it_acts() {
    // Example 5.2, on the factory's MDR0 and on one whose index resets.
    for (mdr0, after) in [("W034F", 8), ("W0323", 0)] {
        let mut bed = Bed::ready(Qsb::s());
        bed.write(mdr0);
        bed.write("W04010");
        bed.turn(8);
        bed.pin(I, true);
        bed.wait(1.micros());
        assert_eq!(bed.ask("R05"), "r 05 00000008 !");
        assert_eq!(bed.ask("R0E"), std::format!("r 0E {after:08X} !"));
        bed.pin(I, false);
        bed.wait(1.micros());
        bed.write("W04000");
        bed.turn(8);
        bed.pin(I, true);
        bed.wait(1.micros());
        assert_eq!(bed.ask("R05"), "r 05 00000008 !", "only if MDR1 says so");
    }
}

/// A QSB-M whose counter is about to meet DTR, with a trigger on a match.
fn about_to_match(interval: &str) -> Bed {
    let mut bed = Bed::ready(Qsb::m());
    for command in ["W0343", "W084", "W0420", "W021100"] {
        bed.write(command);
    }
    bed.write(&std::format!("W0C{interval}"));
    bed
}

#[test]
fn a_trigger_makes_a_pulse_on_dio0() {
    let mut bed = about_to_match("2");
    let from = bed.world.levels.len();
    bed.run_until(100.millis());
    bed.turn(4);
    bed.wait(10.millis());
    // The fourth edge is 4 µs after the beginning; the filter holds it back two ticks.
    let begin = Instant::from(100.millis()) + 4.micros() + Duration::from_ticks(2);
    assert_eq!(bed.levels(DIO0, from), [(begin, Level::Low), (begin + TICK * 2, Level::Float)]);
}

#[test]
fn a_board_that_counts_triggers_once_for_many_steps() {
    let mut bed = about_to_match("2");
    bed.write("W081F4");
    let from = bed.world.levels.len();
    // 250 cycles, from and to A and B both high.
    bed.input(100.millis().into(), Input::Count { encoder: Encoder(0), steps: 1_000, a: true, b: true });
    assert_eq!(bed.ask("R0E"), "r 0E 000003E8 !");
    // CMP, CEN and U/D.
    assert_eq!(bed.ask("R06"), "r 06 0000002A !");
    bed.wait(10.millis());
    let begin = Instant::from(100.millis());
    assert_eq!(bed.levels(DIO0, from), [(begin, Level::Low), (begin + TICK * 2, Level::Float)]);
}

#[test]
fn the_pulse_inverts_what_was_written() {
    let mut bed = about_to_match("2");
    bed.write("W01E");
    let from = bed.world.levels.len();
    bed.turn(4);
    assert_eq!(bed.ask("R01"), "r 01 0000000F !");
    bed.wait(10.millis());
    assert_eq!(bed.ask("R01"), "r 01 0000000E !");
    let levels: Vec<_> = bed.levels(DIO0, from).into_iter().map(|(_, level)| level).collect();
    assert_eq!(levels, [Level::Float, Level::Low]);
}

#[test]
fn a_new_event_begins_the_pulse_anew() {
    let mut bed = about_to_match("4");
    let from = bed.world.levels.len();
    bed.turn(4);
    bed.wait(5.millis());
    bed.turn(-4);
    bed.turn(4);
    let last = bed.now - 1.micros() + Duration::from_ticks(2);
    bed.wait(50.millis());
    let levels = bed.levels(DIO0, from);
    assert_eq!(levels.len(), 2);
    assert_eq!(levels[1], (last + TICK * 4, Level::Float));
}

#[test]
fn an_interval_of_0_toggles() {
    let mut bed = about_to_match("0");
    let from = bed.world.levels.len();
    for _ in 0..3 {
        bed.turn(4);
        bed.turn(-4);
    }
    bed.wait(1.secs());
    let levels: Vec<_> = bed.levels(DIO0, from).into_iter().map(|(_, level)| level).collect();
    assert_eq!(levels, [Level::Low, Level::Float, Level::Low]);
}

#[test]
fn a_trigger_needs_its_flag_bit_12_and_an_output() {
    for (command, pulses) in
        [("W0420", 1), ("W0490", 0), ("W021000", 0), ("W020100", 0), ("W0440", 0), ("W04E0", 1)]
    {
        let mut bed = about_to_match("1");
        bed.write(command);
        let from = bed.world.levels.len();
        bed.turn(4);
        bed.wait(50.millis());
        assert_eq!(bed.levels(DIO0, from).len(), 2 * pulses, "{command}");
    }
}

#[test]
fn overflow_underflow_and_index_trigger() {
    for (mdr1, preset, quarters) in [("W0480", "W08FFFFFFFC", 4), ("W0440", "W084", -4)] {
        let mut bed = about_to_match("1");
        for command in [mdr1, preset, "W0A0"] {
            bed.write(command);
        }
        let from = bed.world.levels.len();
        bed.turn(quarters);
        bed.wait(50.millis());
        assert_eq!(bed.levels(DIO0, from).len(), 2, "{mdr1}");
    }
    let mut bed = about_to_match("1");
    bed.write("W0410");
    let from = bed.world.levels.len();
    bed.pin(I, true);
    bed.wait(50.millis());
    assert_eq!(bed.levels(DIO0, from).len(), 2);
}

#[test]
fn a_write_of_the_port_ends_a_pulse() {
    let mut bed = about_to_match("FFFF");
    bed.turn(4);
    bed.wait(1.micros());
    assert_eq!(bed.level(DIO0), Level::Low);
    bed.write("W01F");
    assert_eq!(bed.level(DIO0), Level::Float);
    let from = bed.world.levels.len();
    bed.wait(200.secs());
    assert_eq!(bed.levels(DIO0, from), []);
}

#[test]
fn edges_that_the_filter_holds_back_count_before_a_capture() {
    let mut bed = Bed::ready(Qsb::m());
    bed.write("W0343");
    bed.write("W02010");
    bed.turn(3);
    // The fourth edge is B rising. DIO0 rises at that very instant.
    bed.pin(DIO0, false);
    let (port, at) = (bed.ask("R0E"), bed.now);
    assert_eq!(port, "r 0E 00000003 !");
    bed.input(at, Input::Edge { pin: B, high: true });
    bed.input(at, Input::Edge { pin: DIO0, high: true });
    assert_eq!(bed.ask("R05"), "r 05 00000004 !");
}
