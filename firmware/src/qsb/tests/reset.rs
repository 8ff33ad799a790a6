//! Start, banner, reset.

use super::*;

const STARTUP: Duration = Duration::millis(50);

#[test]
fn the_banner_comes_50_ms_after_power() {
    for (make, banner) in
        [(Qsb::d as fn() -> Qsb, "QSB-D  0E!\r\n"), (Qsb::m, "QSB-M  0E!\r\n"), (Qsb::s, "QSB-S  0E!\r\n")]
    {
        let mut bed = Bed::off(make());
        bed.power_on(Boot::default());
        bed.run_until(1.secs());
        assert_eq!(bed.world.sent, [(Instant::ZERO + STARTUP, banner.to_string())]);
        let bed = Bed::ready(make());
        assert_eq!(bed.world.sent, [(Instant::ZERO, banner.to_string())]);
        assert_eq!(bed.world.lines[0].1.to_string(), "230400 8N1");
    }
}

#[test]
fn before_the_banner_nothing_is_heard() {
    let mut bed = Bed::off(Qsb::m());
    bed.power_on(Boot::default());
    bed.run_until(Instant::ZERO + STARTUP - bed.character * 2 - Duration::TICK);
    bed.hear(b"R0");
    assert_eq!(bed.world.notes, [Note::Dropped { port: USB, why: Why::Starting }; 2]);
    bed.hear(b"\rR08\r");
    bed.wait(10.millis());
    let texts: Vec<_> = bed.texts().into_iter().map(|(_, text)| text).collect();
    assert_eq!(texts, ["QSB-M  0E!", "r 08 000001F3 !"]);
}

#[test]
fn the_clock_runs_from_power_on() {
    let mut bed = Bed::off(Qsb::m());
    bed.now = Instant::from(10.millis());
    bed.power_on(Boot::default());
    bed.run_until(Instant::from(10.millis()) + TICK * 100);
    assert_eq!(bed.peek(Reg::TimeStamp), 100);
}

#[test]
fn opening_the_port_resets_it() {
    let mut bed = Bed::off(Qsb::m());
    bed.power_on(Boot::default());
    bed.run_until(100.millis());
    bed.texts();
    bed.write("W0343");
    bed.write("W0C5");
    bed.write("W02F00");
    bed.write("W010");
    bed.ask("S0E");
    bed.turn(4);
    bed.pin(DIO0, false);
    bed.hear(b"R0");
    bed.texts();
    let from = bed.world.levels.len();
    bed.run_until(1.secs());
    bed.texts();
    bed.input(Instant::from(1.secs()), Input::Attached { port: USB, here: true });
    assert_eq!(bed.levels(DIO3, from), [(Instant::from(1.secs()), Level::Float)]);
    bed.run_until(2.secs());
    assert_eq!(
        bed.texts(),
        [(Instant::from(1_050.millis()), "QSB-M  0E!".into())],
        "no stream, no half command"
    );
    assert_eq!(bed.ask("R0E"), "r 0E 00000000 !");
    assert_eq!(bed.ask("R03"), "r 03 0000004F !");
    assert_eq!(bed.ask("R0C"), "r 0C 0000FFFF !");
    assert_eq!(bed.ask("R01"), "r 01 0000000E !", "what is at the pins stays");
    let number = bed.peek(Reg::TimeStamp);
    assert!((512..515).contains(&number), "{number}");
}

#[test]
fn leaving_the_port_changes_nothing() {
    let mut bed = Bed::ready(Qsb::s());
    bed.write("W0C5");
    bed.input(bed.now, Input::Attached { port: USB, here: false });
    assert_eq!(bed.ask("R0C"), "r 0C 00000005 !");
}

#[test]
fn edges_before_the_banner_are_not_counted() {
    for fast in [false, true] {
        let mut bed = Bed::off(Qsb::d());
        bed.drive.power_on(bed.now, Boot { fast, ..Boot::default() }, &mut bed.world);
        for pin in [A, B] {
            bed.drive.input(bed.now, Input::Edge { pin, high: false }, &mut bed.world);
        }
        bed.run_until(100.millis());
        assert_eq!(bed.ask("R0E"), "r 0E 00000000 !");
        // U/D follows B until the counter counts.
        assert_eq!(bed.ask("R06"), "r 06 00000008 !");
    }
}

#[test]
fn a_new_rate_holds_behind_its_answer() {
    let mut bed = Bed::ready(Qsb::m());
    for (rate, line) in [
        (0, "9600 8N1"),
        (1, "19200 8N1"),
        (2, "38400 8N1"),
        (3, "56000 8N1"),
        (4, "115200 8N1"),
        (5, "128000 8N1"),
        (7, "256000 8N1"),
        (6, "230400 8N1"),
    ] {
        let answer = bed.ask(&std::format!("W16{rate}0A"));
        assert_eq!(answer, std::format!("w 16 00000{rate}0A !"));
        let (at, new) = *bed.world.lines.last().unwrap();
        assert_eq!(new.to_string(), line);
        assert_eq!(at, bed.world.sent.last().unwrap().0 + bed.character * 17);
        bed.character = new.character();
    }
    let lines = bed.world.lines.len();
    bed.write("W1660A");
    assert_eq!(bed.world.lines.len(), lines, "it has that rate");
}
