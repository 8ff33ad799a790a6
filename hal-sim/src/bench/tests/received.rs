//! Journals of received messages.

use drivetwin_firmware::device::{
    Boot, Context, Device, Duration, Effect, Framing, Input, Instant, LogEvent, Output, Port, PortSpec,
    PresetError, Reason, ReasonSpec, Spec,
};
use drivetwin_firmware::md3::Md3;
use drivetwin_firmware::mdrive::Mdrive;
use drivetwin_firmware::mdrobot::Mdrobot;
use drivetwin_firmware::qsb::Qsb;
use drivetwin_firmware::rs434::Rs434;
use drivetwin_protocol::modbus::{rtu, tcp};

use crate::bench::{Accesses, Bench, DriveId, PinStimulus, PowerAction, Settings, Setup};
use crate::decode::Verdict;
use crate::line::LineMode;

/// All messages of a drive, a line of words each.
fn words(bench: &Bench, drive: DriveId) -> Vec<String> {
    bench.received(drive).messages().map(|message| message.to_string()).collect()
}

fn ready(bench: &mut Bench) {
    bench.run_until(bench.now() + Duration::secs(3));
}

fn say(bench: &mut Bench, drive: DriveId, port: u8, text: &[u8]) -> Vec<u8> {
    let client = bench.connect_to(drive, Port(port)).unwrap();
    bench.send(client, text);
    bench.run_until(bench.now() + Duration::millis(100));
    let mut answer = Vec::new();
    bench.receive(client, &mut answer);
    bench.disconnect(client);
    answer
}

#[test]
fn an_md3_says_what_it_received_and_what_came_of_it() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let mut bench = Bench::with(Settings { line, ..Settings::default() });
        let md3 = bench.add::<Md3>("x");
        bench.run_until(Instant::from(Duration::millis(1_300)));
        bench.ask(md3, &rtu::write(1, 0x11, 1));
        ready(&mut bench);
        let speed = rtu::write(1, 0x15, 9_000);
        for frame in [&speed[..], &rtu::read(1, 0x14, 2), &rtu::write(1, 0x0B, 5), &rtu::read(3, 0, 1)] {
            bench.ask(md3, frame);
        }
        let mut corrupt = rtu::read(1, 0, 1);
        corrupt[7] ^= 1;
        bench.ask(md3, &corrupt);
        bench.ask(md3, &rtu::write(0, 0x11, 1));
        bench.power(md3, PowerAction::Off);
        bench.run_until(bench.now() + Duration::TICK * 2);
        bench.ask(md3, &rtu::read(1, 0, 1));
        let mut words = words(&bench, md3);
        // With timed characters the request ends 9 ms after it is sent.
        assert!(
            words[0].starts_with("rs485 <- write MotionControl = 1 -> starting for 1.2 s more"),
            "{words:#?}"
        );
        assert_eq!(
            words.split_off(1),
            [
                "rs485 <- write SpeedLow = 9000 -> done",
                "rs485 <- read Speed -> Speed = 9000",
                "rs485 <- write Reserved = 5 -> refused: 0x000B Reserved is read only (02)",
                "rs485 <- read DeviceAddress -> for address 3, nobody here (the drive has 1)",
                "rs485 <- 8 bytes 01 03 00 00 00 01 84 0B -> CRC wrong: 84 0B instead of 84 0A",
                "rs485 <- to all: write MotionControl = 1 -> done",
                "rs485 <- read DeviceAddress -> no power",
            ]
        );
        let received = bench.received(md3);
        let verdicts: Vec<Verdict> = received.messages().map(|message| message.exchange.verdict).collect();
        assert_eq!(
            verdicts,
            [
                Verdict::NotListening,
                Verdict::Done,
                Verdict::Done,
                Verdict::Refused,
                Verdict::NotForIt,
                Verdict::BadFrame,
                Verdict::Done,
                Verdict::NotListening
            ]
        );
        let second = received.messages().nth(1).unwrap();
        assert_eq!((second.bytes, second.answer), (speed.to_vec(), speed.to_vec()));
        assert_eq!(received.written(), ["SpeedLow", "MotionControl"]);
        assert_eq!(received.clone().since(Duration::secs(4)).messages().count(), 7);
        assert_eq!(received.clone().of_function(3).messages().count(), 3);
        let spec = bench.spec(md3);
        for (name, count) in
            [("Speed", 2), ("SpeedLow", 2), ("SpeedHigh", 1), ("Reserved", 1), ("HomeOffset", 0)]
        {
            let register = spec.find(name).unwrap();
            assert_eq!(received.clone().of_register(register).messages().count(), count, "{name}");
        }
    }
}

#[test]
fn a_message_ends_with_its_last_character() {
    let mut bench = Bench::new();
    let md3 = bench.add::<Md3>("x");
    ready(&mut bench);
    let start = bench.now();
    bench.ask(md3, &rtu::read(1, 0, 1));
    let message = bench.received(md3).messages().next().unwrap();
    // The message has 8 characters of 18,333 ticks.
    assert_eq!(message.at, start + Duration::from_ticks(8 * 18_333));
}

#[test]
fn frames_that_follow_each_other_at_the_shortest_gap_stay_apart() {
    let mut bench = Bench::new();
    let md3 = bench.add::<Md3>("x");
    ready(&mut bench);
    let client = bench.connect_to(md3, Port(0)).unwrap();
    // A broadcast has no answer, so the next frame follows after 3.5 characters.
    let burst = [&rtu::write(0, 0x1D, 7)[..], &rtu::write(0, 0x1D, 8), &rtu::read(1, 0x1D, 1)].concat();
    bench.send(client, &burst);
    bench.run_until(bench.now() + Duration::secs(1));
    let early = "sent in one write with the request before it; t3.5 is 4.0 ms";
    assert_eq!(
        words(&bench, md3),
        [
            "rs485 <- to all: write UserRegister = 7 -> done".to_owned(),
            format!("rs485 <- to all: write UserRegister = 8 -> done; {early}"),
            format!("rs485 <- read UserRegister -> UserRegister = 8; {early}"),
        ]
    );
}

#[test]
fn a_shared_line_keeps_what_is_for_no_drive() {
    let mut bench = Bench::new();
    let address = |address| Setup { presets: vec![(0, address)], ..Setup::default() };
    let drives: Vec<DriveId> = [("a", 1), ("b", 2), ("c", 5)]
        .map(|(name, n)| bench.add_with(name, Box::new(Md3::new()), address(n)).unwrap())
        .into();
    let bus = bench.share("line", &drives.iter().map(|&drive| (drive, Port(0))).collect::<Vec<_>>());
    ready(&mut bench);
    let client = bench.connect(bus);
    let mut corrupt = rtu::read(2, 0, 1);
    corrupt[7] ^= 1;
    for frame in [&rtu::read(2, 0, 1)[..], &rtu::read(3, 0, 1), &corrupt, &rtu::write(0, 0x1D, 7)] {
        bench.send(client, frame);
        bench.run_until(bench.now() + Duration::millis(50));
    }
    bench.power(drives[2], PowerAction::Off);
    bench.run_until(bench.now() + Duration::TICK * 2);
    for frame in [rtu::read(5, 0, 1), rtu::read(1, 0, 1)] {
        bench.send(client, &frame);
        bench.run_until(bench.now() + Duration::millis(50));
    }
    let nobody = "rs485 <- read DeviceAddress -> for address 3, nobody here (the drives have 1, 2, 5)";
    let corrupt = corrupt.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ");
    let of_line = |words: &str| words == nobody || words.contains(&corrupt);
    let all = "rs485 <- to all: write UserRegister = 7 -> done";
    let own = |drive: usize| {
        let words = words(&bench, drives[drive]);
        assert_eq!(words.iter().filter(|words| of_line(words)).count(), 2, "{words:#?}");
        words.into_iter().filter(|words| !of_line(words)).collect::<Vec<_>>()
    };
    assert_eq!(own(0), [all, "rs485 <- read DeviceAddress -> DeviceAddress = 1"]);
    assert_eq!(own(1), ["rs485 <- read DeviceAddress -> DeviceAddress = 2", all]);
    assert_eq!(own(2), [all, "rs485 <- read DeviceAddress -> no power"]);
    // Each frame is there once, in the order of the outcomes.
    let news = bench.received_after(0, 100);
    assert_eq!((news.messages().count(), news.lost(), news.last()), (8, 0, 8));
    assert!(news.messages().map(|(_, message)| message.number).eq(1..=8));
    let rest = bench.received_after(5, 2);
    assert_eq!((rest.messages().count(), rest.lost(), rest.last()), (2, 0, 7));
    assert_eq!(bench.received_after(8, 100).messages().count(), 0);
    let lines: Vec<String> =
        news.messages().map(|(receiver, message)| bench.received_line(receiver, &message)).collect();
    assert_eq!(lines[0], "b.rs485 <- read DeviceAddress -> DeviceAddress = 2");
    assert_eq!(lines[1], nobody.replacen("rs485", "line", 1));
}

#[test]
fn two_drives_of_one_address_both_have_the_request() {
    let mut bench = Bench::new();
    let drives = ["a", "b"].map(|name| bench.add::<Md3>(name));
    let bus = bench.share("line", &drives.map(|drive| (drive, Port(0))));
    ready(&mut bench);
    let client = bench.connect(bus);
    bench.send(client, &rtu::read(1, 0, 1));
    bench.run_until_idle();
    for drive in drives {
        assert_eq!(words(&bench, drive)[0], "rs485 <- read DeviceAddress -> DeviceAddress = 1");
    }
}

