//! Line faults as masters of an MD3, a QSB and an RS see them, and power failures during saves. Frames are
//! typed from the manuals. Results are reproducible and independent of the order in which the drives were
//! added.
#![allow(missing_docs, reason = "a test")]

use drivetwin_firmware::device::{Device, Framing, Port};
use drivetwin_firmware::md3::Md3;
use drivetwin_firmware::qsb::Qsb;
use drivetwin_firmware::rs434::Rs434;
use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::{Duration, Instant, Span};
use drivetwin_sim::bench::{Bench, Client, DriveId, Ended, PowerAction, Settings, Setup};
use drivetwin_sim::line::LineMode;
use drivetwin_sim::line::faults::{Direction, FaultRule, LineFaults};
use drivetwin_sim::record::capture::{Frame, Medium, Source};
use drivetwin_sim::record::trace::{Retention, Trace};
use drivetwin_sim::{catalog, replay};
use drivetwin_tests::{md3, rs434};

/// Time until all drives have started. An RS takes half a second (RS434-9).
const READY: Duration = Duration::secs(1);

const PORT: Port = Port(0);
const QUIET: LineFaults = LineFaults::NONE;

fn settings(seed: u64, line: LineMode) -> Settings {
    Settings { seed, line, trace: Retention::All, capture: Retention::All, ..Settings::default() }
}

/// Adds a drive without a start-up delay and presets registers by their names.
fn seat(bench: &mut Bench, name: &str, device: Box<dyn Device>, presets: &[(&str, i64)]) -> DriveId {
    let row = |name| device.spec().find(name).expect("a register").row;
    let presets = presets.iter().map(|&(name, value)| (row(name), value)).collect();
    bench.add_with(name, device, Setup { boot_fast: true, presets, ..Setup::default() }).expect("a seat")
}

/// A drive that has started, and a client on its line.
fn ready(line: LineMode, device: Box<dyn Device>, presets: &[(&str, i64)]) -> (Bench, DriveId, Client) {
    let mut bench = Bench::with(settings(1, line));
    let seat = seat(&mut bench, "x", device, presets);
    let client = bench.connect(bench.bus(seat, PORT).expect("a line"));
    bench.run_until(READY);
    hear(&mut bench, client);
    (bench, seat, client)
}

fn hear(bench: &mut Bench, client: Client) -> String {
    let mut bytes = Vec::new();
    bench.receive(client, &mut bytes);
    bytes.escape_ascii().to_string()
}

/// Sends a request and returns everything that arrived when the bench is idle.
fn ask(bench: &mut Bench, client: Client, request: &[u8]) -> String {
    bench.send(client, request);
    bench.run_until_idle();
    hear(bench, client)
}

fn set_line_faults(bench: &mut Bench, seat: DriveId, faults: LineFaults) {
    bench.set_line_faults(bench.bus(seat, PORT).expect("a line"), faults);
}

/// An RS that uses ASCII: TYPE_MODBUS 1 is 7E1, BITRATE_MODBUS 4 is 9,600 (6.4).
fn rs_ascii() -> (Bench, DriveId, Client) {
    ready(LineMode::Timed, Box::new(Rs434::rs434544()), &[("TYPE_MODBUS", 1), ("BITRATE_MODBUS", 4)])
}

/// Request for SPEED, and the reply, 1,000. LRC: 01 + 03 + 50 + 0B + 00 + 01 = 60h, and 60h + A0h = 100h.
const SPEED: &[u8] = b":0103500B0001A0\r\n";
const IS_1000: &str = r":01030203E80F\r\n";
/// Duration of a character at 9,600 baud 7E1, which has 10 bits.
const CHARACTER: Duration = Duration::from_ticks(16_667);

