//! Streams.

use super::*;

/// An adapter with time stamps in its responses and with a free line.
fn stamped(drive: Qsb) -> Dut {
    let mut dut = Dut::ready(drive);
    dut.write("W15F");
    dut
}

#[test]
fn the_encoder_comes_at_ticks_of_the_clock() {
    let mut dut = stamped(Qsb::d());
    dut.write("W0C5");
    dut.command_at(tick(10) + 100.micros(), "S0E");
    dut.run_until(tick(21));
    assert_eq!(
        dut.texts(),
        [
            (tick(10) + 100.micros(), "s 0E 00000000 0000000A !".into()),
            (tick(15), "s 0E 00000000 0000000F !".into()),
            (tick(20), "s 0E 00000000 00000014 !".into()),
        ]
    );
}

#[test]
fn an_interval_of_one_gives_512_records_a_second() {
    let mut dut = stamped(Qsb::m());
    dut.write("W0C1");
    dut.command_at(tick(9), "S0E");
    dut.texts();
    dut.run_until(tick(9 + 5_120));
    let texts = dut.texts();
    assert_eq!(texts.len(), 5_120);
    for (n, (at, text)) in (10_u64..).zip(texts) {
        assert_eq!((at, text), (tick(n), std::format!("s 0E 00000000 {n:08X} !")));
    }
}

#[test]
fn no_interval_gives_one_record_behind_the_other() {
    let mut dut = Dut::ready(Qsb::s());
    dut.hear(b"W150\rW0C0\rS0E\r");
    let begun = dut.texts().last().unwrap().0;
    dut.run_until(begun + 10.millis());
    let texts = dut.texts();
    // A record has 12 characters without CR and LF: 520 µs, more than the 100 µs of a measurement.
    assert_eq!(texts.len(), 19);
    for (n, (at, text)) in (1_u64..).zip(texts) {
        assert_eq!((at, text), (begun + dut.character * 12 * n, "s0E00000000!".into()));
    }
}

#[test]
fn without_an_interval_a_measurement_takes_100_us_and_an_analogue_one_200() {
    for (mode, step) in [("W0000", 100_u64), ("W0001", 100), ("W0002", 200)] {
        let mut dut = Dut::ready(Qsb::s());
        dut.write("W0BFFFF");
        dut.write("W0C0");
        dut.write(mode);
        dut.ask("S0E");
        dut.run_until(tick(20));
        let first = dut.drive.deadline();
        dut.run_until(first);
        assert_eq!(dut.drive.deadline(), first + step.micros(), "{mode}");
        assert_eq!(dut.texts(), [], "nothing has gone as far as the threshold");
    }
}

#[test]
fn an_interval_of_ffff_pauses_and_a_new_one_counts_from_the_last_record() {
    let mut dut = stamped(Qsb::m());
    dut.command_at(tick(10), "S0E");
    dut.run_until(tick(100));
    assert_eq!(dut.texts(), [(tick(10), "s 0E 00000000 0000000A !".into())], "the answer only");
    dut.command_at(tick(101), "W0C96");
    dut.texts();
    dut.run_until(tick(161));
    assert_eq!(dut.texts(), [(tick(160), "s 0E 00000000 000000A0 !".into())]);
    // If the new interval has passed already, the next record is sent at the next tick.
    dut.command_at(tick(165) + 10.micros(), "W0C1");
    dut.texts();
    dut.run_until(tick(167));
    assert_eq!(
        dut.texts(),
        [(tick(166), "s 0E 00000000 000000A6 !".into()), (tick(167), "s 0E 00000000 000000A7 !".into()),]
    );
    dut.command_at(tick(168) - 10.micros(), "W0CFFFF");
    dut.texts();
    dut.run_until(tick(1_000));
    assert_eq!(dut.texts(), []);
}

