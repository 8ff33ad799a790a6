//! Lines on which characters are timed, and both directions work at the same time.

use drivetwin_firmware::qsb::Qsb;

use super::*;

/// Duration of a character of the test device's serial line, 115,200 8N1.
const CHARACTER: Duration = Duration::from_ticks(1_389);
/// Number of characters in the test device's answer to `r`.
const ANSWER: usize = 3;

fn toy(line: LineMode) -> (Bench, DriveId, Bus) {
    let mut bench = Bench::with(Settings { line, trace: Retention::All, ..Settings::default() });
    let toy = bench.add::<TestDevice>("toy");
    let bus = bench.bus(toy, test_device::USB).unwrap();
    (bench, toy, bus)
}

/// The volume, which is the second character of each answer.
fn volumes(answers: &[u8]) -> Vec<u8> {
    assert_eq!(answers.len() % ANSWER, 0, "{answers:?}");
    answers.chunks(ANSWER).map(|answer| answer[1]).collect()
}

#[test]
fn characters_have_the_same_stamps_however_they_come() {
    let script = |pieces: &[&[u8]]| {
        let (mut bench, _, bus) = toy(LineMode::Timed);
        let client = bench.connect(bus);
        for piece in pieces {
            bench.send(client, piece);
        }
        bench.run_until(1.secs());
        bench.trace().to_text()
    };
    let whole = script(&[b"1r0rr1"]);
    assert_eq!(script(&[b"1", b"r", b"0", b"r", b"r", b"1"]), whole);
    assert_eq!(script(&[b"1r0", b"rr1"]), whole);
    let ends = |n: u64| Instant::ZERO + CHARACTER * n;
    let (mut bench, _, bus) = toy(LineMode::Timed);
    let client = bench.connect(bus);
    bench.send(client, b"r0");
    bench.run_until(ends(2) - Duration::TICK);
    assert_eq!(bench.level(DriveId(0), test_device::OUT), Level::High);
    bench.run_until(ends(2));
    assert_eq!(bench.level(DriveId(0), test_device::OUT), Level::Low, "heard while it sends");
    // A client continues to send in the middle of an answer.
    bench.send(client, b"1");
    bench.run_until(ends(3));
    assert_eq!(bench.level(DriveId(0), test_device::OUT), Level::High);
    assert_eq!(received_by(&mut bench, client).len(), 2);
}

#[test]
fn manual_time_goes_to_the_end_of_all_answers() {
    let (mut bench, drive, bus) = toy(LineMode::Timed);
    let (client, other) = (bench.connect(bus), bench.connect(bus));
    bench.poke(drive, test_device::Reg::Volume as usize, 9).unwrap();
    bench.send(client, &[b'r'; 50]);
    bench.run_until_idle();
    let answers = received_by(&mut bench, client);
    assert_eq!(volumes(&answers), [9; 50]);
    assert_eq!(received_by(&mut bench, other), answers, "others hear it, too");
    // The line had the first character, then the answers without gaps.
    assert_eq!(bench.now(), Instant::ZERO + CHARACTER * (1 + 50 * ANSWER as u64));
    // Sends single characters, each after the answer to the one before.
    for _ in 0..3 {
        assert_eq!(volumes(&bench.ask(drive, b"r")), [9]);
    }
}

#[test]
fn a_stream_does_not_keep_manual_time_going() {
    let (mut bench, drive, bus) = toy(LineMode::Timed);
    let client = bench.connect(bus);
    bench.send(client, b"s");
    bench.run_until_idle();
    let (mut dots, mut answers) = (0, 0);
    for _ in 0..20 {
        let before = bench.now();
        bench.send(client, b"rr");
        bench.run_until_idle();
        assert!(bench.now() < before + 10.millis(), "the answers take 8 characters, 0.7 ms");
        let received = received_by(&mut bench, client);
        dots += received.iter().filter(|byte| **byte == b'.').count();
        answers += received.iter().filter(|byte| **byte == b'\n').count();
    }
    assert_eq!(answers, 2 * 20);
    let gone = bench.now().since(Instant::ZERO + CHARACTER).ticks() / test_device::INTERVAL.ticks();
    assert!(dots as u64 == gone || dots as u64 + 1 == gone, "{dots} dots in {gone} intervals");
    bench.ask(drive, b"s");
    bench.run_until(bench.now() + CHARACTER);
    received_by(&mut bench, client);
    bench.run_until(bench.now() + test_device::INTERVAL * 10);
    assert!(received_by(&mut bench, client).is_empty(), "it is over");
}