#[test]
fn ascii_messages_are_disturbed_with_good_sums() {
    let (mut bench, x, client) = rs_ascii();
    assert_eq!(ask(&mut bench, client, SPEED), IS_1000);
    for (faults, heard) in [
        (LineFaults { drop: FaultRule::rate(1.0), ..QUIET }, ""),
        (LineFaults { mute: FaultRule::ALL, ..QUIET }, ""),
        // 02 + 03 + 02 + 03 + E8 = F2h, and F2h + 0Eh = 100h.
        (LineFaults { wrong_address: FaultRule::rate(1.0), ..QUIET }, r":02030203E80E\r\n"),
        // 01 + 83 + 06 = 8Ah, and 8Ah + 76h = 100h.
        (LineFaults { exception: FaultRule::rate(1.0), exception_code: 6, ..QUIET }, r":01830676\r\n"),
    ] {
        set_line_faults(&mut bench, x, faults);
        assert_eq!(ask(&mut bench, client, SPEED), heard, "{faults:?}");
    }
    set_line_faults(&mut bench, x, LineFaults { duplicate: FaultRule::rate(1.0), ..QUIET });
    assert_eq!(ask(&mut bench, client, SPEED), IS_1000.repeat(4));
    set_line_faults(&mut bench, x, QUIET);
    assert_eq!(ask(&mut bench, client, SPEED), IS_1000);
}

/// An ASCII message ends with its LF, and the drive answers at once (RS434-4), without a silence or a frame
/// timeout.
#[test]
fn times_on_an_ascii_line() {
    let (mut bench, x, client) = rs_ascii();
    let delay = Duration::millis(30);
    set_line_faults(&mut bench, x, LineFaults { delay, duplicate: FaultRule::rate(1.0), ..QUIET });
    let (start, seen) = (bench.now(), bench.capture().seen());
    ask(&mut bench, client, SPEED);
    let (asked, answer) = (CHARACTER * 17, CHARACTER * 15);
    let answered = [asked + delay, asked + delay + answer];
    let again = asked + delay + answer * 2;
    let times: Vec<Duration> = bench.capture().since(seen).map(|frame| frame.at.since(start)).collect();
    assert_eq!(
        times,
        [Duration::ZERO, answered[0], answered[1], again, again + answered[0], again + answered[1]]
    );
    assert_eq!(bench.now().since(start), again * 2);
}

/// After a collision, characters on a line with 7 data bits still have 7 bits.
#[test]
fn collided_characters_have_the_data_bits_of_the_line() {
    let mut bench = Bench::with(settings(1, LineMode::Timed));
    let ascii = [("TYPE_MODBUS", 1), ("BITRATE_MODBUS", 4)];
    let seats = ["x", "y"].map(|name| (seat(&mut bench, name, Box::new(Rs434::rs434544()), &ascii), PORT));
    let bus = bench.share("line1", &seats);
    bench.set_collisions(bus, true);
    let client = bench.connect(bus);
    bench.run_until(READY);
    bench.send(client, SPEED);
    bench.run_until_idle();
    let mut heard = Vec::new();
    bench.receive(client, &mut heard);
    let alone = b":01030203E80F\r\n";
    assert_eq!(heard.len(), alone.len() * 2);
    for (heard, sent) in heard.chunks(2).zip(alone) {
        assert!(heard.iter().all(|heard| heard != sent && *heard < 0x80), "{heard:02X?}");
    }
}

/// "A character of wrong parity sets bit 14" (RS434-5), on the RS's factory line of 115,200 8E1.
#[test]
fn an_rs_finds_a_wrong_parity() {
    let (mut bench, x, client) = ready(LineMode::Timed, Box::new(Rs434::rs434544()), &[]);
    let read_error = |bench: &mut Bench| {
        set_line_faults(bench, x, QUIET);
        let request = [&[1, 3], &rs434::at::ERROR.to_be_bytes()[..], &[0, 1]].concat();
        let reply = bench.ask(x, &rtu::frame(1, &request[1..]));
        u16::from_be_bytes([reply[3], reply[4]])
    };
    assert_eq!(read_error(&mut bench), 0);
    hear(&mut bench, client);
    set_line_faults(&mut bench, x, LineFaults { corrupt: FaultRule::rate(1.0), ..QUIET });
    assert_eq!(ask(&mut bench, client, &rtu::read(1, rs434::at::SPEED, 1)), "");
    assert_eq!(read_error(&mut bench), 1 << 14);
}

