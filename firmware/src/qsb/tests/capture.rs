//! Digital port, captures, and pulses of triggers.

use super::*;

#[test]
fn inputs_read_their_pins_and_outputs_are_open_drains() {
    let mut dut = Dut::ready(Qsb::m());
    dut.pin(DIO1, false);
    assert_eq!(dut.ask("R01"), "r 01 0000000D !");
    dut.write("W02F00");
    dut.write("W015");
    let levels = [DIO0, DIO1, DIO2, DIO3].map(|pin| dut.level(pin));
    assert_eq!(levels, [Level::Float, Level::Low, Level::Float, Level::Low]);
    assert_eq!(dut.ask("R01"), "r 01 00000005 !");
    // An output of 1 that is pulled low from outside reads 0.
    dut.pin(DIO0, false);
    assert_eq!(dut.ask("R01"), "r 01 00000004 !");
    dut.pin(DIO0, true);
    // A write of the configuration releases all lines.
    dut.write("W02F00");
    assert_eq!(dut.ask("R01"), "r 01 0000000D !");
    assert_eq!(dut.level(DIO3), Level::Float);
}

#[test]
fn a_write_sets_the_latches_of_inputs_too() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W02100");
    dut.write("W010");
    assert_eq!(dut.level(DIO0), Level::Low);
    assert_eq!(dut.level(DIO3), Level::Float);
    assert_eq!(dut.ask("R01"), "r 01 0000000E !");
}

#[test]
fn a_qsb_d_has_one_line() {
    let mut dut = Dut::ready(Qsb::d());
    dut.write("W02F00");
    dut.write("W010");
    assert_eq!(dut.ask("R01"), "r 01 0000000E !");
    assert!(dut.out.levels.iter().all(|(_, pin, _)| *pin == DIO0));
    dut.pin(DIO2, false);
    assert_eq!(dut.ask("R01"), "r 01 0000000E !");
}

#[test]
fn an_input_captures_the_edge_that_it_is_set_to() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0343");
    // DIO0 and DIO3 capture, DIO0 the falling edge, DIO3 the rising one.
    dut.write("W0291");
    dut.turn(4);
    dut.pin(DIO0, false);
    assert_eq!(dut.ask("R05"), "r 05 00000004 !");
    dut.turn(4);
    dut.pin(DIO0, true);
    dut.pin(DIO3, false);
    dut.pin(DIO1, false);
    assert_eq!(dut.ask("R05"), "r 05 00000004 !");
    dut.pin(DIO3, true);
    assert_eq!(dut.ask("R05"), "r 05 00000008 !");
    // The capture works in every MODE.
    dut.write("W0002");
    dut.turn(4);
    dut.pin(DIO0, false);
    assert_eq!(dut.ask("R05"), "r 05 0000000C !");
    dut.pin(DIO0, true);
    // An output does not capture.
    dut.write("W02191");
    dut.turn(4);
    dut.pin(DIO0, false);
    assert_eq!(dut.ask("R05"), "r 05 0000000C !");
}

#[test]
fn the_index_captures_the_count_before_it_acts() {
    // Example 5.2, with the factory's MDR0 and with an MDR0 that resets by the index.
    for (mdr0, after) in [("W034F", 8), ("W0323", 0)] {
        let mut dut = Dut::ready(Qsb::s());
        dut.write(mdr0);
        dut.write("W04010");
        dut.turn(8);
        dut.pin(I, true);
        dut.wait(1.micros());
        assert_eq!(dut.ask("R05"), "r 05 00000008 !");
        assert_eq!(dut.ask("R0E"), std::format!("r 0E {after:08X} !"));
        dut.pin(I, false);
        dut.wait(1.micros());
        dut.write("W04000");
        dut.turn(8);
        dut.pin(I, true);
        dut.wait(1.micros());
        assert_eq!(dut.ask("R05"), "r 05 00000008 !", "only if MDR1 says so");
    }
}

/// A QSB-M with a counter that is about to match DTR, and a trigger on a match.
fn about_to_match(interval: &str) -> Dut {
    let mut dut = Dut::ready(Qsb::m());
    for command in ["W0343", "W084", "W0420", "W021100"] {
        dut.write(command);
    }
    dut.write(&std::format!("W0C{interval}"));
    dut
}

#[test]
fn a_trigger_makes_a_pulse_on_dio0() {
    let mut dut = about_to_match("2");
    let from = dut.out.levels.len();
    dut.run_until(100.millis());
    dut.turn(4);
    dut.wait(10.millis());
    // The fourth edge is made 4 µs after the start; the filter delays it by two ticks.
    let begin = Instant::from(100.millis()) + 4.micros() + Duration::from_ticks(2);
    assert_eq!(dut.levels(DIO0, from), [(begin, Level::Low), (begin + TICK * 2, Level::Float)]);
}