#[test]
fn who_floods_is_held_back_and_nothing_is_lost() {
    const COMMANDS: usize = 20_000;
    const SECOND: usize = 11_520;
    let (mut bench, _, bus) = toy(LineMode::Timed);
    let (client, other) = (bench.connect(bus), bench.connect(bus));
    bench.send(client, &[b'r'; COMMANDS]);
    let (mut answers, mut received, mut most) = (Vec::new(), Vec::new(), 0);
    while bench.next() < Instant::NEVER {
        bench.run_until(bench.next());
        bench.receive(client, &mut answers);
        bench.receive(other, &mut received);
        let given = COMMANDS - bench.backlog(client);
        most = most.max(given * ANSWER - answers.len());
    }
    // At most: the output queued within one second, the answer to the last character, and one to the
    // character that is being sent.
    assert!((SECOND..=SECOND + 2 * ANSWER + 1).contains(&most), "{most} characters ahead");
    assert_eq!(volumes(&answers), [0; COMMANDS]);
    assert_eq!(received, answers);
    assert_eq!(bench.now() - CHARACTER, Instant::ZERO + CHARACTER * (COMMANDS * ANSWER) as u64);
}

#[test]
fn a_flood_ends_in_manual_time_and_when_its_client_leaves() {
    let (mut bench, drive, bus) = toy(LineMode::Timed);
    let (client, other) = (bench.connect(bus), bench.connect(bus));
    bench.send(client, &[b'r'; 8_000]);
    bench.disconnect(client);
    bench.run_until_idle();
    assert_eq!(volumes(&received_by(&mut bench, other)), [0; 8_000]);
    assert_eq!(volumes(&bench.ask(drive, b"r")), [0]);
    // When power goes off, the pending output of the drive is dropped, and no client is deferred any longer.
    bench.send(other, &[b'r'; 8_000]);
    bench.run_until(bench.now() + 500.millis());
    let left = bench.backlog(other);
    bench.power(drive, PowerAction::Cycle);
    bench.run_until(bench.now() + 1.millis());
    let again = bench.now();
    received_by(&mut bench, other);
    bench.run_until_idle();
    let answers = received_by(&mut bench, other).len().div_euclid(ANSWER);
    assert!((left - 20..=left).contains(&answers), "{answers} answers, {left} characters were left");
    assert!(bench.now() < again + CHARACTER * (left * ANSWER) as u64);
}

#[test]
fn clients_take_turns_in_the_order_of_arrival() {
    let (mut bench, _, bus) = toy(LineMode::Timed);
    let (one, two) = (bench.connect(bus), bench.connect(bus));
    bench.send(one, b"11");
    bench.send(two, b"00");
    bench.send(one, b"11");
    bench.run_until_idle();
    let text = bench.trace().to_text();
    let said: Vec<&str> = text.lines().filter_map(|line| Some(line.split_once("> rx ")?.1)).collect();
    assert_eq!(said.concat().replace("\"\"", ""), "\"110011\"");
    // Before the line passes from one client to the other it is silent, until the end of the characters is
    // detected.
    let ends =
        |n: u64| CHARACTER * n + (Timing::of(bench.line(bus)).t3_5 + CHARACTER) * (n - 1).div_euclid(2);
    assert_eq!(stamps(&bench, "> rx").len(), said.len());
    assert_eq!(bench.now(), Instant::ZERO + ends(7) - CHARACTER);
}

#[test]
fn an_exchange_ends_with_its_answer() {
    let mut bench = Bench::new();
    let setup = Setup { boot_fast: true, ..Setup::default() };
    let qsb = bench.add_with("qsb", Box::new(Qsb::d()), setup).unwrap();
    let bus = bench.bus(qsb, Port(0)).unwrap();
    let (client, other) = (bench.connect(bus), bench.connect(bus));
    bench.run_until(10.millis());
    received_by(&mut bench, client);
    received_by(&mut bench, other);
    let begin = bench.now();
    bench.send(client, b"R0E\r");
    bench.run_until_idle();
    let answer = b"r 0E 00000000 !\r\n";
    assert_eq!(received_by(&mut bench, client), answer);
    // 4 and 17 characters of 10 bits at 230,400 baud take 0.911 ms.
    let character = bench.line(bus).character();
    assert_eq!(bench.now(), begin + character * 21);
    // The line is still kept for the client: it continues at once. Another client waits for the silence of
    // t3.5, and manual time includes this wait.
    bench.send(client, b"R0E\r");
    bench.run_until_idle();
    assert_eq!(bench.now(), begin + character * 42);
    received_by(&mut bench, other);
    bench.send(other, b"R0E\r");
    bench.run_until_idle();
    assert_eq!(received_by(&mut bench, other), answer);
    let quiet = Timing::of(bench.line(bus)).t3_5 + character;
    assert_eq!(bench.now(), begin + character * (21 + 4) + quiet + character * 21);
}