#[test]
fn a_threshold_compares_with_the_value_sent_last() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0343");
    dut.write("W0B8");
    dut.write("W0C5");
    dut.command_at(tick(10), "S0E");
    dut.texts();
    dut.turn(4);
    dut.run_until(tick(15));
    assert_eq!(dut.texts(), [], "4 counts");
    dut.turn(4);
    dut.run_until(tick(19));
    assert_eq!(dut.texts(), [], "the next look is an interval later");
    dut.run_until(tick(20));
    assert_eq!(dut.texts(), [(tick(20), "s 0E 00000008 !".into())]);
    // The count passes 0 downward.
    dut.turn(-16);
    dut.run_until(tick(25));
    assert_eq!(dut.texts(), [(tick(25), "s 0E FFFFFFF8 !".into())]);
    dut.turn(-4);
    dut.turn(8);
    dut.run_until(tick(40));
    assert_eq!(dut.texts(), []);
}

#[test]
fn a_read_ends_a_stream() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0C1");
    for register in ["01", "05", "06", "0E", "13"] {
        dut.ask(&std::format!("S{register}"));
        dut.ask(&std::format!("R{register}"));
    }
    dut.texts();
    dut.pin(DIO0, false);
    dut.turn(8);
    dut.wait(1.secs());
    assert_eq!(dut.texts(), []);
}

#[test]
fn command_1_ends_encoder_port_and_motor_streams() {
    let mut dut = Dut::ready(Qsb::m());
    // A rising edge of DIO0 captures.
    dut.write("W0210");
    for register in ["01", "05", "06", "0E", "13"] {
        dut.ask(&std::format!("S{register}"));
    }
    dut.write("W0C1");
    dut.write("W161");
    dut.write("W162");
    dut.texts();
    dut.turn(-1);
    dut.wait(10.millis());
    assert_eq!(dut.texts().into_iter().map(|(_, text)| text).collect::<Vec<_>>(), ["s 06 00000049 !"]);
    dut.pin(DIO0, false);
    dut.pin(DIO0, true);
    dut.wait(10.millis());
    assert_eq!(dut.texts().into_iter().map(|(_, text)| text).collect::<Vec<_>>(), ["s 05 000001F3 !"]);
}

#[test]
fn the_port_streams_its_changes_at_once() {
    let mut dut = Dut::ready(Qsb::m());
    assert_eq!(dut.ask("S01"), "s 01 0000000F !");
    let at = Instant::from(5.millis());
    let fall = |pin| (at, Input::Edge { pin, high: false });
    let Fixture { drive, out, .. } = &mut dut.fixture;
    advance(drive, at, [fall(DIO1), fall(DIO3)].into_iter(), out);
    dut.run_until(6.millis());
    assert_eq!(
        dut.texts(),
        [(Instant::from(5.millis()), "s 01 00000005 !".into())],
        "one instant, one record"
    );
    // The line is busy while a record is sent (17 characters, 737 µs).
    dut.pin(DIO1, true);
    dut.wait(100.micros());
    dut.pin(DIO3, true);
    dut.wait(1.millis());
    let free = Instant::from(6.millis()) + dut.character * 17;
    assert_eq!(
        dut.texts(),
        [(Instant::from(6.millis()), "s 01 00000007 !".into()), (free, "s 01 0000000F !".into())]
    );
    // A change that is undone before the line is free is not sent.
    dut.run_until(10.millis());
    dut.pin(DIO0, false);
    dut.wait(100.micros());
    dut.pin(DIO0, true);
    dut.wait(100.micros());
    dut.pin(DIO0, false);
    dut.wait(10.millis());
    assert_eq!(dut.texts(), [(Instant::from(10.millis()), "s 01 0000000E !".into())]);
}

#[test]
fn the_counters_status_streams() {
    let mut dut = Dut::ready(Qsb::d());
    dut.ask("S06");
    dut.run_until(5.millis());
    dut.pin(A, false);
    dut.run_until(5.millis() + 1.millis());
    assert_eq!(dut.texts(), [], "up as before");
    dut.pin(A, true);
    dut.run_until(10.millis());
    // The count goes down and reaches 0: a borrow. The filter takes two clocks of 24 MHz, two ticks.
    let at = Instant::from(6.millis()) + Duration::from_ticks(2);
    assert_eq!(dut.texts(), [(at, "s 06 00000049 !".into())]);
}