#[test]
fn an_rs_drive_in_both_framings() {
    let mut bench = Bench::new();
    let rtu_drive = bench.add_with("r", Box::new(Rs434::rs434544()), Setup::default()).unwrap();
    let spec = bench.spec(rtu_drive);
    // TYPE_MODBUS 1 is ASCII 7E1.
    let ascii = spec.find("TYPE_MODBUS").unwrap().row;
    let setup = Setup { presets: vec![(ascii, 1)], ..Setup::default() };
    let ascii_drive = bench.add_with("a", Box::new(Rs434::rs434544()), setup).unwrap();
    ready(&mut bench);
    bench.ask(rtu_drive, &rtu::write(1, 0x500B, 29));
    assert_eq!(
        words(&bench, rtu_drive),
        ["rs485 <- write SPEED = 29 -> refused: 0x500B SPEED = 29 is not allowed, it takes 30 to 15000 (03)"]
    );
    // LRC: 01 + 03 + 50 + 00 + 00 + 01 = 55h, and 55h + ABh = 100h.
    bench.ask(ascii_drive, b":010350000001AB\r\n");
    bench.ask(ascii_drive, b":010350000001AA\r\n");
    let received = bench.received(ascii_drive);
    let messages: Vec<_> = received.messages().collect();
    assert_eq!(messages[0].to_string(), "rs485 <- read SLAVE_ADDRESS_MODBUS -> SLAVE_ADDRESS_MODBUS = 1");
    assert_eq!(messages[0].bytes, b":010350000001AB\r\n");
    assert!(messages[1].to_string().ends_with("-> LRC wrong"), "{}", messages[1]);
}

#[test]
fn an_mdrobot_counts_in_decimal() {
    let mut bench = Bench::new();
    let drive = bench.add_with("m", Box::new(Mdrobot::md400()), Setup::default()).unwrap();
    ready(&mut bench);
    bench.ask(drive, &rtu::write(1, 254, 5));
    let words = words(&bench, drive);
    assert!(words[0].contains("there is no register at 254"), "{words:#?}");
}

#[test]
fn a_qsb_has_a_line_an_entry() {
    let mut bench = Bench::new();
    let drive = bench.add_with("q", Box::new(Qsb::d()), Setup::default()).unwrap();
    bench.ask(drive, b"R0E\r\n");
    ready(&mut bench);
    for line in [&b"R0E\r\n"[..], b"X\x08R14\r\n", b"W141\r\n"] {
        bench.ask(drive, line);
    }
    let words = words(&bench, drive);
    assert_eq!(
        words,
        [
            "usb <- read ReadEncoder -> starting for 50 ms more",
            "usb <- read ReadEncoder -> ReadEncoder = 0",
            "usb <- read Version -> Version = 4110",
            "usb <- write Version = 1 -> refused: 14 Version is read only (x)",
        ]
    );
}

#[test]
fn an_mdrive_on_both_ports() {
    let mut bench = Bench::new();
    let drive = bench.add_with("d", Box::new(Mdrive::plus()), Setup::default()).unwrap();
    ready(&mut bench);
    let mcode = bench.spec(drive).ports.iter().position(|port| port.name == "mcode").unwrap() as u8;
    let modbus = 1 - mcode;
    let header = tcp::Header { transaction: 7, unit: 255 };
    say(&mut bench, drive, modbus, &tcp::frame(header, &[3, 0, 0x57, 0, 2]));
    say(&mut bench, drive, mcode, b"VM 1000\r\nPR VM\r\nVM 9999999\r\n");
    assert_eq!(
        words(&bench, drive),
        [
            "modbus <- read P -> P = 0",
            "mcode <- VM 1000 -> refused: VM is set less than or equal to VI (error 23)",
            "mcode <- PR VM -> 768000",
            "mcode <- VM 9999999 -> refused: tried to set an incorrect value (error 21)",
        ]
    );
}

#[test]
fn two_connections_of_mcode_do_not_mix() {
    let mut bench = Bench::new();
    let drive = bench.add_with("d", Box::new(Mdrive::plus()), Setup::default()).unwrap();
    ready(&mut bench);
    let mcode = bench.spec(drive).ports.iter().position(|port| port.name == "mcode").unwrap() as u8;
    let [a, b] = [(); 2].map(|()| bench.connect_to(drive, Port(mcode)).unwrap());
    for (client, text) in [(a, &b"PR "[..]), (b, b"PR V"), (a, b"P\r\n"), (b, b"M\r\n")] {
        bench.send(client, text);
        bench.run_until_idle();
    }
    assert_eq!(words(&bench, drive), ["mcode <- PR P -> 0", "mcode <- PR VM -> 768000"]);
}

/// A device on Modbus/TCP that accepts every request. For function 6 the bits of the register's address select reasons:
/// bit 0 the first one, bit 1 the second one, bit 2 the third one.
#[derive(Default)]
struct Reasoned;

static REASONED: Spec = Spec {
    ports: &[PortSpec { name: "modbus", framing: Framing::Mbap, line: None }],
    reasons: &[
        ReasonSpec { effect: Effect::Nothing, text: "UI_COM is 0, the inputs command", section: "p. 1" },
        ReasonSpec { effect: Effect::Later, text: "after a save and a restart", section: "p. 2" },
        ReasonSpec { effect: Effect::Other, text: "the speed is limited to 40000", section: "p. 3" },
    ],
    ..Spec::EMPTY
};

impl Device for Reasoned {
    fn spec(&self) -> &'static Spec {
        &REASONED
    }

    fn power_on(&mut self, at: Instant, _boot: Boot, out: &mut dyn Context) {
        // A reason without a request.
        out.put(at, Output::Log(LogEvent::Reason(Reason(0))));
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        let Input::Message { port, link, bytes } = input else { return };
        for code in 0..3 {
            if bytes[9] >> code & 1 != 0 {
                // A drive may put a reason several times.
                out.put(at, Output::Log(LogEvent::Reason(Reason(code))));
                out.put(at, Output::Log(LogEvent::Reason(Reason(code))));
            }
        }
        out.put(at, Output::Log(LogEvent::Request { port, unit: 1, function: bytes[7] }));
        out.put(at, Output::Message { port, link, bytes });
    }

    fn deadline(&self) -> Instant {
        Instant::NEVER
    }

    fn timeout(&mut self, _at: Instant, _out: &mut dyn Context) {}

    fn peek(&self, _at: Instant, _row: usize) -> i64 {
        0
    }

    fn poke(&mut self, _: Instant, _: usize, _: i64, _: &mut dyn Context) -> Result<(), PresetError> {
        Err(PresetError::NoSuchRegister)
    }
}

#[test]
fn reasons_limit_what_an_accepted_request_does() {
    let mut bench = Bench::new();
    let drive = bench.add::<Reasoned>("r");
    let header = tcp::Header { transaction: 7, unit: 1 };
    for reasons in 0..5 {
        say(&mut bench, drive, 0, &tcp::frame(header, &[6, 0, reasons, 0, 9]));
    }
    say(&mut bench, drive, 0, &tcp::frame(header, &[6, 0, 6, 0, 9]));
    assert_eq!(
        words(&bench, drive),
        [
            "modbus <- write 0x0000 = 9 -> done",
            "modbus <- write 0x0001 = 9 -> accepted, without effect: UI_COM is 0, the inputs command",
            "modbus <- write 0x0002 = 9 -> accepted, with effect later: after a save and a restart",
            "modbus <- write 0x0003 = 9 -> accepted, without effect: UI_COM is 0, the inputs command",
            "modbus <- write 0x0004 = 9 -> accepted, with another effect: the speed is limited to 40000",
            "modbus <- write 0x0006 = 9 -> accepted, with effect later: after a save and a restart; with another \
             effect: the speed is limited to 40000",
        ]
    );
    let received = bench.received(drive);
    let verdicts: Vec<Verdict> = received.messages().map(|message| message.exchange.verdict).collect();
    assert_eq!(verdicts[..3], [Verdict::Done, Verdict::WithoutEffect, Verdict::Done]);
}

#[test]
fn requests_to_a_drive_that_starts_are_counted() {
    let mut bench = Bench::new();
    let address = |address| Setup { presets: vec![(0, address)], ..Setup::default() };
    let [x, y] =
        [("x", 1), ("y", 2)].map(|(name, n)| bench.add_with(name, Box::new(Md3::new()), address(n)).unwrap());
    bench.share("line", &[(x, Port(0)), (y, Port(0))]);
    bench.run_until(Instant::from(Duration::millis(1_300)));
    bench.ask(x, &rtu::read(1, 0, 1));
    // Sends a frame for all drives, and one for an address that no drive has.
    bench.ask(x, &rtu::write(0, 0x1D, 7));
    bench.ask(x, &rtu::read(9, 0, 1));
    let starting = bench.starting_requests(x);
    assert_eq!((starting.count, bench.starting_requests(y).count, bench.starting_count()), (1, 0, 1));
    // The time left is 2.5 s, minus 1.3 s, minus 8 characters of 11 bits at 9,600 baud.
    let left = starting.left.unwrap();
    assert!((Duration::millis(1_190)..Duration::millis(1_200)).contains(&left), "{left:?}");
    ready(&mut bench);
    bench.ask(x, &rtu::read(1, 0, 1));
    assert_eq!(bench.starting_count(), 1);

    let qsb = bench.add_with("q", Box::new(Qsb::d()), Setup::default()).unwrap();
    bench.ask(qsb, b"R0E\r\n");
    assert_eq!((bench.starting_requests(qsb).count, bench.starting_count()), (1, 2));
}

#[test]
fn a_write_before_another_one() {
    let mut bench = Bench::new();
    let x = bench.add::<Md3>("x");
    let spec = bench.spec(x);
    let before = |bench: &Bench, first: &str, then: &str| {
        bench.received(x).wrote_before(spec.find(first).unwrap(), spec.find(then).unwrap())
    };
    // Lost during the start.
    bench.ask(x, &rtu::write(1, 0x15, 9_000));
    ready(&mut bench);
    bench.ask(x, &rtu::write(1, 0x11, 1));
    assert!(!before(&bench, "Speed", "MotionControl"));
    bench.ask(x, &rtu::write(1, 0x15, 9_000));
    bench.ask(x, &rtu::write(1, 0x11, 1));
    assert!(!before(&bench, "Speed", "MotionControl"), "the first Move came before");
    assert!(before(&bench, "MotionControl", "Speed"));
    assert!(before(&bench, "MotionControl", "SpeedLow"));
    assert!(!before(&bench, "MotionControl", "SpeedHigh"), "never written");
    let counts = bench.received(x).counts();
    assert_eq!(counts.functions.into_iter().collect::<Vec<_>>(), [(6, 4)]);
    assert_eq!(counts.registers["SpeedLow"], Accesses { read: 0, written: 2 });
}