#[test]
fn commands_of_a_qsb_are_disturbed_as_they_were_written() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let (mut bench, x, client) = ready(line, Box::new(Qsb::d()), &[]);
        // Command list, register 07: its example.
        let answer = r"r 07 00000000 !\r\n";
        assert_eq!(ask(&mut bench, client, b"R07\r"), answer);
        set_line_faults(&mut bench, x, LineFaults { drop: FaultRule::rate(1.0), ..QUIET });
        assert_eq!(ask(&mut bench, client, b"R07\r"), "");
        set_line_faults(&mut bench, x, LineFaults { mute: FaultRule::ALL, ..QUIET });
        assert_eq!(ask(&mut bench, client, b"W0363\r"), "");
        set_line_faults(&mut bench, x, LineFaults { duplicate: FaultRule::rate(1.0), ..QUIET });
        assert_eq!(ask(&mut bench, client, b"R03\r"), r"r 03 00000063 !\r\n".repeat(4), "it was carried out");
        let delay = Duration::millis(250);
        set_line_faults(&mut bench, x, LineFaults { delay, ..QUIET });
        let before = bench.now();
        assert_eq!(ask(&mut bench, client, b"R07\r"), answer);
        assert!(bench.now() >= before + delay && bench.now() < before + delay + 20.millis());
        set_line_faults(&mut bench, x, LineFaults { baud: Some(9_600), ..QUIET });
        assert_eq!(ask(&mut bench, client, b"R07\r"), "", "its line is 230,400 baud");
        set_line_faults(&mut bench, x, LineFaults { truncate: FaultRule::rate(1.0), ..QUIET });
        bench.send(client, b"\r");
        bench.run_until_idle();
        hear(&mut bench, client);
        // A truncated command has no CR, so it is not yet a command. A truncated answer has no end.
        assert_eq!(ask(&mut bench, client, b"R07\r"), "");
        set_line_faults(&mut bench, x, QUIET);
    }
}

#[test]
fn what_a_line_cannot_have_is_refused_in_a_sentence() {
    let forced = LineFaults { exception: FaultRule::rate(0.5), ..QUIET };
    let elsewhere = LineFaults { wrong_address: FaultRule::rate(0.5), ..QUIET };
    for device in [Box::new(Md3::new()) as Box<dyn Device>, Box::new(Rs434::rs434544()), Box::new(Qsb::s())] {
        let port = &device.spec().ports[0];
        let modbus = port.framing == Framing::Silence;
        assert_eq!(forced.check_for(port).is_ok(), modbus, "{}", device.spec().kind);
        assert_eq!(elsewhere.check_for(port).is_ok(), modbus, "{}", device.spec().kind);
    }
    let error = elsewhere.check_for(&Qsb::s().spec().ports[0]).unwrap_err();
    assert_eq!(error, "wrong_address is for Modbus lines only, and usb is not one");
}

