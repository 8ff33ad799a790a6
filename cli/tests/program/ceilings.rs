//! Memory of the program while clients misbehave. Each bound is several times the memory that is needed.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::TcpStream;

use drivetwin_protocol::modbus::rtu;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use crate::running::{Running, ask};

/// A user register of the MD3. It has no effect.
const USER_REGISTER: u16 = 0x1D;

const MIB: usize = 1 << 20;

/// Memory in use by a program, in bytes.
fn memory(program: &Running) -> usize {
    let status = std::fs::read_to_string(format!("/proc/{}/status", program.pid().as_raw_nonzero())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<usize>().unwrap() << 10
}

/// Asserts that the memory of a program has grown by at most `most` bytes.
#[track_caller]
fn grew_at_most(program: &Running, before: usize, most: usize) {
    let grown = memory(program).saturating_sub(before);
    assert!(grown <= most, "{} KiB more, {} are allowed", grown >> 10, most >> 10);
}

#[test]
fn calls_whose_callers_have_left_are_not_carried_out() {
    const CALLS: usize = 1_000;
    let md3 = Running::md3(&["--time", "manual", "--fast-boot"]);
    let head = |method: &str, path: &str, length: usize| {
        format!(
            "{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {length}\r\n\r\n"
        )
    };
    // Other calls wait while the clock is advanced. Two million edges a second make the day long.
    let pulses = "{\"count\":4000000000,\"hz\":1000000}";
    assert_eq!(md3.call("POST", "/api/drives/md3/pins/J2.5/pulses", pulses).status, 204);
    let day = "{\"seconds\":86400}";
    let mut waiting = md3.control();
    let advance = head("POST", "/api/time/advance", day.len()) + day;
    waiting.write_all(advance.as_bytes()).unwrap();
    let (path, preset) = ("/api/drives/md3/registers/UserRegister", "{\"value\":7}");
    let call = head("PUT", path, preset.len()) + preset;
    for _ in 0..CALLS {
        md3.control().write_all(call.as_bytes()).unwrap();
    }
    waiting.set_nonblocking(true).unwrap();
    assert_eq!(waiting.read(&mut [0]).unwrap_err().kind(), ErrorKind::WouldBlock, "the day is over");
    drop(waiting);
    assert_eq!(md3.call("GET", "/api/bench", "").ok()["time"]["mode"], "manual");
    assert_eq!(md3.call("PUT", path, preset).status, 204);
    // The last call is carried out, and none of the others, except those of callers whose end the program has
    // not noticed yet. Of these there is at most one for each connection of the API.
    let presets = md3.call("GET", "/api/trace", "").body.matches("> poke UserRegister 7").count();
    assert!((1..=65).contains(&presets), "{presets} of {CALLS} calls are carried out");
    assert_eq!(md3.stop(), Some(0));
}

/// The bound itself is tested in `host/src/ports/unread.rs` and `host/src/ports/tests.rs`: the buffers of the
/// system are larger than each client's share.
#[test]
fn clients_that_never_read_leave_another_one_served() {
    let options = ["--time", "manual", "--fast-boot", "--line", "fast"];
    let qsb = Running::start("qsb-d", &options, std::process::Stdio::null());
    let deaf: Vec<TcpStream> = (0..31).map(|_| qsb.connect()).collect();
    let mut polls = qsb.connect();
    // Each client receives all answers: 31 times 1 MiB.
    let (command, answer) = (b"R0E\r".repeat(1_000), 17 * 1_000);
    for _ in 0..MIB.div_ceil(answer) {
        ask(&mut polls, &command, answer);
    }
    drop(deaf);
    assert_eq!(ask(&mut polls, b"R0E\r", 17), b"r 0E 00000000 !\r\n");
    assert_eq!(qsb.stop(), Some(0));
}

#[test]
fn five_thousand_connections_leave_the_first_one_served() {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).unwrap();
    let md3 = Running::start("md3", &["--time", "manual", "--fast-boot"], std::process::Stdio::null());
    let mut first = md3.connect();
    let request = rtu::write(1, USER_REGISTER, 7);
    ask(&mut first, &request, 8);
    let before = memory(&md3);
    let mut others: Vec<TcpStream> = Vec::new();
    for number in 0..5_000 {
        let mut other = md3.connect();
        // Clients that are accepted send half a request, and all of them stay.
        let _ = other.write_all(&request[..3]);
        others.push(other);
        if number % 500 == 0 {
            assert_eq!(ask(&mut first, &request, 8), *request, "beside {number} others");
        }
    }
    grew_at_most(&md3, before, 32 * MIB);
    // 64 connections are accepted; all others are closed.
    assert_eq!(others.pop().unwrap().read(&mut [0]).unwrap_or(0), 0);
    drop(others);
    assert_eq!(ask(&mut first, &request, 8), *request);
    // The system does not report closings and openings in the order in which they happened.
    let is_served = |mut other: TcpStream| {
        let mut reply = [0; 8];
        other.write_all(&request).is_ok() && other.read_exact(&mut reply).is_ok() && reply == *request
    };
    assert!((0..5_000).any(|_| is_served(md3.connect())), "there is room again");
    assert_eq!(md3.stop(), Some(0));
}

#[test]
fn slow_and_half_open_callers_leave_others_served() {
    let md3 = Running::md3(&["--time", "manual", "--fast-boot"]);
    md3.drive();
    let before = memory(&md3);
    // 30 clients send one byte each; 30 others send a part of a body with a long Content-Length.
    let slow: Vec<TcpStream> = (0..30)
        .map(|_| {
            let mut slow = md3.control();
            slow.write_all(b"G").unwrap();
            slow
        })
        .collect();
    let half: Vec<TcpStream> = (0..30)
        .map(|_| {
            let mut half = md3.control();
            let head = "PUT /api/time HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n";
            half.write_all(format!("{head}Content-Length: 1000000000\r\n\r\n{{\"mode\":").as_bytes())
                .unwrap();
            half
        })
        .collect();
    assert_eq!(md3.drive()["registers"]["DeviceAddress"], 1);
    grew_at_most(&md3, before, 32 * MIB);
    drop((slow, half));
    assert_eq!(md3.stop(), Some(0));
}

#[test]
fn long_names_cost_nothing() {
    let md3 = Running::md3(&["--time", "manual", "--fast-boot"]);
    md3.drive();
    let before = memory(&md3);
    for length in [1_000, 30_000, 300_000] {
        let name = "x".repeat(length);
        let answer = md3.call("GET", &format!("/api/drives/{name}"), "");
        assert!([404, 414, 431].contains(&answer.status), "{}", answer.status);
        let said = answer.body.len();
        assert!(said < 1_000, "{said} bytes are answered to a name of {length}");
    }
    let preset = format!("{{\"value\":\"{}\"}}", "9".repeat(1_000_000));
    let answer = md3.call("PUT", "/api/drives/md3/registers/Speed", &preset);
    assert!([413, 422].contains(&answer.status), "{}", answer.status);
    assert!(answer.body.len() < 1_000, "{}", answer.body.len());
    grew_at_most(&md3, before, 32 * MIB);
    assert_eq!(md3.stop(), Some(0));
}