#[test]
fn a_bench_without_journals_keeps_nothing() {
    let mut bench = Bench::with(Settings { journals: false, ..Settings::default() });
    let x = bench.add::<Md3>("x");
    let bus = bench.bus(x, Port(0)).unwrap();
    ready(&mut bench);
    let (client, read) = (bench.connect(bus), rtu::read(1, 0, 1));
    bench.set_strict(bus, true);
    bench.send(client, &[&read[..], &read].concat());
    bench.run_until_idle();
    assert_eq!(bench.early_requests(bus).count, 1);
    assert_eq!(bench.ask(x, &read).len(), 7);
    assert_eq!((bench.received(x).messages().count(), bench.received_count()), (0, 0));
}

/// Lines of a drive on a shared line and on its own, in the same words.
#[test]
fn faults_of_a_line_are_in_the_journal() {
    use crate::line::faults::{Direction, FaultRule, LineFaults};
    let quiet = LineFaults::NONE;
    let reply = FaultRule::next(1).direction(Direction::Reply);
    let request = FaultRule::next(1).direction(Direction::Request);
    let speed = rtu::write(2, 0x15, 9_000);
    for (faults, expected) in [
        (
            LineFaults { drop: request, ..quiet },
            "write SpeedLow = 9000 -> lost; by a fault, the request was dropped",
        ),
        (
            LineFaults { drop: reply, ..quiet },
            "write SpeedLow = 9000 -> done; by a fault, the reply was dropped",
        ),
        (
            LineFaults { mute: FaultRule::ALL, ..quiet },
            "write SpeedLow = 9000 -> done; by a fault, the reply was not delivered",
        ),
        (
            LineFaults { corrupt: reply, truncate: reply, delay: Duration::millis(2), ..quiet },
            "write SpeedLow = 9000 -> done; by a fault, the reply was truncated and was corrupted and was delayed",
        ),
        (
            LineFaults { wrong_address: FaultRule::next(1), ..quiet },
            "write SpeedLow = 9000 -> done; by a fault, the reply had a wrong address",
        ),
        (
            LineFaults { exception: FaultRule::next(1), exception_code: 6, ..quiet },
            "write SpeedLow = 9000 -> refused: by a fault (06)",
        ),
    ] {
        for shared in [false, true] {
            let mut bench = Bench::new();
            let row = Md3::default().spec().find("DeviceAddress").unwrap().row;
            let x = bench.add_with(
                "x",
                Box::new(Md3::default()),
                Setup { presets: vec![(row, 2)], ..Setup::default() },
            );
            let (x, y) = (x.unwrap(), bench.add::<Md3>("y"));
            let mut bus = bench.bus(x, Port(0)).unwrap();
            if shared {
                bus = bench.share("line1", &[(x, Port(0)), (y, Port(0))]);
            }
            ready(&mut bench);
            bench.set_line_faults(bus, faults);
            bench.ask(x, &speed);
            assert_eq!(words(&bench, x), [format!("rs485 <- {expected}")], "{shared}");
            assert_eq!(words(&bench, y), [""; 0], "{shared}");
            ready(&mut bench);
            bench.set_line_faults(bus, quiet);
            bench.ask(x, &speed);
            assert_eq!(words(&bench, x)[1..], ["rs485 <- write SpeedLow = 9000 -> done"]);
        }
    }
}

/// A lost request for no drive of a shared line, and noise, are in the journal of the line.
#[test]
fn lost_broadcasts_and_noise_are_in_the_journal_of_the_line() {
    use crate::line::faults::{Direction, FaultRule, LineFaults};
    let mut bench = Bench::new();
    let (x, y) = (bench.add::<Md3>("x"), bench.add::<Md3>("y"));
    let bus = bench.share("line1", &[(x, Port(0)), (y, Port(0))]);
    ready(&mut bench);
    let request = FaultRule::next(1).direction(Direction::Request);
    bench.set_line_faults(bus, LineFaults { drop: request, ..LineFaults::NONE });
    bench.ask(x, &rtu::write(0, 0x15, 9_000));
    let lost = "rs485 <- to all: write SpeedLow = 9000 -> lost; by a fault, the request was dropped";
    assert_eq!((words(&bench, x), words(&bench, y)), (vec![lost.to_owned()], vec![lost.to_owned()]));
    bench.set_line_faults(bus, LineFaults { noise: request, ..LineFaults::NONE });
    bench.ask(x, &rtu::write(7, 0x15, 9_000));
    let words = words(&bench, x);
    assert!(words[1].ends_with("; by a fault, the request had noise beside it"), "{words:#?}");
    assert!(words[2].ends_with("; by a fault, the request was noise"), "{words:#?}");
}

/// The MDrive and its MCode port, ready.
fn mcode(bench: &mut Bench) -> (DriveId, u8) {
    let drive = bench.add_with("d", Box::new(Mdrive::plus()), Setup::default()).unwrap();
    ready(bench);
    let port = bench.spec(drive).ports.iter().position(|port| port.name == "mcode").unwrap();
    (drive, port as u8)
}

#[test]
fn keys_of_mcode_have_an_entry() {
    let mut bench = Bench::new();
    let (drive, port) = mcode(&mut bench);
    say(&mut bench, drive, port, b"SL 1000\r\x1b");
    say(&mut bench, drive, port, b"MR 5\x1bPR P\x08V\x7fVM\r\n");
    say(&mut bench, drive, port, b"\x05");
    say(&mut bench, drive, port, b"CE 0\r\x03CE 1\r\x03");
    let off = "accepted, without effect: this key is off: CE turns on Ctrl-C, ES selects Esc or Ctrl-E";
    assert_eq!(
        words(&bench, drive),
        [
            "mcode <- SL 1000 -> done".to_owned(),
            "mcode <- Esc -> done".to_owned(),
            "mcode <- Esc after MR 5 -> done".to_owned(),
            "mcode <- PR VM -> 768000".to_owned(),
            format!("mcode <- Ctrl-E -> {off}"),
            "mcode <- CE 0 -> done".to_owned(),
            format!("mcode <- Ctrl-C -> {off}"),
            "mcode <- CE 1 -> done".to_owned(),
            "mcode <- Ctrl-C -> done".to_owned(),
        ]
    );
}

#[test]
fn control_characters_in_a_line_of_a_qsb_have_an_entry() {
    let mut bench = Bench::new();
    let drive = bench.add_with("q", Box::new(Qsb::d()), Setup::default()).unwrap();
    ready(&mut bench);
    for line in [&b"R0E\x1b\r"[..], b"\x00R14\r", b"\x03\r", b"W0\x08R14\r"] {
        bench.ask(drive, line);
    }
    assert_eq!(
        words(&bench, drive),
        [
            "usb <- R0E\\x1b -> refused: this is no command (x)",
            "usb <- \\x00R14 -> refused: this is no command (x)",
            "usb <- \\x03 -> refused: this is no command (x)",
            "usb <- read Version -> Version = 4110",
        ]
    );
}

#[test]
fn bytes_that_are_not_modbus_tcp_have_an_entry() {
    let mut bench = Bench::new();
    let (drive, mcode) = mcode(&mut bench);
    let modbus = 1 - mcode;
    let request = tcp::frame(tcp::Header { transaction: 7, unit: 255 }, &[3, 0, 0x57, 0, 2]);
    let mut other = request.clone();
    other[3] = 7;
    say(&mut bench, drive, modbus, &[&request[..], &request, &other].concat());
    let client = bench.connect_to(drive, Port(modbus)).unwrap();
    for part in [&other[..2], &other[2..]] {
        bench.send(client, part);
        bench.run_until_idle();
    }
    say(&mut bench, drive, modbus, &[0, 1, 0, 0, 1, 0, 1, 3]);
    let protocol = "modbus <- 12 bytes 00 07 00 07 00 06 FF 03 00 57 00 02 -> the protocol identifier in the \
        header is 7, not 0; the connection is closed";
    let length = "modbus <- 8 bytes 00 01 00 00 01 00 01 03 -> the length in the header is 256, not from 2 to 254; \
        the connection is closed";
    let read = "modbus <- read P -> P = 0";
    assert_eq!(words(&bench, drive), [read, read, protocol, protocol, length]);
    let verdicts = bench.received(drive).messages().map(|message| message.exchange.verdict).next_back();
    assert_eq!(verdicts, Some(Verdict::BadFrame));
}

#[test]
fn what_is_no_message_in_ascii_has_an_entry() {
    // LRC: 01 + 03 + 50 + 00 + 00 + 01 = 55h, and 55h + ABh = 100h.
    let read = &b":010350000001AB\r\n"[..];
    for shared in [false, true] {
        let mut bench = Bench::new();
        let spec = Rs434::rs434544().spec();
        let row = |name| spec.find(name).unwrap().row;
        let setup = |address| Setup {
            presets: vec![(row("TYPE_MODBUS"), 1), (row("SLAVE_ADDRESS_MODBUS"), address)],
            ..Setup::default()
        };
        let a = bench.add_with("a", Box::new(Rs434::rs434544()), setup(1)).unwrap();
        let b = bench.add_with("b", Box::new(Rs434::rs434544()), setup(2)).unwrap();
        if shared {
            bench.share("line1", &[(a, Port(0)), (b, Port(0))]);
        }
        ready(&mut bench);
        bench.ask(a, &read[1..]);
        bench.ask(a, &[b"xyz", read].concat());
        bench.ask(a, &[b":0103", read].concat());
        let no_colon = "a message in Modbus ASCII begins with a colon";
        let done = "rs485 <- read SLAVE_ADDRESS_MODBUS -> SLAVE_ADDRESS_MODBUS = 1".to_owned();
        assert_eq!(
            words(&bench, a),
            [
                format!("rs485 <- 16 bytes 30 31 30 33 35 30 30 30 30 30 30 31 41 42 0D 0A -> {no_colon}"),
                format!("rs485 <- 3 bytes 78 79 7A -> {no_colon}"),
                done.clone(),
                "rs485 <- 5 bytes 3A 30 31 30 33 -> a colon begins the next message before the end of this one"
                    .to_owned(),
                done,
            ],
            "{shared}"
        );
    }
}