/// MD3s a and b on one line, an RS and a QSB on their own lines, added in the given order. All lines have
/// faults, requests are repeated, and power fails during saves. Returns the traces and the captured frames as
/// text.
fn scene(seed: u64, line: LineMode, order: [usize; 4]) -> String {
    const NAMES: [&str; 4] = ["a", "b", "r", "q"];
    let mut bench = Bench::with(settings(seed, line));
    let mut seats: [Option<DriveId>; 4] = [None; 4];
    for place in order {
        let (device, address): (Box<dyn Device>, &[_]) = match place {
            0 => (Box::new(Md3::new()), &[("DeviceAddress", 1)]),
            1 => (Box::new(Md3::new()), &[("DeviceAddress", 2)]),
            2 => (Box::new(Rs434::rs434544()), &[]),
            _ => (Box::new(Qsb::m()), &[]),
        };
        seats[place] = Some(seat(&mut bench, NAMES[place], device, address));
    }
    let [a, b, r, q] = seats.map(|seat| seat.expect("all are seated"));
    let mut shared = vec![(a, PORT), (b, PORT)];
    if order[0] > order[1] {
        shared.reverse();
    }
    let bus = bench.share("line1", &shared);
    let own = |seat| bench.bus(seat, PORT).expect("a line");
    let lines = [bus, own(r), own(q)];
    let all = LineFaults {
        drop: FaultRule::rate(0.1),
        corrupt: FaultRule::rate(0.1),
        duplicate: FaultRule::rate(0.2),
        truncate: FaultRule::rate(0.1),
        noise: FaultRule::rate(0.3),
        delay: Duration::millis(2),
        ..QUIET
    };
    for bus in lines {
        let modbus = bus != lines[2];
        let share = FaultRule::rate(if modbus { 0.1 } else { 0.0 });
        bench.set_line_faults(bus, LineFaults { wrong_address: share, exception: share, ..all });
    }
    let clients = lines.map(|bus| bench.connect(bus));
    bench.run_until(READY);
    let mut heard = String::new();
    let save_md3 = |unit| rtu::write(unit, md3::at::EEPROM, 1).to_vec();
    for n in 0..60_u16 {
        // Power fails during the next save of each drive. It returns later.
        if n % 20 == 5 {
            [a, b, r].into_iter().for_each(|seat| bench.power(seat, PowerAction::Cut));
        }
        if n % 20 == 19 {
            bench.run_until(bench.now() + READY);
            [a, b, r].into_iter().for_each(|seat| bench.power(seat, PowerAction::On));
            bench.run_until(bench.now() + 10.secs());
        }
        let unit = 1 + (n % 2) as u8;
        let to_md3 =
            if n % 3 == 0 { save_md3(unit) } else { rtu::write(unit, md3::at::SPEED + 1, n).to_vec() };
        let to_rs = if n % 3 == 0 {
            rtu::write(1, rs434::at::SAVE_INI, rs434::key::SAVE)
        } else {
            rtu::write(1, rs434::at::SPEED, 100 + n)
        };
        bench.send(clients[0], &to_md3);
        bench.send(clients[1], &to_rs);
        bench.send(clients[2], format!("W09{}\rR09\r", n % 4).as_bytes());
        bench.run_until_idle();
        heard.extend(clients.map(|client| hear(&mut bench, client) + "\n"));
    }
    let seen: Vec<String> = bench
        .capture()
        .since(0)
        .map(|frame| {
            let from = match frame.from {
                Source::Drive(seat) => bench.name(seat).to_owned(),
                Source::Client => "client".to_owned(),
                Source::Noise => "noise".to_owned(),
            };
            let Frame { on: Medium::Line(bus), line: Some(line), .. } = *frame else {
                panic!("{frame:?} is on no line");
            };
            let (at, bus) = (frame.at.since(Instant::ZERO), bench.bus_name(bus));
            format!("{at:?} {bus} {from} {:?} {line} {:02X?}", frame.lasts, frame.bytes)
        })
        .collect();
    let memories = [a, b, r].map(|seat| bench.memory(seat).to_vec());
    format!("{}\n{}\n{heard}{memories:?}", bench.trace().to_text(), seen.join("\n"))
}

#[test]
fn the_same_seed_is_the_same_bench_and_the_order_of_its_drives_nothing() {
    for line in [LineMode::Timed, LineMode::Fast] {
        let first = scene(7, line, [0, 1, 2, 3]);
        assert!(first == scene(7, line, [0, 1, 2, 3]), "again");
        for order in [[3, 2, 1, 0], [1, 3, 0, 2]] {
            assert!(first == scene(7, line, order), "{order:?}");
        }
        assert!(first != scene(8, line, [0, 1, 2, 3]), "another seed");
        for word in ["power cut", "> spoiled", "power on"] {
            assert!(first.contains(word), "nothing of {word} in it");
        }
    }
}