#[test]
fn a_board_that_counts_triggers_once_for_many_steps() {
    let mut dut = about_to_match("2");
    dut.write("W081F4");
    let from = dut.out.levels.len();
    // The encoder turns by 250 cycles, starting and ending with A and B both high.
    dut.input(100.millis().into(), Input::Count { encoder: Encoder(0), steps: 1_000, a: true, b: true });
    assert_eq!(dut.ask("R0E"), "r 0E 000003E8 !");
    // The bits CMP, CEN and U/D are set.
    assert_eq!(dut.ask("R06"), "r 06 0000002A !");
    dut.wait(10.millis());
    let begin = Instant::from(100.millis());
    assert_eq!(dut.levels(DIO0, from), [(begin, Level::Low), (begin + TICK * 2, Level::Float)]);
}

#[test]
fn the_pulse_inverts_what_was_written() {
    let mut dut = about_to_match("2");
    dut.write("W01E");
    let from = dut.out.levels.len();
    dut.turn(4);
    assert_eq!(dut.ask("R01"), "r 01 0000000F !");
    dut.wait(10.millis());
    assert_eq!(dut.ask("R01"), "r 01 0000000E !");
    let levels: Vec<_> = dut.levels(DIO0, from).into_iter().map(|(_, level)| level).collect();
    assert_eq!(levels, [Level::Float, Level::Low]);
}

#[test]
fn a_new_event_begins_the_pulse_anew() {
    let mut dut = about_to_match("4");
    let from = dut.out.levels.len();
    dut.turn(4);
    dut.wait(5.millis());
    dut.turn(-4);
    dut.turn(4);
    let last = dut.now - 1.micros() + Duration::from_ticks(2);
    dut.wait(50.millis());
    let levels = dut.levels(DIO0, from);
    assert_eq!(levels.len(), 2);
    assert_eq!(levels[1], (last + TICK * 4, Level::Float));
}

#[test]
fn an_interval_of_0_toggles() {
    let mut dut = about_to_match("0");
    let from = dut.out.levels.len();
    for _ in 0..3 {
        dut.turn(4);
        dut.turn(-4);
    }
    dut.wait(1.secs());
    let levels: Vec<_> = dut.levels(DIO0, from).into_iter().map(|(_, level)| level).collect();
    assert_eq!(levels, [Level::Low, Level::Float, Level::Low]);
}

#[test]
fn a_trigger_needs_its_flag_bit_12_and_an_output() {
    for (command, pulses) in
        [("W0420", 1), ("W0490", 0), ("W021000", 0), ("W020100", 0), ("W0440", 0), ("W04E0", 1)]
    {
        let mut dut = about_to_match("1");
        dut.write(command);
        let from = dut.out.levels.len();
        dut.turn(4);
        dut.wait(50.millis());
        assert_eq!(dut.levels(DIO0, from).len(), 2 * pulses, "{command}");
    }
}

#[test]
fn overflow_underflow_and_index_trigger() {
    for (mdr1, preset, quarters) in [("W0480", "W08FFFFFFFC", 4), ("W0440", "W084", -4)] {
        let mut dut = about_to_match("1");
        for command in [mdr1, preset, "W0A0"] {
            dut.write(command);
        }
        let from = dut.out.levels.len();
        dut.turn(quarters);
        dut.wait(50.millis());
        assert_eq!(dut.levels(DIO0, from).len(), 2, "{mdr1}");
    }
    let mut dut = about_to_match("1");
    dut.write("W0410");
    let from = dut.out.levels.len();
    dut.pin(I, true);
    dut.wait(50.millis());
    assert_eq!(dut.levels(DIO0, from).len(), 2);
}

#[test]
fn a_write_of_the_port_ends_a_pulse() {
    let mut dut = about_to_match("FFFF");
    dut.turn(4);
    dut.wait(1.micros());
    assert_eq!(dut.level(DIO0), Level::Low);
    dut.write("W01F");
    assert_eq!(dut.level(DIO0), Level::Float);
    let from = dut.out.levels.len();
    dut.wait(200.secs());
    assert_eq!(dut.levels(DIO0, from), []);
}

#[test]
fn edges_that_the_filter_holds_back_count_before_a_capture() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0343");
    dut.write("W02010");
    dut.turn(3);
    // The fourth edge is B rising. DIO0 rises at the same instant.
    dut.pin(DIO0, false);
    let (port, at) = (dut.ask("R0E"), dut.now);
    assert_eq!(port, "r 0E 00000003 !");
    dut.input(at, Input::Edge { pin: B, high: true });
    dut.input(at, Input::Edge { pin: DIO0, high: true });
    assert_eq!(dut.ask("R05"), "r 05 00000004 !");
}

#[test]
fn a_pulse_that_ends_when_the_line_becomes_free_gives_no_record() {
    let mut dut = about_to_match("1");
    dut.ask("S01");
    dut.turn(3);
    dut.hear(b"R0C\rR0C\rR0C\rR0C\r");
    let (begun, text) = dut.texts().last().unwrap().clone();
    // CR and LF follow each text.
    let free = begun + dut.character * (text.len() as u64 + 2);
    let from = dut.out.levels.len();
    // The filter delays the edge by two ticks.
    dut.run_until(free - TICK - Duration::from_ticks(2));
    dut.pin(B, true);
    dut.run_until(free + 10.millis());
    assert_eq!(dut.levels(DIO0, from), [(free - TICK, Level::Low), (free, Level::Float)]);
    assert_eq!(dut.texts(), [], "the port has the value that was sent last");
}