#[test]
fn requests_in_one_write_have_an_entry_each() {
    let mut bench = Bench::new();
    let (drive, mcode) = mcode(&mut bench);
    let request = tcp::frame(tcp::Header { transaction: 7, unit: 255 }, &[3, 0, 0x57, 0, 2]);
    for leaves in [false, true] {
        let client = bench.connect_to(drive, Port(1 - mcode)).unwrap();
        bench.send(client, &request.repeat(40));
        if !leaves {
            bench.run_until_idle();
        }
        bench.disconnect(client);
        bench.run_until_idle();
    }
    assert_eq!(words(&bench, drive).len(), 80);
    let md3 = bench.add::<Md3>("x");
    ready(&mut bench);
    let client = bench.connect_to(md3, Port(0)).unwrap();
    bench.send(client, &rtu::read(1, 0, 1).repeat(5));
    bench.run_until_idle();
    assert_eq!(words(&bench, md3).len(), 5);
    let qsb = bench.add_with("q", Box::new(Qsb::d()), Setup::default()).unwrap();
    ready(&mut bench);
    let client = bench.connect_to(qsb, Port(0)).unwrap();
    bench.send(client, &b"R0E\r".repeat(5));
    bench.run_until_idle();
    assert_eq!(words(&bench, qsb).len(), 5);
}
/// Each request that a fault changed has an entry that says so, also if its drive takes none from what arrives.
#[test]
fn each_request_with_a_fault_has_an_entry() {
    use crate::line::faults::{Direction, FaultRule, LineFaults};
    let request = FaultRule::next(1).direction(Direction::Request);
    let header = tcp::Header { transaction: 7, unit: 255 };
    let ascii = [("TYPE_MODBUS", 1), ("BITRATE_MODBUS", 4)];
    for (kind, port, presets, bytes) in [
        ("md3", "rs485", &[][..], rtu::write(1, 0x15, 9_000).to_vec()),
        ("rs434544", "rs485", &ascii, drivetwin_protocol::modbus::ascii::frame(1, &[3, 0, 1, 0, 1]).to_vec()),
        ("qsb-d", "usb", &[], b"R0E\r".to_vec()),
        ("mdrive", "modbus", &[], tcp::frame(header, &[3, 0, 0x57, 0, 2]).to_vec()),
        ("mdrive", "mcode", &[], b"PR VM\r".to_vec()),
    ] {
        for (fault, effect) in [
            (LineFaults { drop: request, ..LineFaults::NONE }, "was dropped"),
            (LineFaults { corrupt: request, ..LineFaults::NONE }, "was corrupted"),
            (LineFaults { truncate: request, ..LineFaults::NONE }, "was truncated"),
            (LineFaults { duplicate: request, ..LineFaults::NONE }, "was sent twice"),
        ] {
            for seed in 0..60 {
                let mut bench = Bench::with(Settings { seed, ..Settings::default() });
                let device = crate::catalog::make(kind).unwrap();
                let row = |name| device.spec().find(name).unwrap().row;
                let presets = presets.iter().map(|&(name, value)| (row(name), value)).collect();
                let setup = Setup { boot_fast: true, presets, ..Setup::default() };
                let drive = bench.add_with("x", device, setup).unwrap();
                ready(&mut bench);
                let number = bench.spec(drive).ports.iter().position(|spec| spec.name == port).unwrap();
                let outlet = bench.outlet(drive, Port(number as u8));
                bench.set_faults(outlet, fault);
                let client = bench.join(outlet).unwrap();
                bench.send(client, &bytes);
                bench.run_until_idle();
                bench.run_until(bench.now() + Duration::secs(2));
                bench.disconnect(client);
                bench.run_until_idle();
                let words = words(&bench, drive);
                let clause = format!("by a fault, the request {effect}");
                let told = words.iter().filter(|entry| entry.contains(&clause)).count();
                let least = if effect == "was sent twice" { 2 } else { 1 };
                assert!(told >= least, "{kind} {port} {seed} {clause}: {words:#?}");
                // The next request of another client has nothing of it.
                let client = bench.join(outlet).unwrap();
                bench.send(client, if port == "usb" { b"\r" } else { b"" });
                bench.run_until_idle();
                bench.send(client, &bytes);
                bench.run_until_idle();
                let last = super::received::words(&bench, drive).pop().unwrap();
                assert!(!last.contains("by a fault"), "{kind} {port} {seed}: {last}");
            }
        }
    }
}

/// Two MD3, `x` with address 1 ready, and `y` with address 2 as `setup` says, on one line.
fn ready_and(setup: Setup) -> (Bench, DriveId, DriveId) {
    let mut bench = Bench::new();
    let row = Md3::default().spec().find("DeviceAddress").unwrap().row;
    let x = bench.add_with("x", Box::new(Md3::default()), Setup { boot_fast: true, ..Setup::default() });
    let y = bench.add_with("y", Box::new(Md3::default()), Setup { presets: vec![(row, 2)], ..setup });
    let (x, y) = (x.unwrap(), y.unwrap());
    bench.share("line1", &[(x, Port(0)), (y, Port(0))]);
    bench.run_until(Instant::from(Duration::millis(200)));
    (bench, x, y)
}

/// A frame that nobody can read is in the journal of the line, once, whatever the drives do that do not listen.
#[test]
fn a_corrupt_frame_is_corrupt_also_beside_a_drive_that_starts() {
    let corrupt = [1, 6, 0, 0x1D, 0, 9, 0xD9, 0];
    let text = "rs485 <- 8 bytes 01 06 00 1D 00 09 D9 00 -> CRC wrong: D9 00 instead of D9 CA";
    for off in [0, 1, 2] {
        let (mut bench, x, y) = ready_and(Setup::default());
        for drive in [y, x].into_iter().take(off) {
            bench.power(drive, PowerAction::Off);
        }
        bench.run_until(bench.now() + Duration::millis(1));
        let client = bench.connect(bench.bus(x, Port(0)).unwrap());
        for frame in [&corrupt[..], &[0xFF, 0, 0xAA], &rtu::read(1, 0x1D, 1)[..6]] {
            bench.send(client, frame);
            // A part of a request is sent when the rest does not come.
            bench.run_until(bench.now() + Duration::millis(500));
        }
        let (of_x, of_y) = (words(&bench, x), words(&bench, y));
        assert_eq!((of_x.len(), of_x[0].as_str()), (3, text), "{off}: {of_x:#?}");
        assert_eq!(of_x[1], "rs485 <- 3 bytes FF 00 AA -> no frame has this length", "{off}");
        assert!(of_x[2].starts_with("rs485 <- 6 bytes 01 03 00 1D 00 01 -> "), "{off}: {of_x:#?}");
        assert_eq!(of_y, of_x, "{off}");
        assert_eq!(bench.starting_requests(y).count, 0, "{off}");
    }
}

/// A drive that starts still has an entry for its request after another drive has answered.
#[test]
fn a_request_to_a_drive_that_starts_follows_an_answer_of_another_one() {
    let (mut bench, x, y) = ready_and(Setup::default());
    let client = bench.connect(bench.bus(x, Port(0)).unwrap());
    for address in [1, 2] {
        bench.send(client, &rtu::read(address, 0, 1));
        bench.run_until_idle();
        bench.run_until(bench.now() + Duration::millis(20));
    }
    assert_eq!(words(&bench, x), ["rs485 <- read DeviceAddress -> DeviceAddress = 1"]);
    let of_y = words(&bench, y);
    assert_eq!((of_y.len(), bench.starting_requests(y).count), (1, 1), "{of_y:#?}");
    assert!(of_y[0].starts_with("rs485 <- read DeviceAddress -> starting for "), "{of_y:#?}");
}

/// A disturbed request reaches drives in single characters, and has one entry all the same.
#[test]
fn a_disturbed_request_has_one_entry_whether_drives_listen_or_not() {
    use crate::line::faults::{FaultRule, LineFaults};
    let corrupt = LineFaults { corrupt: FaultRule::ALL, ..LineFaults::NONE };
    for seed in 0..40 {
        for off in [false, true] {
            let mut bench = Bench::with(Settings { seed, ..Settings::default() });
            let x = bench.add::<Md3>("x");
            if off {
                bench.power(x, PowerAction::Off);
                bench.run_until(Instant::from(Duration::millis(1)));
            }
            bench.set_line_faults(bench.bus(x, Port(0)).unwrap(), corrupt);
            bench.ask(x, &rtu::write(1, 0x1D, 9));
            ready(&mut bench);
            let words = words(&bench, x);
            let (what, count) = if off { ("-> no power; ", 0) } else { ("-> starting for 2.", 1) };
            assert!(words.len() == 1 && words[0].contains(what), "{seed}: {words:#?}");
            assert!(words[0].ends_with("by a fault, the request was corrupted"), "{seed}: {words:#?}");
            assert_eq!(bench.starting_requests(x).count, count, "{seed}");
        }
        // Beside a drive that listens, the line has the entry.
        let (mut bench, x, y) = ready_and(Setup::default());
        bench.set_line_faults(bench.bus(x, Port(0)).unwrap(), corrupt);
        bench.run_until(bench.now() + Duration::millis(seed));
        bench.ask(x, &rtu::write(1, 0x1D, 9));
        ready(&mut bench);
        let verdicts: Vec<_> = bench.received(x).messages().map(|message| message.exchange.verdict).collect();
        assert_eq!(verdicts, [Verdict::BadFrame]);
        assert_eq!(words(&bench, y), words(&bench, x));
        // A frame that starts at another baud rate is unreadable, also for drives without power.
        let (mut bench, x, y) = ready_and(Setup::default());
        bench.power(x, PowerAction::Off);
        bench.power(y, PowerAction::Off);
        bench.run_until(bench.now() + Duration::millis(1));
        let bus = bench.bus(x, Port(0)).unwrap();
        bench.set_line_faults(bus, LineFaults { baud: Some(2_400), ..LineFaults::NONE });
        bench.ask(x, &rtu::write(1, 0x1D, 9));
        assert_eq!(words(&bench, x).len(), 1, "{:#?}", words(&bench, x));
        assert!(words(&bench, x)[0].contains("8 characters with errors"), "{:#?}", words(&bench, x));
    }
}

