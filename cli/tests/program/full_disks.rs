//! Files on a full disk, simulated by a limit of the file size.

use std::io::{BufRead as _, BufReader, Read as _};
use std::net::TcpStream;
use std::process::{Command, Stdio};

use drivetwin_protocol::modbus::{Frame, rtu};
use rustix::process::{Pid, Signal, kill_process};

use crate::running::{Scratch, ask, spawn};

/// Limit of the file size in blocks, which the shell counts in 512 or 1,024 bytes. A few exchanges reach the
/// limit.
const BLOCKS: u32 = 32;

/// Starts an MD3 whose files may not become longer than `blocks`, sends it requests again and again, and
/// stops it. Returns the exit code and the text on stderr.
fn ends(blocks: u32, option: &str, file: &str, requests: &[Frame]) -> (Option<i32>, String) {
    let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\"");
    let mut child = spawn(
        Command::new("sh")
            .args(["-c", &script, env!("CARGO_BIN_EXE_drivetwin"), "run", "md3", "--json"])
            .args(["--time", "manual", "--fast-boot", "--listen", "tcp:127.0.0.1:0", option, file])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped()),
    );
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let ready: serde_json::Value = serde_json::from_str(&line).unwrap();
    let address = ready["devices"][0]["ports"]["rs485"][0].as_str().unwrap().strip_prefix("tcp:").unwrap();
    let mut client = TcpStream::connect(address).unwrap();
    for request in requests.iter().cycle().take(600) {
        // The drive answers, even when its files cannot be written.
        let length = if request[1] == 3 { 5 + 2 * usize::from(request[5]) } else { request.len() };
        assert_eq!(ask(&mut client, request, length)[..2], request[..2]);
    }
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    (child.wait().unwrap().code(), said)
}

#[test]
fn a_memory_that_cannot_be_stored_is_logged_and_the_drive_runs_on() {
    let scratch = Scratch::new("full-memory");
    let file = scratch.file("md3.nv");
    // EEPROMControl 1: save (MD3 7.20).
    let (code, said) = ends(0, "--nv", &file, &[rtu::write(1, 0x1A, 1)]);
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains(&format!("{file} does not keep what the drive stores: File too large")), "{said}");
    assert!(
        said.contains(&format!("drivetwin: {file} does not keep what the drive stored: File too large")),
        "{said}"
    );
}

#[test]
fn a_full_disk_is_logged_and_the_drive_runs_on() {
    let scratch = Scratch::new("full-files");
    // A read of all registers; MotionControl 1: move (MD3 7.15).
    let requests = [rtu::read(1, 0, 32), rtu::write(1, 0x11, 1)];
    for option in ["--record", "--vcd", "--pcap"] {
        let file = scratch.file(&option[2..]);
        let (code, said) = ends(BLOCKS, option, &file, &requests);
        assert_eq!(code, Some(2), "{said}");
        assert!(said.contains(&format!("{option} {file}: File too large")), "{said}");
        assert!(said.contains("; the file ends here"), "{said}");
        assert!(said.contains(&format!("drivetwin: {option} {file} is not complete")), "{said}");
        // The file contains everything up to the limit.
        let length = std::fs::metadata(&file).unwrap().len();
        assert!(length > 0 && length.is_multiple_of(512), "{option}: {length} bytes");
    }
}
