//! Drives on serial ports, and on standard input and output.

use std::io::{Read as _, Write as _};
use std::os::fd::OwnedFd;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::running::{Running, Scratch, refused, spawn};
use drivetwin_protocol::modbus::rtu;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::pty::OpenptFlags;
use rustix::termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr};

const USER_REGISTER: u16 = 0x1D;
const SERIAL_PORT_CONFIGURATION: u16 = 0x1C;

/// The other end of a serial cable: a new pty whose device is linked at `link`.
fn cable(link: &str) -> OwnedFd {
    let master = rustix::pty::openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    rustix::pty::grantpt(&master).unwrap();
    rustix::pty::unlockpt(&master).unwrap();
    // A new terminal echoes its input. A serial port does not.
    let mut settings = tcgetattr(&master).unwrap();
    settings.make_raw();
    tcsetattr(&master, OptionalActions::Now, &settings).unwrap();
    let path = rustix::pty::ptsname(&master, Vec::new()).unwrap();
    let _ = std::fs::remove_file(link);
    std::os::unix::fs::symlink(path.to_str().unwrap(), link).unwrap();
    master
}

/// Bytes that arrive on a cable within `patience`, up to `count`.
fn heard(cable: &OwnedFd, count: usize, patience: Duration) -> Vec<u8> {
    let mut bytes = Vec::new();
    let timeout = Timespec::try_from(patience).unwrap();
    while bytes.len() < count && poll(&mut [PollFd::new(cable, PollFlags::IN)], Some(&timeout)).unwrap() > 0 {
        let mut buffer = [0; 256];
        match rustix::io::read(cable, &mut buffer) {
            Ok(got) if got > 0 => bytes.extend(&buffer[..got]),
            _ => break,
        }
    }
    bytes
}

const LONG: Duration = Duration::from_secs(30);

#[test]
fn a_serial_port_has_the_settings_of_its_line_and_is_used_again_when_it_is_back() {
    let scratch = Scratch::new("serial");
    let device = scratch.file("ttyUSB0");
    let listen = format!("serial:{device}");
    let plugged = cable(&device);
    let options =
        ["--time", "manual", "--fast-boot", "--set", "SerialPortConfiguration=0x2A", "--listen", &listen];
    let md3 = Running::md3(&options);
    assert_eq!(md3.ready["devices"][0]["ports"]["rs485"][0], listen);
    let settings = tcgetattr(&plugged).unwrap();
    let line = md3.call("GET", "/api/bench", "").ok()["buses"][0]["line"].as_str().unwrap().to_owned();
    // Two stop bits and baud rate code 2 (MD3 User Guide, 7.22). The parity is not visible on a pty.
    assert_eq!(line, "19200 8E2");
    assert_eq!(settings.output_speed(), 19_200);
    assert!(settings.control_modes.contains(ControlModes::CSTOPB));

    let (request, reply) = (rtu::write(1, USER_REGISTER, 7), rtu::write(1, USER_REGISTER, 7));
    rustix::io::write(&plugged, &request).unwrap();
    assert_eq!(heard(&plugged, reply.len(), LONG), *reply);

    // Changes to 9,600 baud, even parity, one stop bit. The reply to this write still has the old settings
    // (7.22); all that follows has the new ones.
    let change = rtu::write(1, SERIAL_PORT_CONFIGURATION, 0x21);
    rustix::io::write(&plugged, &change).unwrap();
    assert_eq!(heard(&plugged, change.len(), LONG), *change);
    rustix::io::write(&plugged, &request).unwrap();
    assert_eq!(heard(&plugged, reply.len(), LONG), *reply);
    let line = md3.call("GET", "/api/bench", "").ok()["buses"][0]["line"].as_str().unwrap().to_owned();
    let changed = tcgetattr(&plugged).unwrap();
    assert_eq!((line.as_str(), changed.output_speed()), ("9600 8E1", 9_600));
    assert!(!changed.control_modes.contains(ControlModes::CSTOPB));

    drop(plugged);
    let plugged = cable(&device);
    // The program does not report when it has opened the port again. Bytes sent before that are lost, or wait for it.
    let answers = std::iter::repeat_with(|| {
        rustix::io::write(&plugged, &request).unwrap();
        heard(&plugged, reply.len(), Duration::from_millis(200))
    });
    let answer = answers.take(150).find(|answer| !answer.is_empty()).unwrap();
    assert!(answer.chunks(reply.len()).all(|answer| *answer == *reply), "{answer:?}");
    assert_eq!(md3.stop(), Some(0));
}