/// Power that fails in the middle of a save, or of a request, leaves an entry of the request for itself.
#[test]
fn a_request_that_loses_its_power_has_an_entry() {
    let qsb = Box::new(Qsb::m());
    let mdrive = Box::new(Mdrive::plus());
    for (device, port, save, read, text) in [
        (
            Box::new(Md3::default()) as Box<dyn Device>,
            "rs485",
            rtu::write(1, 0x1A, 1).to_vec(),
            rtu::read(1, 0, 1).to_vec(),
            ["write EEPROMControl = 1", "read DeviceAddress"],
        ),
        (qsb, "usb", b"W1603\r".to_vec(), b"R0E\r".to_vec(), ["", ""]),
        (mdrive, "mcode", b"S\r".to_vec(), b"PR P\r".to_vec(), ["", ""]),
    ] {
        let mut bench = Bench::new();
        let drive = bench.add_with("x", device, Setup { boot_fast: true, ..Setup::default() }).unwrap();
        ready(&mut bench);
        let number = bench.spec(drive).ports.iter().position(|spec| spec.name == port).unwrap() as u8;
        bench.cut_power(drive, crate::record::trace::Cut { stores: 0, bytes: 0 });
        bench.run_until(bench.now() + Duration::millis(1));
        assert!(!say(&mut bench, drive, number, &save).ends_with(&save), "{port}: no answer");
        assert!(!bench.powered(drive), "{port}");
        let before = words(&bench, drive);
        assert_eq!(before.len(), 1, "{before:#?}");
        assert!(before[0].contains(text[0]), "{before:#?}");
        assert!(before[0].ends_with(" -> power lost before the answer"), "{before:#?}");
        bench.power(drive, PowerAction::On);
        ready(&mut bench);
        say(&mut bench, drive, number, &read);
        let after = words(&bench, drive);
        assert_eq!((after.len(), after[1].contains(text[1])), (2, true), "{after:#?}");
        let last = bench.received(drive).messages().next_back().unwrap();
        assert_eq!((last.bytes, last.exchange.verdict), (read, Verdict::Done), "{port}");
    }
    // Power goes off while the request arrives.
    let mut bench = Bench::new();
    let drive = bench.add_with("x", Box::new(Md3::default()), Setup { boot_fast: true, ..Setup::default() });
    let drive = drive.unwrap();
    ready(&mut bench);
    let client = bench.connect(bench.bus(drive, Port(0)).unwrap());
    bench.send(client, &rtu::read(1, 0, 1));
    bench.run_until(bench.now() + Duration::millis(3));
    bench.power(drive, PowerAction::Off);
    ready(&mut bench);
    assert_eq!(words(&bench, drive), ["rs485 <- read DeviceAddress -> power lost before the answer"]);
}

/// Power that fails during a reply is in the entry of the request.
#[test]
fn a_reply_that_loses_its_power_is_cut_in_the_journal() {
    let read = rtu::read(1, 0, 1);
    let mut expected = 0;
    // The request takes 8 characters of 1.15 ms, and the reply 7.
    for wait in 2..30 {
        let mut bench = Bench::new();
        let setup = Setup { boot_fast: true, ..Setup::default() };
        let x = bench.add_with("x", Box::new(Md3::default()), setup).unwrap();
        ready(&mut bench);
        let client = bench.connect(bench.bus(x, Port(0)).unwrap());
        bench.send(client, &read);
        bench.run_until(bench.now() + Duration::millis(wait));
        bench.power(x, PowerAction::Off);
        ready(&mut bench);
        let mut answer = Vec::new();
        bench.receive(client, &mut answer);
        let words = words(&bench, x);
        assert_eq!(words.len(), 1, "{wait}: {words:#?}");
        let cut = format!("; power lost after {} of 7 bytes of the reply", answer.len());
        let all = "rs485 <- read DeviceAddress -> DeviceAddress = 1";
        match answer.len() {
            7 => assert_eq!(words[0], all, "{wait}"),
            0 => assert!(words[0].contains("power lost "), "{wait}: {words:#?}"),
            _ => {
                expected += 1;
                assert_eq!(words[0], format!("{all}{cut}"), "{wait}");
            }
        }
    }
    assert!(expected > 3, "power failed within the reply {expected} times");
}

/// In Modbus ASCII a reply that lost its end is no part of the next request to another drive.
#[test]
fn a_truncated_reply_in_ascii_hides_no_request() {
    use crate::line::faults::{Direction, FaultRule, LineFaults};
    use drivetwin_protocol::modbus::ascii;
    let truncate = FaultRule::next(1).direction(Direction::Reply);
    for (seed, asked) in (0..20).flat_map(|seed| [(seed, 1), (seed, 2)]) {
        let mut bench = Bench::with(Settings { seed, ..Settings::default() });
        let drives = [("x", 1), ("y", 2)].map(|(name, address)| {
            let device = Rs434::rs434544();
            let row = |name| device.spec().find(name).unwrap().row;
            let own = device.spec().address.unwrap();
            let presets = vec![(row("TYPE_MODBUS"), 1), (row("BITRATE_MODBUS"), 4), (own, address)];
            let setup = Setup { boot_fast: true, presets, ..Setup::default() };
            bench.add_with(name, Box::new(device), setup).unwrap()
        });
        let bus = bench.share("line1", &drives.map(|drive| (drive, Port(0))));
        ready(&mut bench);
        bench.set_line_faults(bus, LineFaults { truncate, ..LineFaults::NONE });
        let client = bench.connect(bus);
        for (address, pdu) in [(asked, [3, 0x50, 0x0B, 0, 1]), (1, [6, 0x50, 0x0B, 0x07, 0xD0])] {
            bench.send(client, &ascii::frame(address, &pdu));
            bench.run_until(bench.now() + Duration::millis(500));
        }
        let of_x = words(&bench, drives[0]);
        assert_eq!(of_x.last().map(String::as_str), Some("rs485 <- write SPEED = 2000 -> done"), "{of_x:#?}");
        assert!(!of_x.iter().any(|words| words.contains("nobody here")), "{seed}: {of_x:#?}");
    }
}

/// Noise behind a reply is no request of the master.
#[test]
fn noise_of_replies_is_noise_in_the_journal() {
    use crate::line::faults::{Direction, FaultRule, LineFaults};
    for (line, seed) in
        [LineMode::Timed, LineMode::Fast].into_iter().flat_map(|line| (0..20).map(move |n| (line, n)))
    {
        let mut bench = Bench::with(Settings { line, seed, ..Settings::default() });
        let x = bench.add::<Md3>("x");
        ready(&mut bench);
        let noise = FaultRule::ALL.direction(Direction::Reply);
        bench.set_line_faults(bench.bus(x, Port(0)).unwrap(), LineFaults { noise, ..LineFaults::NONE });
        for _ in 0..3 {
            bench.ask(x, &rtu::read(1, 0, 1));
            bench.run_until(bench.now() + Duration::millis(50));
        }
        let words = words(&bench, x);
        let (reads, noise): (Vec<_>, Vec<_>) =
            words.iter().partition(|words| words.contains("read DeviceAddress"));
        assert_eq!((reads.len(), noise.len()), (3, 3), "{words:#?}");
        assert!(
            reads.iter().all(|words| words.ends_with("; by a fault, the reply had noise beside it")),
            "{words:#?}"
        );
        assert!(
            noise.iter().all(|words| words.ends_with("; by a fault, the request was noise")),
            "{words:#?}"
        );
    }
}

/// While an MDrive starts again after Ctrl-C, MCode input is lost and requests to port 502 get exception 04 (MDRIVE-7).
#[test]
fn a_line_for_an_mdrive_that_starts_has_an_entry() {
    let mut bench = Bench::new();
    let (drive, port) = mcode(&mut bench);
    let [a, b] = [(); 2].map(|()| bench.connect_to(drive, Port(port)).unwrap());
    bench.send(b, b"PR ");
    bench.run_until_idle();
    // CE takes 2 ms; then the drive starts for 300 ms.
    bench.send(a, b"CE 1\r\x03PR VM\r");
    bench.run_until(bench.now() + Duration::millis(110));
    bench.send(a, b"VM=9000\rR1");
    let header = tcp::Header { transaction: 7, unit: 255 };
    let modbus = bench.connect_to(drive, Port(1 - port)).unwrap();
    bench.send(modbus, &tcp::frame(header, &[3, 0, 0x57, 0, 2]));
    bench.run_until(bench.now() + Duration::millis(400));
    bench.send(a, b"PR VM\r");
    bench.run_until_idle();
    bench.send(b, b"P\r");
    bench.run_until_idle();
    assert_eq!(
        words(&bench, drive),
        [
            "mcode <- CE 1 -> done",
            "mcode <- Ctrl-C -> done",
            "mcode <- PR VM -> starting for 0.3 s more",
            "mcode <- VM=9000 -> starting for 0.2 s more",
            "modbus <- read P -> refused: starting for 0.2 s more (04)",
            "mcode <- R1 -> starting",
            "mcode <- PR VM -> 768000",
            "mcode <- PR -> starting",
            "mcode <- P -> refused: trying to execute a variable or flag (error 34)",
        ]
    );
    let verdicts: Vec<Verdict> =
        bench.received(drive).messages().map(|message| message.exchange.verdict).collect();
    assert_eq!(verdicts.iter().filter(|verdict| **verdict == Verdict::NotListening).count(), 4);
    assert_eq!((bench.starting_requests(drive).count, bench.starting_count()), (4, 4));
    assert_eq!(bench.statistics(drive, Port(port)).starting, 4);
    assert_eq!(bench.received(drive).written(), ["CE"]);
}

/// A reset input (type 11, MC 5-63) ends the line in execution; the drive then starts for 300 ms.
#[test]
fn a_line_in_execution_that_a_restart_ends_has_an_entry() {
    let mut bench = Bench::new();
    let (drive, port) = mcode(&mut bench);
    say(&mut bench, drive, port, b"S1=11,0,0\r");
    let before = words(&bench, drive);
    let client = bench.connect_to(drive, Port(port)).unwrap();
    // The input filter D1 takes 5 ms, and the line 2 ms.
    bench.set_pin(drive, bench.spec(drive).pin("IO1").unwrap(), PinStimulus::Low);
    bench.run_until(bench.now() + Duration::millis(4));
    bench.send(client, b"VM=9000\r");
    bench.run_until(bench.now() + Duration::millis(500));
    assert_eq!(words(&bench, drive)[before.len()..], ["mcode <- VM=9000 -> starting for 0.3 s more"]);
}

