//! The board's USB device, as a computer at the other end of the cable sees it. Most tests use the image `usb-echo`, whose
//! ports send back what they receive.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use drivetwin_protocol::modbus::rtu;
use drivetwin_tests::md3::at;

use crate::motion::expect_every_pulse;
use crate::play::{MS, Nanos, OutputRecord, Run, Script, US};
use crate::{START, TURN, image, image_of, value};

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

fn echo() -> PathBuf {
    image_of("usb-echo")
}

/// A script of a computer that is there from the start, and opens both ports at [`READY`].
fn opened() -> Script {
    let mut script = Script::fast();
    script.at(0, "usb plug");
    open(&mut script, READY);
    script
}

fn open(script: &mut Script, at: Nanos) {
    script.at(at, "usb open bus");
    script.at(at, "usb open control");
}

/// Bytes that are not easily taken for others.
fn bytes(count: usize) -> Vec<u8> {
    (0..count).map(|n| (n * 7 + n / 251) as u8).collect()
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
        run.seen(READY, READY + 30 * MS),
        ["line 9600 8E1", "line 4294967295 5M1.5", "line 0 8N1"],
        "settings that no UART has are kept for the computer, too"
    );
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn whatever_a_port_gets_comes_back_whole_and_from_this_port() {
    let mut script = opened();
    let (long, short) = (bytes(5_000), [0x55; 63]);
    script.send(READY + MS, "bus", &long);
    script.send(READY + 2 * MS, "control", &short);
    let end = READY + 40 * MS;
    let run = script.play(&echo(), end);
    assert_eq!(run.got("bus", READY, end), long);
    assert_eq!(run.got("control", READY, end), short);
    let last = run.usb.last().map_or(0, |(at, _)| *at);
    println!("5,000 bytes there and back in {} µs", (last - READY - MS) / US);
    assert!(last < READY + 30 * MS, "the last byte came at {last} ns");
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn what_a_closed_port_would_send_is_dropped_and_nothing_of_it_comes_later() {
    let mut script = Script::fast();
    script.at(0, "usb plug");
    script.send(READY, "bus", &[1; 200]);
    script.at(READY + 10 * MS, "usb open bus");
    script.send(READY + 20 * MS, "bus", &bytes(3_000));
    // A packet waits for the computer at this instant, and more wait behind it.
    script.at(READY + 22 * MS, "usb close bus");
    script.at(READY + 60 * MS, "usb open bus");
    script.send(READY + 70 * MS, "bus", &[2, 3]);
    let end = READY + 80 * MS;
    let run = script.play(&echo(), end);
    assert!(run.got("bus", 0, READY + 20 * MS).is_empty());
    let before = run.got("bus", READY + 20 * MS, READY + 60 * MS);
    assert!((100..3_000).contains(&before.len()), "{} bytes", before.len());
    assert_eq!(before, bytes(before.len()));
    assert_eq!(run.got("bus", READY + 60 * MS, end), [2, 3]);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn senseless_requests_change_nothing() {
    let mut script = opened();
    script.at(READY, "usb line 19200 7O2");
    script.at(READY + 10 * MS, "usb garbage");
    script.send(READY + 10 * MS, "bus", &[1, 2, 3]);
    script.at(READY + 30 * MS, "usb garbage");
    script.send(READY + 40 * MS, "control", &bytes(500));
    let end = READY + 60 * MS;
    let run = script.play(&echo(), end);
    let answers: Vec<_> =
        run.seen(READY + 10 * MS, end).into_iter().filter(|what| what.contains(':')).collect();
    assert_eq!(answers.len(), 2 * 17, "every request is answered: {answers:?}");
    let refused = answers.iter().filter(|what| what.ends_with("refused")).count();
    assert_eq!(refused, 2 * 13, "{answers:?}");
    assert_eq!(run.got("bus", READY, end), [1, 2, 3]);
    assert_eq!(run.got("control", READY, end), bytes(500));
    assert_eq!(configured(&run).len(), 1);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn the_numbers_of_packets_begin_again_when_a_halt_is_ended() {
    // After an odd and an even number of packets, and while a packet waits for a port that is closed.
    let mut script = opened();
    let mut sent = Vec::new();
    for n in 0..4 {
        let at = READY + n * 10 * MS;
        script.send(at + MS, "bus", &[n as u8; 10]);
        sent.extend([n as u8; 10]);
        script.at(at + 5 * MS, "usb clear bus");
    }
    script.at(READY + 50 * MS, "usb close bus");
    script.at(READY + 51 * MS, "usb clear bus");
    script.at(READY + 60 * MS, "usb open bus");
    script.send(READY + 61 * MS, "bus", &bytes(1_000));
    sent.extend(bytes(1_000));
    let end = READY + 80 * MS;
    let run = script.play(&echo(), end);
    assert_eq!(run.got("bus", READY, end), sent);
    assert!(!run.usb.iter().any(|(_, what)| what.contains("refused")), "{:?}", run.usb);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_cable_that_is_pulled_in_the_middle_of_anything_leaves_a_clean_device() {
    // In the middle of transfers of the ports, at several instants of a packet; and in the middle of requests.
    for (n, pulled) in (0..).zip([0, 7, 20, 33, 50, 64, 80, 1_300]) {
        let mut script = opened();
        let pulled = READY + 5 * MS + pulled * US;
        script.send(READY + 4 * MS, "bus", &bytes(4_000));
        script.send(READY + 4 * MS, "control", &bytes(4_000));
        if n % 2 == 1 {
            script.at(READY + 5 * MS, "usb garbage");
        }
        script.at(pulled, "usb unplug");
        let again = pulled + 20 * MS + READY;
        script.at(pulled + 20 * MS, "usb plug");
        open(&mut script, again);
        script.send(again + MS, "bus", &bytes(300));
        script.send(again + MS, "control", &bytes(200));
        let end = again + 10 * MS;
        let run = script.play(&echo(), end);
        let before = run.got("bus", 0, pulled);
        assert_eq!(before, bytes(before.len()));
        assert_eq!(run.seen(pulled, again), LEARNS, "pulled at {pulled}");
        assert_eq!(run.got("bus", again, end), bytes(300), "pulled at {pulled}");
        assert_eq!(run.got("control", again, end), bytes(200), "pulled at {pulled}");
    }
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_reset_of_the_bus_in_the_middle_of_transfers_leaves_a_clean_device() {
    for reset in [0, 7, 20, 33, 50, 64, 80, 1_300] {
        let mut script = opened();
        let reset = READY + 5 * MS + reset * US;
        script.send(READY + 4 * MS, "bus", &bytes(4_000));
        script.at(reset, "usb reset");
        let again = reset + READY;
        open(&mut script, again);
        script.send(again + MS, "bus", &bytes(300));
        let end = again + 10 * MS;
        let run = script.play(&echo(), end);
        assert_eq!(run.seen(reset, again), LEARNS, "reset at {reset}");
        assert_eq!(run.got("bus", again, end), bytes(300), "reset at {reset}");
    }
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn a_computer_that_sleeps_finds_everything_as_it_was() {
    let mut script = opened();
    script.send(READY + 4 * MS, "bus", &bytes(4_000));
    script.at(READY + 5 * MS, "usb suspend");
    script.at(READY + 500 * MS, "usb resume");
    let end = READY + 600 * MS;
    let run = script.play(&echo(), end);
    assert!(run.got("bus", READY + 6 * MS, READY + 500 * MS).is_empty());
    assert_eq!(run.got("bus", READY, end), bytes(4_000));
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
    script.send(READY + MS, "bus", &bytes(20_000));
    script.hear(READY + 10 * MS, &rtu::write(1, at::EEPROM, 1));
    let end = READY + 300 * MS;
    let run = script.play(&echo(), end);
    assert!(run.did.iter().any(|(_, did)| matches!(did, OutputRecord::Programmed(..))), "it saves");
    assert_eq!(run.got("bus", READY, end), bytes(20_000));
    assert_eq!(run.sent(READY + 10 * MS, READY + 10 * MS + TURN).1, rtu::write(1, at::EEPROM, 1).as_slice());
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn ports_at_full_load_delay_no_pulse() {
    // 280 bytes to each port in each frame, and back: 20 packets of the 19 that a frame has room for.
    let busy = |script: &mut Script, from: Nanos, to: Nanos| {
        for at in (from..to).step_by(MS as usize) {
            script.send(at + US, "bus", &[0x5A; 280]);
            script.send(at + US, "control", &[0xA5; 280]);
        }
    };
    expect_every_pulse(&echo(), opened(), READY + 20 * MS, busy);
}

#[test]
#[ignore = "needs the emulator and the image of the board: `cargo xtask test` brings both"]
fn serve_has_both_ports_on_tcp() {
    /// Longest time in which this machine gets an answer from the board.
    const PATIENCE: Option<Duration> = Some(Duration::from_secs(60));
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("pico/serve.mjs");
    let mut serve = Command::new("node");
    serve.arg(program).arg(echo()).arg("--usb").stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut serve = serve.spawn().expect("node starts");
    let mut lines = BufReader::new(serve.stdout.take().expect("it is piped")).lines();
    let mut line = || lines.next().expect("a line").expect("text");
    assert!(line().starts_with("pico: usb-echo on 127.0.0.1:"));
    let line = line();
    let ports = line.strip_prefix("pico: usb E661A4D4172F8B2C: bus rfc2217://");
    let (bus, control) = ports.and_then(|ports| ports.split_once(", control ")).expect("two addresses");

    let mut control = TcpStream::connect(control).expect("it listens");
    control.set_read_timeout(PATIENCE).expect("a time");
    control.write_all(&bytes(1_000)).expect("it reads");
    let mut got = vec![0; 1_000];
    control.read_exact(&mut got).expect("an echo");
    assert_eq!(got, bytes(1_000));

    let mut bus = TcpStream::connect(bus).expect("it listens");
    bus.set_read_timeout(PATIENCE).expect("a time");
    // IAC DO COM-PORT-OPTION is among what the server says first; SET-BAUDRATE has an answer (RFC 2217, 3).
    let mut first = [0; 18];
    bus.read_exact(&mut first).expect("options");
    assert_eq!(first[15..], [255, 253, 44]);
    bus.write_all(&[255, 250, 44, 1, 0, 0, 0x25, 0x80, 255, 240]).expect("it reads");
    let mut answer = [0; 10];
    bus.read_exact(&mut answer).expect("an answer");
    assert_eq!(answer, [255, 250, 44, 101, 0, 0, 0x25, 0x80, 255, 240]);
    bus.write_all(&[1, 255, 255, 2]).expect("it reads");
    let mut echo = [0; 4];
    bus.read_exact(&mut echo).expect("an echo");
    assert_eq!(echo, [1, 255, 255, 2], "255 is doubled both ways");

    drop(serve.stdin.take());
    assert!(serve.wait().expect("node ends").success());
}
