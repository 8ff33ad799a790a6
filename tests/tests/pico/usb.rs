//! The board's USB device, as a computer at the other end of the cable sees it. Both ports answer requests: that of control
//! at once, with packets of all lengths, and that of the bus at the rate of the drive's line.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::ops::Range;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use drivetwin_control::{Answer, Call, Decoder, FRAME, Message, PIECE, Refused, Reply, Request, encode};
use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::md3::at;

use crate::motion::expect_every_pulse;
use crate::play::{MS, Nanos, OutputRecord, Run, Script, US};
use crate::{START, TURN, image, value};

/// Time from plugging in until the computer can use the ports: 100 ms of waiting, a reset of 10 ms and its recovery of
/// 10 ms (7.1.7.3 and 7.1.7.5 of USB 2.0), and some 30 requests.
const READY: Nanos = 200 * MS;

/// Description of the device, as the computer reads it.
const LEARNS: [&str; 7] = [
    "device 1209:0001",
    "manufacturer drivetwin",
    "product drivetwin",
    "serial E661A4D4172F8B2C",
    "function drivetwin bus",
    "function drivetwin control",
    "configured",
];

/// A script of a computer that is there from the start, and opens both ports at [`READY`].
fn opened() -> Script {
    let mut script = Script::fast();
    script.at(0, "usb plug");
    open(&mut script, READY);
    script
}

/// Opens both ports, with the line of the drive.
fn open(script: &mut Script, at: Nanos) {
    script.at(at, "usb line 9600 8E1");
    script.at(at, "usb open bus");
    script.at(at, "usb open control");
}

/// Requests to the port of control with these numbers: one is longer than a packet, one has a longer reply, one is short.
fn requests(numbers: Range<u16>) -> Vec<u8> {
    let calls = [
        Call::WriteMemory { offset: 0, bytes: &[0x5A; PIECE] },
        Call::ReadMemory { offset: 0 },
        Call::Kind(1),
    ];
    let request = |number| {
        let call = calls[usize::from(number) % calls.len()];
        encode(&Request { number, call }, &mut [0; FRAME]).expect("it fits").to_vec()
    };
    numbers.flat_map(request).collect()
}

/// Checks that a reply is whole, and that of the request with its number.
fn expect_reply(Reply { number, answer }: &Reply<'_>) {
    match number % 3 {
        0 => assert_eq!(*answer, Err(Refused::HasPower), "{number}"),
        1 => assert!(matches!(answer, &Ok(Answer::Memory(&[_, _, ..]))), "{number}: {answer:?}"),
        _ => assert_eq!(*answer, Ok(Answer::Kind(None)), "{number}"),
    }
}

/// Numbers of the replies from the port of control.
fn replies(run: &Run, from: Nanos, to: Nanos) -> Vec<u16> {
    let mut decoder = Decoder::new();
    let mut numbers = Vec::new();
    for byte in run.got("control ", from, to) {
        match decoder.push::<Message<'_>>(byte) {
            Some(Message::Reply(reply)) => {
                expect_reply(&reply);
                numbers.push(reply.number);
            }
            Some(message) => panic!("{message:?}"),
            None => {}
        }
    }
    numbers
}

fn all(numbers: Range<u16>) -> Vec<u16> {
    numbers.collect()
}

/// A request to the drive at the port of the bus, which has a reply of 7 characters, and its reply.
fn read() -> Vec<u8> {
    rtu::read(1, at::MOVE_STEPS + 1, 1).to_vec()
}

fn reply() -> Vec<u8> {
    rtu::frame(1, &[3, 2, 0x27, 0x10]).to_vec()
}