/// Characters that a QSB cannot read have an entry, and the next command says why the QSB refuses it.
#[test]
fn characters_that_a_qsb_cannot_read_have_an_entry() {
    use crate::line::Sender;
    for line in [LineMode::Timed, LineMode::Fast] {
        let mut bench = Bench::with(Settings { line, ..Settings::default() });
        let drive = bench.add_with("q", Box::new(Qsb::d()), Setup::default()).unwrap();
        let bus = bench.bus(drive, Port(0)).unwrap();
        ready(&mut bench);
        let client = bench.connect(bus);
        let at_9600 = Sender { baud: Some(9_600), ..Sender::default() };
        bench.send_from(client, b"R0E\r", at_9600);
        bench.run_until(bench.now() + Duration::millis(100));
        let bad = "usb <- nothing that could be read -> \
            4 characters with errors: baud rate, parity, or a disturbance";
        assert_eq!(words(&bench, drive), [bad], "{line:?}");
        for (command, sender) in
            [(&b"R0E\r"[..], Sender::default()), (b"R14\r", Sender::default()), (b"R0E\r", at_9600)]
        {
            bench.send_from(client, command, sender);
            bench.run_until(bench.now() + Duration::millis(100));
        }
        assert_eq!(
            words(&bench, drive)[1..],
            [
                "usb <- read ReadEncoder -> refused: the line has 4 characters with errors: baud rate, parity, or a \
                 disturbance (x)",
                "usb <- read Version -> Version = 4110",
                bad,
            ],
            "{line:?}"
        );
        // A backspace cancels the characters (QSB-1).
        bench.send(client, b"\x08R14\r");
        bench.run_until(bench.now() + Duration::millis(100));
        assert_eq!(words(&bench, drive)[4..], ["usb <- read Version -> Version = 4110"]);
        let verdicts: Vec<Verdict> =
            bench.received(drive).messages().map(|message| message.exchange.verdict).collect();
        assert_eq!((verdicts[0], verdicts[3]), (Verdict::BadFrame, Verdict::BadFrame));
        // A QSB that starts, or has no power, does not know the baud rate.
        bench.power(drive, PowerAction::Cycle);
        bench.run_until(bench.now() + Duration::millis(1));
        bench.send_from(client, b"R", at_9600);
        bench.run_until(bench.now() + Duration::millis(100));
        bench.power(drive, PowerAction::Off);
        bench.run_until(bench.now() + Duration::millis(1));
        bench.send_from(client, b"R0E\r", at_9600);
        bench.run_until(bench.now() + Duration::millis(100));
        let words = words(&bench, drive);
        assert!(words[5].starts_with("usb <- nothing that could be read -> starting for "), "{words:#?}");
        assert_eq!(words[6..], ["usb <- nothing that could be read -> no power"]);
        bench.send(client, b"R0");
        bench.run_until(bench.now() + Duration::millis(100));
        bench.send(client, b"E\rR1");
        bench.run_until(bench.now() + Duration::millis(100));
        bench.power(drive, PowerAction::On);
        ready(&mut bench);
        bench.send(client, b"R14\r");
        bench.run_until(bench.now() + Duration::millis(100));
        assert_eq!(
            super::received::words(&bench, drive)[7..],
            ["usb <- read ReadEncoder -> no power", "usb <- read Version -> Version = 4110"]
        );
    }
}

/// A part of a line that is lost in a restart has an entry, and an empty one has none.
#[test]
fn a_restart_loses_only_what_was_typed() {
    let mut bench = Bench::new();
    let (drive, port) = mcode(&mut bench);
    let [a, b] = [(); 2].map(|()| bench.connect_to(drive, Port(port)).unwrap());
    bench.send(b, b"PR ");
    bench.run_until_idle();
    bench.send(a, b"CE 1\r\x03");
    bench.run_until(bench.now() + Duration::millis(500));
    for client in [a, b] {
        bench.send(client, b"PR P\r");
        bench.run_until(bench.now() + Duration::millis(100));
    }
    bench.send(a, b"\x03VM");
    bench.run_until(bench.now() + Duration::millis(100));
    bench.power(drive, PowerAction::Off);
    ready(&mut bench);
    assert_eq!(
        words(&bench, drive),
        [
            "mcode <- CE 1 -> done",
            "mcode <- Ctrl-C -> done",
            "mcode <- PR P -> 0",
            "mcode <- PR -> starting",
            "mcode <- PR P -> 0",
            "mcode <- Ctrl-C -> done",
            "mcode <- VM -> starting",
        ]
    );
}

/// Lines after PG are stored in the program (MC 5-55) and write nothing before the program runs; expressions, IC and DC
/// write (MC 4.9, 5-16, 5-33).
#[test]
fn a_line_that_is_stored_writes_no_register() {
    use crate::bench::scenario::{Action, Scenario, Step, Trigger, Written};
    let mut bench = Bench::new();
    let (drive, port) = mcode(&mut bench);
    let spec = bench.spec(drive);
    let find = |name| spec.find(name).unwrap();
    let step = |name, value| {
        let written = Written { drive, row: find(name).row, value };
        let action = Action::Power { drive, action: PowerAction::Off };
        Scenario { steps: vec![Step { trigger: Trigger::Written(written), after: Duration::ZERO, action }] }
    };
    bench.play(step("VM", None)).unwrap();
    bench.play(step("R1", Some(7))).unwrap();
    say(&mut bench, drive, port, b"PG 100\rVM=9000\rIC R1\rE\rPG\rMR 10\r");
    assert_eq!(
        words(&bench, drive),
        [
            "mcode <- PG 100 -> done",
            "mcode <- VM=9000 -> accepted, stored in the program",
            "mcode <- IC R1 -> accepted, stored in the program",
            "mcode <- E -> accepted, stored in the program",
            "mcode <- PG -> done",
            "mcode <- MR 10 -> done",
        ]
    );
    let received = bench.received(drive);
    assert!(received.messages().all(|message| message.exchange.verdict == Verdict::Done));
    assert_eq!(received.written(), ["MR"]);
    assert!(!received.wrote_before(find("VM"), find("MR")));
    assert_eq!(received.counts().registers.keys().collect::<Vec<_>>(), ["MR"]);
    assert!(bench.powered(drive), "VM is not written yet");
    say(&mut bench, drive, port, b"R2=1\rR1 = R2 + 5\rDC R2\r");
    assert_eq!(bench.received(drive).written(), ["MR", "R2", "R1", "R2"]);
    assert!(bench.powered(drive), "R1 is 6");
    say(&mut bench, drive, port, b"IC R1\r");
    assert!(!bench.powered(drive), "R1 is 7");
}

/// Requests that collide have an entry each, in the journal of the drive that they were for, and a reply that collides is
/// in the entry of its request.
#[test]
fn requests_and_replies_that_collide_have_an_entry() {
    // Requests take 8 characters of 1.15 ms; 4.6 ms after the end the drive replies with 8 characters.
    for (wait, shared) in [0, 3, 14, 17, 20].into_iter().flat_map(|wait| [(wait, false), (wait, true)]) {
        let (mut bench, x, y) = ready_and(Setup { boot_fast: true, ..Setup::default() });
        if !shared {
            bench = Bench::new();
            bench
                .add_with("x", Box::new(Md3::default()), Setup { boot_fast: true, ..Setup::default() })
                .unwrap();
            ready(&mut bench);
        }
        let bus = bench.bus(x, Port(0)).unwrap();
        bench.set_collisions(bus, true);
        let [a, b] = [(); 2].map(|()| bench.connect(bus));
        bench.send(a, &rtu::write(1, 0x1D, 9));
        bench.run_until(bench.now() + Duration::millis(wait));
        bench.send(b, &rtu::read(1, 0, 1));
        bench.run_until(bench.now() + Duration::millis(200));
        let (write, read) = ("rs485 <- write UserRegister = 9 -> ", "rs485 <- read DeviceAddress -> ");
        let expected = match wait {
            0 | 3 => ["collision with the request of another client"; 2],
            _ => ["done; the reply collided with other characters", "collision with the reply of a drive"],
        };
        let expected = [format!("{write}{}", expected[0]), format!("{read}{}", expected[1])];
        assert_eq!(words(&bench, x), expected, "{wait} ms, {shared}");
        let received = bench.received(x);
        let verdict = received.messages().next_back().unwrap().exchange.verdict;
        assert_eq!(verdict, Verdict::BadFrame);
        if shared {
            assert_eq!(words(&bench, y), [""; 0], "{wait} ms");
        }
        // The line works as before.
        bench.send(a, &rtu::read(1, 0x1D, 1));
        bench.run_until(bench.now() + Duration::millis(200));
        let value = if wait < 10 { 0 } else { 9 };
        assert_eq!(words(&bench, x)[2..], [format!("rs485 <- read UserRegister -> UserRegister = {value}")]);
    }
}

/// A request for no drive, or for all, that collides is in the journal of the line. Two drives with one address collide
/// in each reply.
#[test]
fn collisions_of_a_line_are_in_its_journal() {
    let (mut bench, x, y) = ready_and(Setup { boot_fast: true, ..Setup::default() });
    let bus = bench.bus(x, Port(0)).unwrap();
    bench.set_collisions(bus, true);
    let [a, b] = [(); 2].map(|()| bench.connect(bus));
    bench.send(a, &rtu::write(0, 0x1D, 9));
    bench.send(b, &rtu::read(2, 0, 1));
    bench.run_until(bench.now() + Duration::millis(200));
    let with = "collision with the request of another client";
    let to_all = format!("rs485 <- to all: write UserRegister = 9 -> {with}");
    assert_eq!(words(&bench, x), std::slice::from_ref(&to_all));
    assert_eq!(words(&bench, y), [to_all, format!("rs485 <- read DeviceAddress -> {with}")]);
    bench.ask(y, &rtu::write(2, 0, 1));
    bench.ask(y, &rtu::read(1, 0x1D, 1));
    for drive in [x, y] {
        let collided =
            "rs485 <- read UserRegister -> UserRegister = 0; the reply collided with other characters";
        assert_eq!(words(&bench, drive).last().map(String::as_str), Some(collided));
    }
}