/// A master that waits and repeats its requests gets every answer in the end.
#[test]
fn a_master_that_asks_again_gets_every_answer() {
    let faults = LineFaults {
        drop: FaultRule::rate(0.3),
        corrupt: FaultRule::rate(0.05),
        truncate: FaultRule::rate(0.05),
        noise: FaultRule::rate(0.05),
        ..QUIET
    };
    let register = |seat: &str| match seat {
        "rs" => rs434::at::SPEED,
        _ => md3::at::SPEED + 1,
    };
    for (name, device) in
        [("md3", Box::new(Md3::new()) as Box<dyn Device>), ("rs", Box::new(Rs434::rs434544()))]
    {
        let (mut bench, x, client) = ready(LineMode::Timed, device, &[]);
        set_line_faults(&mut bench, x, faults);
        let mut tries = 0;
        for value in 100..200 {
            let write = rtu::write(1, register(name), value);
            let mut reply = String::new();
            while !reply.starts_with(&write.escape_ascii().to_string()) {
                tries += 1;
                assert!(tries < 2_000, "{name} answers too seldom");
                reply = ask(&mut bench, client, &write);
                bench.run_until(bench.now() + 10.millis());
                hear(&mut bench, client);
            }
        }
        // A try succeeds if both frames get through, with 0.7·0.95·0.95 for each: 100 answers in 251
        // requests, σ = 19.4.
        assert!((173..329).contains(&tries), "{name}: {tries}");
    }
}

/// A message of a master and its answer, on each kind of port: an MD3 by RTU, an RS by ASCII, an MDrive by
/// Modbus/TCP (its velocity, FB 4.2.4), a QSB by its commands, an MDrive by MCode.
const TRANSPORTS: [(&str, &str, u8); 5] = [
    ("rtu", "md3", 0),
    ("ascii", "rs434544", 0),
    ("tcp", "mdrive", 0),
    ("commands", "qsb-d", 0),
    ("mcode", "mdrive", 1),
];

fn request(transport: &str) -> Vec<u8> {
    match transport {
        "rtu" => rtu::read(1, 0, 1).to_vec(),
        "ascii" => SPEED.to_vec(),
        "tcp" => vec![0, 1, 0, 0, 0, 6, 1, 3, 0x00, 0x8B, 0x00, 0x02],
        "commands" => b"R07\r".to_vec(),
        _ => b"PR A\r".to_vec(),
    }
}

/// The effect of a fault on one exchange.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Seen {
    /// The usual answer.
    Usual,
    /// No answer.
    Nothing,
    /// Other bytes than the usual answer.
    Other,
    /// The usual answer twice.
    Twice,
    /// The usual answer after more than 5 ms.
    Late,
    /// The end of the connection, after a part of the answer.
    Closed,
}

/// An exchange, the trace of its bench, and the journal of the drive during the fault.
struct Exchange {
    seen: Seen,
    trace: String,
    journal: String,
}