/// Times at which the device was configured.
fn configured(run: &Run) -> Vec<Nanos> {
    run.usb.iter().filter(|(_, what)| what == "configured").map(|(at, _)| *at).collect()
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_computer_finds_two_named_ports_and_the_number_of_the_flash() {
    let mut script = Script::fast();
    script.at(0, "usb plug");
    // Requests on the line are answered meanwhile.
    script.hear(START, &rtu::read(1, at::MOVE_STEPS + 1, 1));
    script.hear(130 * MS, &rtu::read(1, at::MOVE_STEPS + 1, 1));
    let run = script.play(&image(), READY);
    assert_eq!(run.seen(0, READY), LEARNS);
    assert_eq!(value(&run, START), 10_000);
    assert_eq!(value(&run, 130 * MS), 10_000);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_board_without_a_cable_sees_one_that_comes_late() {
    let mut script = Script::fast();
    script.at(1_000 * MS, "usb plug");
    let run = script.play(&image(), 1_000 * MS + READY);
    assert_eq!(run.seen(0, 1_000 * MS + READY), LEARNS);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn the_line_is_what_the_computer_sets() {
    let mut script = opened();
    script.at(READY + MS, "usb line 9600 8E1");
    script.at(READY + 10 * MS, "usb line 4294967295 5M1.5");
    script.at(READY + 20 * MS, "usb line 0 8N1");
    let run = script.play(&image(), READY + 30 * MS);
    assert_eq!(
        run.seen(READY + MS, READY + 30 * MS),
        ["line 9600 8E1", "line 4294967295 5M1.5", "line 0 8N1"],
        "settings that no UART has are kept for the computer, too"
    );
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn whatever_a_port_gets_arrives_whole_and_is_answered_at_this_port() {
    let mut script = opened();
    script.send(READY + MS, "control", &requests(0..300));
    script.send(READY + 2 * MS, "bus", &read());
    let end = READY + 200 * MS;
    let run = script.play(&image(), end);
    assert_eq!(replies(&run, READY, end), all(0..300));
    assert_eq!(run.got("bus ", READY, end), reply());
    let last = run.usb.iter().rfind(|(_, what)| what.starts_with("control ")).map_or(0, |(at, _)| *at);
    println!("300 requests are answered in {} µs", (last - READY - MS) / US);
    assert!(last < READY + 180 * MS, "the last reply came at {last} ns");
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn what_a_closed_port_would_send_is_dropped_and_nothing_of_it_comes_later() {
    let mut script = Script::fast();
    script.at(0, "usb plug");
    script.at(READY, "usb line 9600 8E1");
    script.send(READY + 5 * MS, "control", &requests(0..10));
    script.send(READY + 5 * MS, "bus", &read());
    script.at(READY + 40 * MS, "usb open control");
    script.send(READY + 50 * MS, "control", &requests(100..200));
    // A packet waits for the computer at this instant, and more wait behind it.
    script.at(READY + 60 * MS, "usb close control");
    script.at(READY + 200 * MS, "usb open control");
    script.at(READY + 200 * MS, "usb open bus");
    script.send(READY + 210 * MS, "control", &requests(2..4));
    script.send(READY + 210 * MS, "bus", &read());
    let end = READY + 250 * MS;
    let run = script.play(&image(), end);
    assert!(replies(&run, 0, READY + 50 * MS).is_empty());
    let before = replies(&run, READY + 50 * MS, READY + 200 * MS);
    assert!((3..100).contains(&before.len()), "{} replies", before.len());
    assert!(before.iter().copied().eq(100..100 + before.len() as u16), "{before:?}");
    assert_eq!(replies(&run, READY + 200 * MS, end), [2, 3]);
    assert_eq!(run.got("bus ", 0, end), reply(), "the first reply came while the port was closed");
    assert_eq!(run.sent(READY, end).1, [reply(), reply()].concat());
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn senseless_requests_change_nothing() {
    let mut script = opened();
    script.at(READY + 10 * MS, "usb garbage");
    script.send(READY + 10 * MS, "bus", &read());
    script.at(READY + 30 * MS, "usb garbage");
    script.send(READY + 60 * MS, "control", &requests(0..20));
    script.send(READY + 60 * MS, "bus", &read());
    let end = READY + 100 * MS;
    let run = script.play(&image(), end);
    let answers: Vec<_> =
        run.seen(READY + 10 * MS, end).into_iter().filter(|what| what.contains(':')).collect();
    assert_eq!(answers.len(), 2 * 17, "every request is answered: {answers:?}");
    let refused = answers.iter().filter(|what| what.ends_with("refused")).count();
    assert_eq!(refused, 2 * 13, "{answers:?}");
    assert_eq!(run.got("bus ", READY, end), [reply(), reply()].concat());
    assert_eq!(replies(&run, READY, end), all(0..20));
    assert_eq!(configured(&run).len(), 1);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn the_numbers_of_packets_begin_again_when_a_halt_is_ended() {
    // After an odd and an even number of packets, and while a packet waits for a port that is closed.
    let mut script = opened();
    for n in 0..4_u16 {
        let at = READY + u64::from(n) * TURN;
        script.send(at + MS, "control", &requests(n..n + 1));
        script.send(at + MS, "bus", &read());
        for port in ["control", "bus"] {
            script.at(at + 38 * MS, format_args!("usb clear {port}"));
        }
    }
    let closed = READY + 4 * TURN;
    script.send(closed, "control", &requests(4..100));
    script.at(closed + 3 * MS, "usb close control");
    script.at(closed + 4 * MS, "usb clear control");
    let again = closed + 100 * MS;
    script.at(again, "usb open control");
    script.send(again + MS, "control", &requests(1_000..1_020));
    let end = again + 40 * MS;
    let run = script.play(&image(), end);
    assert_eq!(replies(&run, READY, closed), all(0..4));
    assert_eq!(run.got("bus ", READY, closed), reply().repeat(4));
    assert_eq!(replies(&run, again, end), all(1_000..1_020));
    assert!(!run.usb.iter().any(|(_, what)| what.contains("refused")), "{:?}", run.usb);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_cable_that_is_pulled_in_the_middle_of_anything_leaves_a_clean_device() {
    // In the middle of transfers of the ports, at several instants of a packet; and in the middle of requests.
    for (n, pulled) in (0..).zip([0, 7, 20, 33, 50, 64, 80, 1_300]) {
        let mut script = opened();
        let pulled = READY + 5 * MS + pulled * US;
        script.send(READY + 4 * MS, "control", &requests(0..100));
        script.send(READY + 4 * MS, "bus", &read().repeat(20));
        if n % 2 == 1 {
            script.at(READY + 5 * MS, "usb garbage");
        }
        script.at(pulled, "usb unplug");
        let again = pulled + 20 * MS + READY;
        script.at(pulled + 20 * MS, "usb plug");
        open(&mut script, again);
        script.send(again + MS, "control", &requests(200..205));
        script.send(again + MS, "bus", &read());
        let end = again + TURN;
        let run = script.play(&image(), end);
        let before = replies(&run, 0, pulled);
        assert!(before.iter().copied().eq(0..before.len() as u16), "{before:?}");
        assert_eq!(run.seen(pulled, again), LEARNS, "pulled at {pulled}");
        assert_eq!(replies(&run, again, end), all(200..205), "pulled at {pulled}");
        assert_eq!(run.got("bus ", again, end), reply(), "pulled at {pulled}");
    }
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_reset_of_the_bus_in_the_middle_of_transfers_leaves_a_clean_device() {
    for reset in [0, 7, 20, 33, 50, 64, 80, 1_300] {
        let mut script = opened();
        let reset = READY + 5 * MS + reset * US;
        script.send(READY + 4 * MS, "control", &requests(0..100));
        script.at(reset, "usb reset");
        let again = reset + READY;
        open(&mut script, again);
        script.send(again + MS, "control", &requests(200..205));
        let end = again + 10 * MS;
        let run = script.play(&image(), end);
        assert_eq!(run.seen(reset, again), LEARNS, "reset at {reset}");
        assert_eq!(replies(&run, again, end), all(200..205), "reset at {reset}");
    }
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_computer_that_sleeps_finds_the_device_as_it_was() {
    let mut script = opened();
    script.send(READY + 4 * MS, "control", &requests(0..100));
    script.at(READY + 5 * MS, "usb suspend");
    script.at(READY + 500 * MS, "usb resume");
    let woken = READY + 600 * MS;
    script.send(woken, "control", &requests(100..110));
    script.send(woken, "bus", &read());
    let end = woken + TURN;
    let run = script.play(&image(), end);
    assert!(replies(&run, READY + 6 * MS, READY + 500 * MS).is_empty());
    // While the computer sleeps, no port is open: what was under way then is dropped, and the others follow.
    let numbers = replies(&run, READY, woken);
    let missing = (0..100).filter(|number| !numbers.contains(number)).count();
    println!("{missing} of 100 replies are dropped");
    assert!(numbers.is_sorted() && missing <= 3, "{numbers:?}");
    assert_eq!(replies(&run, woken, end), all(100..110));
    assert_eq!(run.got("bus ", woken, end), reply(), "the line is that which the computer has set");
    assert_eq!(configured(&run).len(), 1);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_board_that_starts_again_is_configured_again() {
    let mut script = opened();
    script.at(READY + 100 * MS, "hang");
    let end = 2_000 * MS;
    let run = script.play(&image(), end);
    let reset = run.did.iter().find(|(_, did)| *did == OutputRecord::Watchdog).expect("the watchdog").0;
    let [_, again] = configured(&run)[..] else { panic!("{:?}", run.usb) };
    assert!(again - reset < 250 * MS, "reset at {reset}, configured at {again}");
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_save_while_a_port_is_busy_delays_the_port_and_loses_nothing() {
    let mut script = opened();
    script.send(READY + MS, "control", &requests(0..300));
    script.hear(READY + 10 * MS, &rtu::write(1, at::EEPROM, 1));
    let end = READY + 400 * MS;
    let run = script.play(&image(), end);
    assert!(run.did.iter().any(|(_, did)| matches!(did, OutputRecord::Programmed(..))), "it saves");
    assert_eq!(replies(&run, READY, end), all(0..300));
    assert_eq!(run.sent(READY + 10 * MS, READY + 10 * MS + TURN).1, rtu::write(1, at::EEPROM, 1).as_slice());
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn more_than_the_ports_can_take_delays_no_pulse() {
    // More requests than the board can answer, and characters of a line without settings, which reach no drive.
    let busy = |script: &mut Script, from: Nanos, to: Nanos| {
        for at in (from..to).step_by(MS as usize) {
            script.send(at + US, "bus", &[0x5A; 280]);
            script.send(at + US, "control", &requests(0..6));
        }
    };
    let mut script = opened();
    script.at(READY + MS, "usb line 0 8N1");
    expect_every_pulse(&image(), script, READY + 20 * MS, busy);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn serve_has_both_ports_on_tcp() {
    /// Longest time in which this machine gets an answer from the board.
    const PATIENCE: Option<Duration> = Some(Duration::from_secs(60));
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("pico/serve.mjs");
    let mut serve = Command::new("node");
    serve.arg(program).arg(image()).arg("--usb").stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut serve = serve.spawn().expect("node starts");
    let mut lines = BufReader::new(serve.stdout.take().expect("it is piped")).lines();
    let mut line = || lines.next().expect("a line").expect("text");
    assert!(line().starts_with("pico: md3 on 127.0.0.1:"));
    let line = line();
    let ports = line.strip_prefix("pico: usb E661A4D4172F8B2C: bus rfc2217://");
    let (bus, control) = ports.and_then(|ports| ports.split_once(", control ")).expect("two addresses");
    let connect = |address: &str| {
        let stream = TcpStream::connect(address).expect("it listens");
        stream.set_read_timeout(PATIENCE).expect("a time");
        stream
    };

    let mut control = connect(control);
    control.write_all(&requests(0..30)).expect("it reads");
    let (mut decoder, mut next) = (Decoder::new(), 0);
    while next < 30 {
        let mut byte = [0];
        control.read_exact(&mut byte).expect("a reply");
        let Some(Message::Reply(reply)) = decoder.push(byte[0]) else { continue };
        expect_reply(&reply);
        assert_eq!(reply.number, next);
        next += 1;
    }
    let mut bus = connect(bus);
    // IAC DO COM-PORT-OPTION is among what the server says first; SET-BAUDRATE has an answer (RFC 2217, 3).
    let mut first = [0; 18];
    bus.read_exact(&mut first).expect("options");
    assert_eq!(first[15..], [255, 253, 44]);
    for (set, answer) in [
        (
            &[255, 250, 44, 1, 0, 0, 0x25, 0x80, 255, 240][..],
            &[255, 250, 44, 101, 0, 0, 0x25, 0x80, 255, 240][..],
        ),
        (&[255, 250, 44, 3, 3, 255, 240], &[255, 250, 44, 103, 3, 255, 240]),
    ] {
        bus.write_all(set).expect("it reads");
        let mut got = vec![0; answer.len()];
        bus.read_exact(&mut got).expect("an answer");
        assert_eq!(got, answer);
    }
    // 255 is doubled both ways.
    let plain = rtu::write(1, at::USER, 0xFF07);
    let doubled: Vec<u8> =
        plain.iter().flat_map(|byte| vec![*byte; if *byte == 255 { 2 } else { 1 }]).collect();
    assert_eq!(doubled.len(), 9);
    // The drive answers when its start-up is over.
    bus.set_read_timeout(Some(Duration::from_millis(500))).expect("a time");
    let mut got = Vec::new();
    for _ in 0..120 {
        bus.write_all(&doubled).expect("it reads");
        let mut bytes = [0; 64];
        while let Ok(count @ 1..) = bus.read(&mut bytes) {
            got.extend(&bytes[..count]);
        }
        if !got.is_empty() {
            break;
        }
    }
    assert!(got.starts_with(&doubled), "{got:?}");

    drop(serve.stdin.take());
    assert!(serve.wait().expect("node ends").success());
}