/// Power that fails during the replies of a QSB is in the entry of each command whose reply was not complete; a stream is
/// no reply.
#[test]
fn replies_of_a_qsb_that_lose_their_power_are_cut_in_the_journal() {
    let (mut cut, mut unsent) = (0, 0);
    // At 230,400 baud a character takes 43 us. A reply is `r 0E 00000000 !` with CR and LF.
    for wait in (0..60).map(|n| Duration::micros(n * 43)) {
        let mut bench = Bench::new();
        let setup = Setup { boot_fast: true, ..Setup::default() };
        let drive = bench.add_with("q", Box::new(Qsb::d()), setup).unwrap();
        ready(&mut bench);
        let client = bench.connect(bench.bus(drive, Port(0)).unwrap());
        let mut old = Vec::new();
        bench.receive(client, &mut old);
        bench.send(client, b"R0E\rR14\r");
        bench.run_until(bench.now() + wait);
        bench.power(drive, PowerAction::Off);
        ready(&mut bench);
        let mut answer = Vec::new();
        bench.receive(client, &mut answer);
        let words = words(&bench, drive);
        let mut left = answer.len();
        for (number, read) in
            ["ReadEncoder -> ReadEncoder = 0", "Version -> Version = 4110"].iter().enumerate()
        {
            let Some(entry) = words.get(number).filter(|entry| entry.contains(" = ")) else { continue };
            let length = bench.received(drive).messages().nth(number).unwrap().answer.len();
            let sent = left.min(length);
            left -= sent;
            let clause = match sent {
                _ if sent == length => String::new(),
                _ => format!("; power lost after {sent} of {length} bytes of the reply"),
            };
            (cut, unsent) = (cut + usize::from(sent > 0 && sent < length), unsent + usize::from(sent == 0));
            assert_eq!(*entry, format!("usb <- read {read}{clause}"), "{wait:?}: {words:#?}");
        }
    }
    assert!(cut > 5 && unsent > 0, "{cut} replies were cut, {unsent} not sent");
    let mut broken = 0;
    for wait in (0..40).map(|n| Duration::micros(n * 100)) {
        let mut bench = Bench::new();
        let setup = Setup { boot_fast: true, ..Setup::default() };
        let drive = bench.add_with("q", Box::new(Qsb::d()), setup).unwrap();
        ready(&mut bench);
        let client = bench.connect(bench.bus(drive, Port(0)).unwrap());
        // A stream of the encoder without a pause; the threshold is 0.
        for command in [&b"W0C0\r"[..], b"W0B0\r", b"S0E\r"] {
            bench.send(client, command);
            bench.run_until(bench.now() + Duration::millis(200));
        }
        bench.run_until(bench.now() + wait);
        bench.power(drive, PowerAction::Off);
        ready(&mut bench);
        let mut stream = Vec::new();
        bench.receive(client, &mut stream);
        broken += usize::from(!stream.ends_with(b"\n"));
        assert!(words(&bench, drive).iter().all(|words| !words.contains("power lost")));
    }
    assert!(broken > 10, "power failed in {broken} values of the stream");
}

/// A reply on a TCP port that a fault delays is lost with the power of its drive.
#[test]
fn a_delayed_reply_that_is_lost_with_the_power_says_so() {
    use crate::line::faults::LineFaults;
    let mut bench = Bench::new();
    let (drive, mcode) = mcode(&mut bench);
    let delay = LineFaults { delay: Duration::millis(50), ..LineFaults::NONE };
    let header = tcp::Header { transaction: 7, unit: 255 };
    let read = tcp::frame(header, &[3, 0, 0x57, 0, 2]);
    for (port, request) in [(1 - mcode, &read[..]), (mcode, b"PR VM\r")] {
        bench.set_faults(bench.outlet(drive, Port(port)), delay);
        let client = bench.connect_to(drive, Port(port)).unwrap();
        bench.send(client, request);
        bench.run_until(bench.now() + Duration::millis(100));
        bench.send(client, request);
        bench.run_until(bench.now() + Duration::millis(30));
    }
    bench.power(drive, PowerAction::Off);
    bench.run_until(bench.now() + Duration::millis(1));
    let late = "by a fault, the reply was delayed";
    let words = words(&bench, drive);
    assert_eq!(
        words[..3],
        [
            format!("modbus <- read P -> P = 0; {late}"),
            format!("modbus <- read P -> P = 0; {late}"),
            format!("mcode <- PR VM -> 768000; {late}"),
        ]
    );
    assert!(words[3].starts_with("mcode <- PR VM -> 768000; power lost after 0 of "), "{words:#?}");
    assert!(words[3].ends_with(&format!(" bytes of the reply; {late}")), "{words:#?}");
}

/// Serial, 2.1: no slave answers a request to all, so reading has no effect.
#[test]
fn a_read_by_all_has_no_effect() {
    let (mut bench, x, y) = ready_and(Setup { boot_fast: true, ..Setup::default() });
    bench.ask(x, &rtu::read(0, 0x14, 2));
    bench.ask(x, &rtu::write(0, 0x1D, 7));
    let read = "rs485 <- to all: read Speed -> accepted, without effect: no drive answers a request to all";
    for drive in [x, y] {
        assert_eq!(words(&bench, drive), [read, "rs485 <- to all: write UserRegister = 7 -> done"]);
        let first = bench.received(drive).messages().next().unwrap();
        assert_eq!(first.exchange.verdict, Verdict::WithoutEffect);
    }
}

#[test]
fn a_wrong_byte_count_is_the_reason_of_a_refusal() {
    let mut bench = Bench::new();
    let (drive, mcode) = mcode(&mut bench);
    let header = tcp::Header { transaction: 7, unit: 255 };
    // VM is 0x89, two registers. FB 4.2.5: a byte count, two for each register.
    for pdu in [&[16, 0, 0x89, 0, 2, 2, 0x03, 0xE8][..], &[16, 0, 0x89, 0, 2, 4, 0x03, 0xE8]] {
        say(&mut bench, drive, 1 - mcode, &tcp::frame(header, pdu));
    }
    let outcomes: Vec<String> =
        bench.received(drive).messages().map(|message| message.exchange.outcome).collect();
    assert_eq!(
        outcomes,
        ["refused: the byte count is 2, not 4 (03)", "refused: the byte count is 4, and 2 bytes follow (03)"]
    );
}

/// A drive refuses a function that it does not have, whatever the length, so the fault `exception` answers in its place.
#[test]
fn a_forced_exception_answers_what_the_drive_would_refuse() {
    use crate::line::faults::{FaultRule, LineFaults};
    let exception = LineFaults { exception: FaultRule::ALL, exception_code: 6, ..LineFaults::NONE };
    // Function 15 with a byte count of 9, at an MD3, which has no function 15.
    let request = rtu::frame(1, &[15, 0, 0, 0, 1, 9, 1]);
    let mut bench = Bench::new();
    let x =
        bench.add_with("x", Box::new(Md3::default()), Setup { boot_fast: true, ..Setup::default() }).unwrap();
    ready(&mut bench);
    assert_eq!(bench.ask(x, &request), rtu::frame(1, &[0x8F, 1]).to_vec());
    bench.set_line_faults(bench.bus(x, Port(0)).unwrap(), exception);
    assert_eq!(bench.ask(x, &request), rtu::frame(1, &[0x8F, 6]).to_vec());
    // On TCP a drive answers a request of a wrong length, too.
    let mut bench = Bench::new();
    let (drive, mcode) = mcode(&mut bench);
    let header = tcp::Header { transaction: 7, unit: 255 };
    let short = tcp::frame(header, &[3, 0, 0x57, 0]);
    assert_eq!(say(&mut bench, drive, 1 - mcode, &short), tcp::frame(header, &[0x83, 3]).to_vec());
    bench.set_faults(bench.outlet(drive, Port(1 - mcode)), exception);
    assert_eq!(say(&mut bench, drive, 1 - mcode, &short), tcp::frame(header, &[0x83, 6]).to_vec());
    let last = bench.received(drive).messages().next_back().unwrap();
    assert_eq!(last.exchange.outcome, "refused: by a fault (06)");
}

/// The comments in a pcapng file of a bench.
fn comments(bench: &Bench) -> Vec<String> {
    let mut file = Vec::new();
    crate::export::pcapng::Pcapng::new(bench, &mut file).unwrap().finish(bench).unwrap();
    let (mut comments, mut rest) = (Vec::new(), &file[..]);
    while let [kind @ .., _, _, _, _] = rest.get(..8).unwrap_or_default() {
        let length = u32::from_le_bytes(rest[4..8].try_into().unwrap()) as usize;
        if kind == [6, 0, 0, 0] {
            let data = u32::from_le_bytes(rest[20..24].try_into().unwrap()).next_multiple_of(4) as usize;
            let mut options = &rest[28 + data..length - 4];
            while let &[code, 0, low, high, ..] = options {
                let count = usize::from(u16::from_le_bytes([low, high]));
                if code == 1 {
                    comments.push(String::from_utf8(options[4..4 + count].to_vec()).unwrap());
                }
                options = &options[(4 + count).next_multiple_of(4)..];
            }
        }
        rest = &rest[length..];
    }
    comments
}

#[test]
fn comments_of_replies_and_keys_are_those_of_their_messages() {
    let keep = Settings { capture: crate::record::trace::Retention::All, ..Settings::default() };
    let mut bench = Bench::with(keep);
    let row = |name| Md3::default().spec().find(name).unwrap().row;
    let setup = Setup { boot_fast: true, presets: vec![(row("MoveSteps"), 0)], ..Setup::default() };
    let x = bench.add_with("x", Box::new(Md3::default()), setup).unwrap();
    ready(&mut bench);
    bench.ask(x, &rtu::write(1, 0x11, 1));
    let words = words(&bench, x).remove(0);
    let (request, outcome) = words.trim_start_matches("rs485 <- ").split_once(" -> ").unwrap();
    assert!(outcome.starts_with("accepted, without effect: "), "{outcome}");
    assert_eq!(comments(&bench), [format!("{request} -> {outcome}"), outcome.to_owned()]);

    let mut bench = Bench::with(keep);
    let (drive, port) = mcode(&mut bench);
    let client = bench.connect_to(drive, Port(port)).unwrap();
    for text in [&b"\x1b"[..], b"\t\r", b"\x1bPR P\r"] {
        bench.send(client, text);
        bench.run_until(bench.now() + Duration::millis(100));
    }
    let words: Vec<String> =
        super::received::words(&bench, drive).iter().map(|words| words.replace("mcode <- ", "")).collect();
    assert_eq!(words, ["Esc -> done", "a blank line -> done", "Esc -> done", "PR P -> 0"]);
    assert_eq!(comments(&bench), words);
}