#[test]
fn fast_takes_no_time_but_that_of_the_drive() {
    let (mut bench, drive, bus) = toy(LineMode::Fast);
    let client = bench.connect(bus);
    bench.send(client, &[b'r'; 1_000]);
    bench.run_until_idle();
    assert_eq!(volumes(&received_by(&mut bench, client)), [0; 1_000]);
    assert_eq!(volumes(&bench.ask(drive, b"rr")), [0; 2]);
    received_by(&mut bench, client);
    assert!(bench.now() <= Instant::ZERO + Duration::TICK);
    bench.send(client, b"s");
    bench.run_until_idle();
    bench.run_until(31.millis());
    assert_eq!(received_by(&mut bench, client), [b'.'; 10]);
}

#[test]
fn fast_takes_no_time_where_a_drive_puts_its_answers_ahead() {
    const COMMANDS: usize = 10_000;
    for manual in [false, true] {
        let mut bench = Bench::with(Settings { line: LineMode::Fast, ..Settings::default() });
        let setup = Setup { boot_fast: true, ..Setup::default() };
        let qsb = bench.add_with("qsb", Box::new(Qsb::d()), setup).unwrap();
        bench.run_until(1.millis());
        let client = bench.connect(bench.bus(qsb, Port(0)).unwrap());
        let now = bench.now();
        bench.send(client, "R0E\r".repeat(COMMANDS).as_bytes());
        if manual {
            bench.run_until_idle();
        } else {
            bench.run_until(now);
        }
        assert_eq!(bench.now(), now);
        assert_eq!(bench.backlog(client), 0);
        let answers = received_by(&mut bench, client);
        assert!(answers == "r 0E 00000000 !\r\n".repeat(COMMANDS).as_bytes(), "{} characters", answers.len());
        // The new settings apply after the answers, which have left already.
        bench.send(client, b"W1610A\r");
        bench.run_until(now);
        assert_eq!(bench.bus(qsb, Port(0)).map(|bus| bench.line(bus).baud), Some(19_200));
    }
}

#[test]
fn fast_lets_a_polled_drive_stream() {
    let mut bench = Bench::with(Settings { line: LineMode::Fast, ..Settings::default() });
    let setup = Setup { boot_fast: true, ..Setup::default() };
    let qsb = bench.add_with("qsb", Box::new(Qsb::d()), setup).unwrap();
    let client = bench.connect(bench.bus(qsb, Port(0)).unwrap());
    // A record every 5/512 s, even if the count has not changed.
    bench.send(client, b"W0B0\rW0C5\rS0E\r");
    bench.run_until_idle();
    received_by(&mut bench, client);
    let begin = bench.now();
    // This number is more than 230,400 baud can transmit in a second.
    for n in 1..=20_000 {
        bench.run_until(begin + 50.micros() * n);
        bench.send(client, b"R0B\r");
    }
    bench.run_until_idle();
    let received = received_by(&mut bench, client);
    let count =
        |start: &[u8]| received.split(|byte| *byte == b'\n').filter(|line| line.starts_with(start)).count();
    assert_eq!((count(b"s 0E"), count(b"r 0B")), (102, 20_000));
    let make = |_: &str| Some(Box::new(Qsb::d()) as Box<dyn Device>);
    let text = bench.trace().to_text();
    assert!(text.contains("\ndrive qsb qsb-d fast untimed\n"), "{}", &text[..200]);
    assert_eq!(replay::run(&Trace::parse(&text, &make).unwrap(), &make), Ok(None));
}

#[test]
fn fast_leaves_a_stream_its_pace() {
    let mut bench = Bench::with(Settings { line: LineMode::Fast, ..Settings::default() });
    let setup = Setup { boot_fast: true, ..Setup::default() };
    let qsb = bench.add_with("qsb", Box::new(Qsb::d()), setup).unwrap();
    let client = bench.connect(bench.bus(qsb, Port(0)).unwrap());
    // A record in every tick of 512 Hz, even if the count has not changed.
    bench.send(client, b"W0B0\rW0C1\rS0E\r");
    bench.run_until_idle();
    received_by(&mut bench, client);
    bench.run_until(bench.now() + 1.secs());
    let received = received_by(&mut bench, client);
    assert_eq!(received.split(|byte| *byte == b'\n').filter(|line| line.starts_with(b"s 0E")).count(), 512);
    let make = |_: &str| Some(Box::new(Qsb::d()) as Box<dyn Device>);
    let trace = Trace::parse(&bench.trace().to_text(), &make).unwrap();
    assert_eq!(replay::run(&trace, &make), Ok(None));
}