#[test]
fn of_those_due_at_one_instant_the_lowest_comes_first_and_the_encoder_last() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0211");
    dut.write("W0C10");
    dut.ask("S13");
    dut.ask("S01");
    dut.ask("S05");
    dut.turn(4);
    dut.command_at(tick(16), "S0E");
    dut.texts();
    dut.run_until(tick(32));
    dut.texts();
    dut.run_until(tick(48) - Duration::TICK);
    dut.input(tick(48), Input::Edge { pin: DIO0, high: false });
    dut.run_until(tick(50));
    let record = dut.character * 17;
    assert_eq!(
        dut.texts(),
        [
            (tick(48), "s 01 0000000E !".into()),
            (tick(48) + record, "s 05 00000004 !".into()),
            (tick(48) + record * 2, "s 0E 00000004 !".into()),
        ]
    );
}

#[test]
fn a_slow_line_measures_when_it_is_free() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W1600A");
    // A character of 10 bits at 9,600 baud takes 16,666.7 ticks.
    dut.character = Duration::from_ticks(16_667);
    dut.write("W15F");
    dut.write("W0C1");
    dut.write("W0343");
    dut.ask("S0E");
    let before = dut.seen;
    dut.wait(1.secs());
    let texts: Vec<_> = dut.sent()[before - 1..].to_vec();
    assert!(texts.len() > 30);
    for pair in texts.windows(2) {
        let ((before, _), (at, text)) = (&pair[0], &pair[1]);
        // A record has 26 characters, 27 ms: more than a tick. Each is measured when the previous one has
        // been sent.
        assert_eq!(*at, *before + dut.character * 26);
        let number = at.ticks() / 31_250;
        assert_eq!(*text, std::format!("s 0E 00000000 {number:08X} !\r\n"));
    }
    dut.texts();
    // A response is sent between two records, and the next record has the newest value.
    dut.hear(b"R08\r");
    dut.turn(4);
    dut.wait(100.millis());
    let texts: Vec<_> = dut.texts().into_iter().map(|(_, text)| text[..13].to_string()).collect();
    assert!(texts.contains(&"r 08 000001F3".to_string()), "{texts:?}");
    assert_eq!(texts.last().unwrap(), "s 0E 00000004");
}

#[test]
fn pwm_and_analogue_stream_by_value() {
    let mut dut = Dut::ready(Qsb::s());
    dut.write("W0002");
    dut.write("W0B3");
    dut.write("W0C1");
    dut.volts(A, 0);
    dut.command_at(tick(16), "S0E");
    dut.texts();
    dut.run_until(tick(20));
    assert_eq!(dut.texts(), [], "the stamp of the packet goes on, the value does not");
    // 9.77 mV are two counts, 14.7 mV three.
    dut.volts(A, 10);
    dut.run_until(tick(22));
    assert_eq!(dut.texts(), []);
    dut.volts(A, 15);
    dut.run_until(tick(24));
    // 23 ticks are 44.92 ms: 89 units of 500 µs.
    assert_eq!(dut.texts(), [(tick(23), "s 0E 0059F003 !".into())]);
}

#[test]
fn what_changes_faster_than_the_line_leaves_room_for_the_others() {
    let mut dut = Dut::ready(Qsb::m());
    dut.write("W0C1");
    dut.ask("S01");
    dut.command_at(tick(16), "S0E");
    dut.texts();
    // A record takes 17 characters of 43.4 µs each; DIO0 changes twice meanwhile.
    let mut low = false;
    while dut.now < Instant::ZERO + 100.millis() {
        low = !low;
        dut.pin(DIO0, low);
        dut.wait(300.micros());
    }
    let texts = dut.texts();
    let of = |register: &str| texts.iter().filter(|(_, text)| text[2..4] == *register).count();
    // From tick 16 to 100 ms there are 35 ticks.
    assert_eq!(of("0E"), 35);
    assert!(of("01") > 35, "{} records of the port", of("01"));
}