/// One exchange on a new bench with a fault.
fn seen(line: LineMode, (transport, kind, port): (&str, &str, u8), faults: LineFaults) -> Exchange {
    let mut bench = Bench::with(settings(1, line));
    let presets: &[_] = if transport == "ascii" { &[("TYPE_MODBUS", 1), ("BITRATE_MODBUS", 4)] } else { &[] };
    let x = seat(&mut bench, "x", catalog::make(kind).expect("a kind"), presets);
    bench.run_until(5.secs());
    let outlet = bench.outlet(x, Port(port));
    let connect = |bench: &mut Bench| {
        let client = bench.join(outlet).expect("a client");
        bench.run_until_idle();
        bench.run_until(bench.now() + 1.secs());
        hear(bench, client);
        client
    };
    let client = connect(&mut bench);
    let exchange = |bench: &mut Bench, client| {
        bench.send(client, &request(transport));
        bench.run_until_idle();
        bench.run_until(bench.now() + 1.millis());
        hear(bench, client)
    };
    // MCode answers some time after a line, and streams nothing on its own.
    let wait = if transport == "mcode" { 500.millis() } else { Duration::ZERO };
    let complete = |bench: &mut Bench, client| {
        let first = exchange(bench, client);
        bench.run_until(bench.now() + wait);
        first + &hear(bench, client)
    };
    let usual = complete(&mut bench, client);
    assert!(!usual.is_empty(), "{transport}");
    let port = bench.port_at(outlet).expect("a port");
    faults.check_for(port).expect("a possible fault");
    bench.set_faults(outlet, faults);
    let before = bench.now();
    let got = complete(&mut bench, client);
    let late = bench.now().since(before) > wait + 50.millis();
    let seen = match got {
        _ if bench.ended(client) == Some(Ended::ByFault) => Seen::Closed,
        got if got.is_empty() => Seen::Nothing,
        got if got == usual && late => Seen::Late,
        got if got == usual => Seen::Usual,
        got if got == usual.repeat(2) => Seen::Twice,
        _ => Seen::Other,
    };
    let messages = bench.received(x).since(before);
    let journal = messages.messages().map(|message| message.to_string() + "\n").collect();
    // Then all is as usual. A line of text that lost its end still waits for it.
    bench.set_faults(outlet, LineFaults::NONE);
    if seen == Seen::Closed {
        bench.disconnect(client);
        let client = connect(&mut bench);
        assert_eq!(complete(&mut bench, client), usual, "{transport}");
    }
    bench.run_until(bench.now() + 10.secs());
    Exchange { seen, trace: bench.trace().to_text(), journal }
}

/// Every fault of one reply on every kind of port: what the master sees, the words of the journal, and a trace
/// that replays.
#[test]
fn every_fault_on_every_transport() {
    let next = FaultRule::next(1).direction(Direction::Reply);
    let request = FaultRule::next(1).direction(Direction::Request);
    let once = FaultRule::next(1);
    let table = [
        ("none", QUIET, Seen::Usual),
        ("drop", LineFaults { drop: next, ..QUIET }, Seen::Nothing),
        ("drop a request", LineFaults { drop: request, ..QUIET }, Seen::Nothing),
        ("mute", LineFaults { mute: FaultRule::ALL, ..QUIET }, Seen::Nothing),
        ("corrupt", LineFaults { corrupt: next, ..QUIET }, Seen::Other),
        ("truncate", LineFaults { truncate: next, ..QUIET }, Seen::Other),
        ("duplicate", LineFaults { duplicate: next, ..QUIET }, Seen::Twice),
        ("noise", LineFaults { noise: next, ..QUIET }, Seen::Other),
        ("noise before", LineFaults { noise: next, noise_before: true, ..QUIET }, Seen::Other),
        ("delay", LineFaults { delay: Duration::millis(60), ..QUIET }, Seen::Late),
        ("wrong address", LineFaults { wrong_address: once, ..QUIET }, Seen::Other),
        ("exception", LineFaults { exception: once, ..QUIET }, Seen::Other),
        ("wrong transaction", LineFaults { wrong_transaction: once, ..QUIET }, Seen::Other),
        ("close", LineFaults { close: next, ..QUIET }, Seen::Closed),
        ("close a request", LineFaults { close: request, ..QUIET }, Seen::Closed),
    ];
    let make = |kind: &str| catalog::make(kind).ok();
    for transport in TRANSPORTS {
        let spec = catalog::make(transport.1).expect("a kind").spec();
        let port = &spec.ports[usize::from(transport.2)];
        for (name, faults, expected) in &table {
            if faults.check_for(port).is_err() {
                continue;
            }
            for line in [LineMode::Timed, LineMode::Fast] {
                let Exchange { seen, trace, journal } = seen(line, transport, *faults);
                assert_eq!(seen, *expected, "{name} on {transport:?}");
                // The journal says why the master saw no usual answer.
                let is_told = *name != "none";
                assert_eq!(journal.contains("by a fault"), is_told, "{name} on {transport:?}: {journal}");
                let trace = Trace::parse(&trace, &make).expect("a trace");
                assert_eq!(replay::run(&trace, &make), Ok(None), "{name} on {transport:?}");
            }
        }
    }
}
