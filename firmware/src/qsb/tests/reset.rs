//! Start-up, banner, reset.

use super::*;

const STARTUP: Duration = Duration::millis(50);

#[test]
fn the_banner_comes_50_ms_after_power() {
    for (make, banner) in
        [(Qsb::d as fn() -> Qsb, "QSB-D  0E!\r\n"), (Qsb::m, "QSB-M  0E!\r\n"), (Qsb::s, "QSB-S  0E!\r\n")]
    {
        let mut dut = Dut::off(make());
        dut.power_on(Boot::default());
        dut.run_until(1.secs());
        assert_eq!(dut.sent(), [(Instant::ZERO + STARTUP, banner.to_string())]);
        let dut = Dut::ready(make());
        assert_eq!(dut.sent(), [(Instant::ZERO, banner.to_string())]);
        assert_eq!(dut.out.lines[0].2.to_string(), "230400 8N1");
    }
}

#[test]
fn before_the_banner_nothing_is_heard() {
    let mut dut = Dut::off(Qsb::m());
    dut.power_on(Boot::default());
    let end = Instant::ZERO + STARTUP - dut.character * 2 - Duration::TICK;
    dut.run_until(end);
    dut.hear(b"R0");
    assert_eq!(dut.out.noted(), [LogEvent::Dropped { port: USB, why: DropReason::Starting }; 2]);
    dut.hear(b"\rR08\r");
    dut.wait(10.millis());
    let texts: Vec<_> = dut.texts().into_iter().map(|(_, text)| text).collect();
    assert_eq!(texts, ["QSB-M  0E!", "r 08 000001F3 !"]);
}

#[test]
fn the_clock_runs_from_power_on() {
    let mut dut = Dut::off(Qsb::m());
    dut.now = Instant::from(10.millis());
    dut.power_on(Boot::default());
    dut.run_until(Instant::from(10.millis()) + TICK * 100);
    assert_eq!(dut.get(Reg::TimeStamp), 100);
}

#[test]
fn opening_the_port_resets_it() {
    let mut dut = Dut::off(Qsb::m());
    dut.power_on(Boot::default());
    dut.run_until(100.millis());
    dut.texts();
    dut.write("W0343");
    dut.write("W0C5");
    dut.write("W02F00");
    dut.write("W010");
    dut.ask("S0E");
    dut.turn(4);
    dut.pin(DIO0, false);
    dut.hear(b"R0");
    dut.texts();
    let from = dut.out.levels.len();
    dut.run_until(1.secs());
    dut.texts();
    dut.input(Instant::from(1.secs()), Input::HostPresence { port: USB, here: true });
    assert_eq!(dut.levels(DIO3, from), [(Instant::from(1.secs()), Level::Float)]);
    dut.run_until(2.secs());
    assert_eq!(
        dut.texts(),
        [(Instant::from(1_050.millis()), "QSB-M  0E!".into())],
        "no stream, no half command"
    );
    assert_eq!(dut.ask("R0E"), "r 0E 00000000 !");
    assert_eq!(dut.ask("R03"), "r 03 0000004F !");
    assert_eq!(dut.ask("R0C"), "r 0C 0000FFFF !");
    assert_eq!(dut.ask("R01"), "r 01 0000000E !", "what is at the pins stays");
    let number = dut.get(Reg::TimeStamp);
    assert!((512..515).contains(&number), "{number}");
}

#[test]
fn leaving_the_port_changes_nothing() {
    let mut dut = Dut::ready(Qsb::s());
    dut.write("W0C5");
    dut.feed(Input::HostPresence { port: USB, here: false });
    assert_eq!(dut.ask("R0C"), "r 0C 00000005 !");
}

#[test]
fn edges_before_the_banner_are_not_counted() {
    for fast in [false, true] {
        let mut dut = Dut::off(Qsb::d());
        dut.fixture.power_on(Boot { fast, ..Boot::default() });
        for pin in [A, B] {
            let Fixture { drive, out, now } = &mut dut.fixture;
            drive.input(*now, Input::Edge { pin, high: false }, out);
        }
        dut.run_until(100.millis());
        assert_eq!(dut.ask("R0E"), "r 0E 00000000 !");
        // The bit U/D follows B until the counter counts.
        assert_eq!(dut.ask("R06"), "r 06 00000008 !");
    }
}

#[test]
fn a_new_rate_holds_behind_its_answer() {
    let mut dut = Dut::ready(Qsb::m());
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
        let answer = dut.ask(&std::format!("W16{rate}0A"));
        assert_eq!(answer, std::format!("w 16 00000{rate}0A !"));
        let (at, _, new) = *dut.out.lines.last().unwrap();
        assert_eq!(new.to_string(), line);
        assert_eq!(at, dut.sent().last().unwrap().0 + dut.character * 17);
        dut.character = new.character();
    }
    let lines = dut.out.lines.len();
    dut.write("W1660A");
    assert_eq!(dut.out.lines.len(), lines, "it has that rate");
}