/// Runs `drivetwin` with `input` as its whole standard input. Returns its standard output and its exit code.
fn piped(arguments: &[&str], input: &[u8]) -> (Vec<u8>, Option<i32>) {
    let mut child = spawn(
        Command::new(env!("CARGO_BIN_EXE_drivetwin"))
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null()),
    );
    child.stdin.take().unwrap().write_all(input).unwrap();
    let mut said = Vec::new();
    child.stdout.take().unwrap().read_to_end(&mut said).unwrap();
    (said, child.wait().unwrap().code())
}

#[test]
fn a_drive_on_standard_input_and_output_answers_all_and_ends_with_its_input() {
    let requests = [rtu::write(1, USER_REGISTER, 7), rtu::read(1, USER_REGISTER, 1)].concat();
    let replies = [&*rtu::write(1, USER_REGISTER, 7), &*rtu::frame(1, &[3, 2, 0, 7])].concat();
    for time in ["real", "x10", "manual"] {
        let options = ["run", "md3", "--fast-boot", "--time", time, "--listen", "stdio:"];
        assert_eq!(piped(&options, &requests), (replies.clone(), Some(0)), "--time {time}");
        assert_eq!(piped(&options, &[]), (Vec::new(), Some(0)), "--time {time}");
        // Half a request is dropped, because its rest cannot arrive any more.
        assert_eq!(piped(&options, &requests[..5]), (Vec::new(), Some(0)), "--time {time}");
    }
    let qsb = ["run", "qsb-d", "--fast-boot", "--time", "manual", "--listen", "stdio:", "--control", "off"];
    let (said, code) = piped(&qsb, b"R0E\r");
    assert_eq!((String::from_utf8(said).unwrap().as_str(), code), ("r 0E 00000000 !\r\n", Some(0)));
}

#[test]
fn standard_input_and_output_belong_to_one_line() {
    let said = refused(&["run", "md3", "--listen", "stdio:", "--json"]);
    assert_eq!(said, "--json and stdio: cannot share stdout; use one of them");
}

#[test]
fn a_bench_ends_when_its_output_is_closed_though_more_input_may_come() {
    let mut child = spawn(
        Command::new(env!("CARGO_BIN_EXE_drivetwin"))
            .args(["run", "md3", "--fast-boot", "--time", "manual", "--listen", "stdio:"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null()),
    );
    drop(child.stdout.take());
    let mut stdin = child.stdin.take().unwrap();
    stdin.write_all(&rtu::read(1, USER_REGISTER, 1)).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    drop(stdin);
}

/// The timestamps of a stream of records `s 0E 00000000 00000007 !`, which arrive one character after the
/// other.
fn stamps(stream: &[u8]) -> Vec<u32> {
    let text = String::from_utf8(stream.to_vec()).unwrap();
    let records = text.split(['\r', '\n']).filter_map(|line| line.strip_prefix("s 0E 00000000 ")?.get(..8));
    records.map(|stamp| u32::from_str_radix(stamp, 16).unwrap()).collect()
}

#[test]
fn a_stream_of_a_minute_waits_for_a_late_reader() {
    let qsb = Running::start("qsb-d", &["--time", "manual", "--fast-boot"], Stdio::inherit());
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let port = rustix::fs::open(qsb.pty(), flags, Mode::empty()).unwrap();
    qsb.notice();
    // Opening the port resets the drive.
    qsb.advance(1.0);
    let mut line = qsb.connect();
    // Records have timestamps, and there are 512 per second.
    line.write_all(b"W15F\rW0C1\rS0E\r").unwrap();
    qsb.notice();
    qsb.advance(60.0);
    for reader in [line.into(), port] {
        // At least 59 seconds of records, each with 26 characters.
        let heard = stamps(&heard(&reader, 59 * 512 * 26, LONG));
        assert!(heard.len() > 58 * 512, "{}", heard.len());
        // Some of the first eight records are late, because the drive still sends the answers to the commands.
        assert!(heard[8..].windows(2).all(|two| two[1] == two[0] + 1));
    }
    assert_eq!(qsb.stop(), Some(0));
}