/// An RS 434544 that FLAG_RESTART restarts (6.4) does not listen either.
#[test]
fn a_request_to_an_rs_drive_that_restarts_has_an_entry() {
    let mut bench = Bench::new();
    let x = bench.add_with("x", Box::new(Rs434::rs434544()), Setup::default()).unwrap();
    ready(&mut bench);
    let spec = bench.spec(x);
    let restart = spec.registers.rows[spec.find("FLAG_RESTART").unwrap().row].address;
    let client = bench.connect(bench.bus(x, Port(0)).unwrap());
    bench.send(client, &rtu::write(1, restart, 0x95AF));
    bench.run_until(bench.now() + Duration::millis(100));
    bench.send(client, &rtu::read(1, 0x5000, 1));
    bench.run_until(bench.now() + Duration::millis(100));
    ready(&mut bench);
    let words = words(&bench, x);
    assert_eq!(words.len(), 2, "{words:#?}");
    assert!(words[1].starts_with("rs485 <- read SLAVE_ADDRESS_MODBUS -> starting for "), "{words:#?}");
}

/// The reply that the other drives receive is no request, also beside noise, copies and other clients; what a client sends
/// behind a reply has an entry.
#[test]
fn a_reply_on_a_line_with_collisions_is_no_request() {
    use crate::line::faults::{Direction, FaultRule, LineFaults};
    let rule = |direction| FaultRule::ALL.direction(direction);
    let noise = |direction| LineFaults { noise: rule(direction), ..LineFaults::NONE };
    let twice = LineFaults { duplicate: rule(Direction::Reply), ..LineFaults::NONE };
    let junk: Vec<u8> = (40..70).collect();
    let (none, to_y) = (LineFaults::NONE, rtu::read(2, 0, 1));
    let mut collided = 0;
    for faults in [none, noise(Direction::Request), noise(Direction::Reply), twice] {
        for (text, wait) in (0..40).flat_map(|wait| [(&junk[..], wait), (&[][..], wait), (&to_y, wait)]) {
            let (mut bench, x, y) = ready_and(Setup { boot_fast: true, ..Setup::default() });
            let bus = bench.bus(x, Port(0)).unwrap();
            bench.set_collisions(bus, true);
            bench.set_line_faults(bus, faults);
            let [a, b] = [(); 2].map(|()| bench.connect(bus));
            bench.send(a, &rtu::read(1, 0, 1));
            bench.run_until(bench.now() + Duration::millis(wait));
            bench.send(b, text);
            bench.run_until(bench.now() + Duration::millis(300));
            let all: Vec<_> = [x, y].into_iter().flat_map(|drive| words(&bench, drive)).collect();
            assert!(
                !all.iter().any(|words| words.contains("nobody here")),
                "{faults:?} {wait} {text:?}: {all:#?}"
            );
            let is_asked = |message: &crate::bench::ReceivedMessage| {
                message.bytes.windows(text.len().max(1)).any(|part| part == text)
            };
            let requests = [x, y].map(|drive| bench.received(drive).messages().filter(is_asked).count());
            if !text.is_empty() {
                assert!(requests != [0, 0], "{faults:?} {wait} {text:02X?}: {all:#?}");
            }
            let has = |what: &str| all.iter().any(|words| words.contains(what));
            if has("had noise beside it") && !has("collision") {
                let noises = all.iter().filter(|words| words.ends_with("the request was noise")).count();
                // Each is in the lists of both drives.
                assert!(noises >= 2, "{faults:?} {wait} {text:02X?}: {all:#?}");
            }
            collided += usize::from(has("collision"));
        }
    }
    assert!(collided > 50, "{collided}");
}

/// On a line with collisions an outcome may become known later than that of a message that ended after it. Whoever asks
/// with the newest end that it has seen misses nothing.
#[test]
fn asking_since_the_newest_end_misses_nothing() {
    let mut back = 0;
    for wait in 0..60 {
        let (mut bench, x, y) = ready_and(Setup { boot_fast: true, ..Setup::default() });
        let bus = bench.bus(x, Port(0)).unwrap();
        bench.set_collisions(bus, true);
        let delay = Duration::millis(60);
        bench.set_line_faults(
            bus,
            crate::line::faults::LineFaults { delay, ..crate::line::faults::LineFaults::NONE },
        );
        let [a, b, c, d] = [(); 4].map(|()| bench.connect(bus));
        let (mut newest, mut seen) = (Instant::ZERO, Vec::new());
        for step in 0..300 {
            match step - wait {
                _ if step == 0 => bench.send(a, &rtu::read(1, 0, 1)),
                0 => [b, c].into_iter().for_each(|client| bench.send(client, &rtu::read(2, 0, 1))),
                20 => bench.send(d, &rtu::read(2, 0, 1)),
                _ => {}
            }
            bench.run_until(bench.now() + Duration::millis(1));
            for message in bench.received(y).since(newest).messages() {
                newest = newest.max(message.at);
                if !seen.contains(&message.number) {
                    seen.push(message.number);
                }
            }
        }
        let all: Vec<_> = bench.received(y).messages().collect();
        assert_eq!(seen, all.iter().map(|message| message.number).collect::<Vec<_>>(), "{wait}");
        back += usize::from(!all.is_sorted_by_key(|message| message.at));
    }
    assert!(back > 10, "{back}");
}

/// After a truncated request the drive takes the next one for its rest: that one has an entry, and so have the bytes at
/// which the stream is no longer Modbus/TCP.
#[test]
fn what_a_broken_stream_takes_has_an_entry() {
    use crate::line::faults::{Direction, FaultRule, LineFaults};
    let (mut executed, mut other) = (0, 0);
    for seed in 0..20 {
        let mut bench = Bench::with(Settings { seed, ..Settings::default() });
        let (drive, mcode) = mcode(&mut bench);
        let modbus = Port(1 - mcode);
        let truncate = FaultRule::next(1).direction(Direction::Request);
        bench.set_faults(bench.outlet(drive, modbus), LineFaults { truncate, ..LineFaults::NONE });
        let client = bench.connect_to(drive, modbus).unwrap();
        let frame = |transaction, pdu: &[u8]| tcp::frame(tcp::Header { transaction, unit: 255 }, pdu);
        let write = frame(1, &[16, 0, 0x46, 0, 2, 4, 0, 0, 0, 5]);
        for request in [&write, &frame(2, &[3, 0, 0x57, 0, 2]), &frame(3, &[3, 0, 0x57, 0, 2])] {
            bench.send(client, request);
            bench.run_until_idle();
        }
        let words = words(&bench, drive);
        let lost = "lost; by a fault, the request was";
        assert_eq!(
            words[..2],
            [
                format!("modbus <- write MR = 5 -> {lost} truncated"),
                format!("modbus <- read P -> {lost} taken for the rest of the one before"),
            ],
            "{seed}"
        );
        let is_broken = bench.ended(client).is_some();
        let broken = words.iter().filter(|words| words.ends_with("; the connection is closed")).count();
        assert_eq!(broken, usize::from(is_broken), "{seed}: {words:#?}");
        // The drive has executed what the truncated request and the beginning of the next one are together.
        let done = words.iter().filter(|words| words.contains("-> done")).count();
        (executed, other) = (executed + done, other + usize::from(is_broken));
    }
    assert!(executed > 3 && other > 10, "{executed}, {other}");
}

/// What a client leaves incomplete is no message; its entry says so.
#[test]
fn a_client_that_disconnects_inside_a_message_has_an_entry() {
    let left = "the client disconnected before the end of the message";
    let mut bench = Bench::new();
    let (drive, mcode) = mcode(&mut bench);
    let request = tcp::frame(tcp::Header { transaction: 7, unit: 255 }, &[3, 0, 0x57, 0, 2]);
    for (port, text) in [
        (1 - mcode, &request[..9]),
        (1 - mcode, &[&request[..], &request[..3]].concat()),
        (mcode, b"PR"),
        (mcode, b"PR VM\rS"),
        (mcode, b"PR VM\r\n"),
        (mcode, b"\r\n"),
        (1 - mcode, &request),
        (mcode, b""),
    ] {
        say(&mut bench, drive, port, text);
    }
    let other = bench.connect_to(drive, Port(mcode)).unwrap();
    let client = bench.connect_to(drive, Port(mcode)).unwrap();
    for (client, text) in [(client, b"PR "), (other, b"MR ")] {
        bench.send(client, text);
        bench.run_until_idle();
    }
    bench.disconnect(client);
    bench.run_until_idle();
    bench.send(other, b"5\r");
    bench.run_until_idle();
    let (read, vm) = ("modbus <- read P -> P = 0", "mcode <- PR VM -> 768000");
    let expected = [
        format!("modbus <- 9 bytes 00 07 00 00 00 06 FF 03 00 -> {left}"),
        read.to_owned(),
        format!("modbus <- 3 bytes 00 07 00 -> {left}"),
        format!("mcode <- PR -> {left}"),
        vm.to_owned(),
        format!("mcode <- S -> {left}"),
        vm.to_owned(),
        read.to_owned(),
        format!("mcode <- PR -> {left}"),
        "mcode <- MR 5 -> done".to_owned(),
    ];
    assert_eq!(words(&bench, drive), expected);
    let verdict = bench.received(drive).messages().next().unwrap().exchange.verdict;
    assert_eq!(verdict, Verdict::BadFrame);
    assert!(!bench.received(drive).counts().registers.contains_key("S"));

    let (mut bench, x, _) = ready_and(Setup { boot_fast: true, ..Setup::default() });
    let bus = bench.bus(x, Port(0)).unwrap();
    let client = bench.connect(bus);
    bench.send(client, &rtu::read(1, 0, 1)[..5]);
    bench.disconnect(client);
    bench.run_until(bench.now() + Duration::millis(50));
    assert_eq!(words(&bench, x), [format!("rs485 <- 5 bytes 01 03 00 00 00 -> {left}")]);
    assert_eq!(bench.ask(x, &rtu::read(1, 0, 1)).len(), 7);
    assert_eq!(words(&bench, x)[1..], ["rs485 <- read DeviceAddress -> DeviceAddress = 1"]);
}
