//! Many drives in one process.

use std::fmt::Write as _;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;

use crate::running::{Running, Scratch, ask};
use drivetwin_protocol::modbus::rtu;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// A user register of the MD3. It has no effect.
const USER_REGISTER: u16 = 0x1D;
/// A register of the RS drives that has no effect with factory settings.
const TARGET_POSITION1: u16 = 0x501B;

/// The value that identifies a drive on its own line.
enum Mark {
    /// A register on Modbus.
    Register(u16),
    /// The serial number, which is a part of VERSION.
    Serial,
}

const KINDS: [(&str, &str, Mark); 7] = [
    ("md3", "UserRegister", Mark::Register(USER_REGISTER)),
    ("qsb-d", "SerialNumber", Mark::Serial),
    ("rs434544", "TARGET_POSITION1Low", Mark::Register(TARGET_POSITION1)),
    ("md3-low", "UserRegister", Mark::Register(USER_REGISTER)),
    ("qsb-m", "SerialNumber", Mark::Serial),
    ("rs434546", "TARGET_POSITION1Low", Mark::Register(TARGET_POSITION1)),
    ("qsb-s", "SerialNumber", Mark::Serial),
];

/// Reads a text line without its end.
fn line(connection: &mut TcpStream) -> String {
    let mut text = Vec::new();
    while !text.ends_with(b"\n") {
        let mut byte = [0];
        connection.read_exact(&mut byte).unwrap();
        text.extend(byte);
    }
    String::from_utf8(text).unwrap().trim_end().to_owned()
}

/// A request for the value that identifies a drive.
fn request(number: usize) -> Vec<u8> {
    match KINDS[number % KINDS.len()].2 {
        Mark::Register(address) => rtu::read(1, address, 1).to_vec(),
        Mark::Serial => b"R14\r".to_vec(),
    }
}

/// Reads the reply and checks that it comes from the drive with this number.
fn check(number: usize, connection: &mut TcpStream) {
    let expected = u16::try_from(number).unwrap();
    match KINDS[number % KINDS.len()].2 {
        Mark::Register(_) => {
            let mut reply = [0; 7];
            connection.read_exact(&mut reply).unwrap();
            let [high, low] = expected.to_be_bytes();
            assert_eq!(reply, *rtu::frame(1, &[3, 2, high, low]), "drive {number}");
        }
        Mark::Serial => {
            let reply = line(connection);
            let version = reply.split(' ').nth(2).unwrap();
            assert_eq!(version[..5].parse(), Ok(expected), "drive {number}: {reply}");
        }
    }
}

#[test]
fn a_thousand_drives_answer_each_on_its_own_port() {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).unwrap();
    let scratch = Scratch::new("thousand");
    let file = scratch.file("bench.toml");
    let mut text = String::new();
    for number in 0..1_000 {
        let (kind, name, _) = &KINDS[number % KINDS.len()];
        let set = format!("set = {{ {name} = {number} }}");
        write!(text, "[[drive]]\nname = 'd{number}'\nkind = '{kind}'\nfast_boot = true\n{set}\n").unwrap();
    }
    std::fs::write(&file, text).unwrap();
    for time in ["manual", "real"] {
        let bench = Running::bench(&file, &["--time", time]);
        let mut lines: Vec<TcpStream> = (0..1_000).map(|number| bench.connect_to(number)).collect();
        for (number, connection) in lines.iter_mut().enumerate() {
            connection.write_all(&request(number)).unwrap();
            check(number, connection);
        }
        // Then all drives get a request at once.
        for (number, connection) in lines.iter_mut().enumerate() {
            connection.write_all(&request(number)).unwrap();
        }
        for (number, connection) in lines.iter_mut().enumerate() {
            check(number, connection);
        }
        assert_eq!(bench.stop(), Some(0));
    }
}

#[test]
fn a_line_has_room_for_all_247_addresses() {
    let scratch = Scratch::new("full-line");
    let file = scratch.file("bench.toml");
    let mut text = String::from("time = 'manual'\n");
    for address in 1..=247 {
        let set = format!("set = {{ UserRegister = {} }}", 1_000 + address);
        let drive = format!("kind = 'md3'\naddress = {address}\nfast_boot = true\n{set}");
        write!(text, "[[drive]]\nname = 'd{address}'\n{drive}\n").unwrap();
    }
    let drives: Vec<String> = (1..=247).map(|address| format!("'d{address}'")).collect();
    write!(text, "[[bus]]\nname = 'line'\ndrives = [{}]\n", drives.join(", ")).unwrap();
    std::fs::write(&file, text).unwrap();
    let bench = Running::bench(&file, &[]);
    let mut connection = bench.connect();
    for address in 1..=247 {
        let reply = ask(&mut connection, &rtu::read(address, USER_REGISTER, 1), 7);
        let [high, low] = (1_000 + u16::from(address)).to_be_bytes();
        assert_eq!(reply, *rtu::frame(address, &[3, 2, high, low]));
    }
    assert_eq!(bench.stop(), Some(0));
}
