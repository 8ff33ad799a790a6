//! The terminal: a pty that a process takes and gives back.

use std::fs::File;
use std::io::Read as _;
use std::os::fd::OwnedFd;
use std::process::{Command, Stdio};
use std::thread;

use rustix::fs::{Mode, OFlags, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, Winsize, tcgetattr, tcsetwinsize};

use crate::terminal::Screen;

/// A new terminal: the end of the person, and the end of the program.
fn terminal() -> (File, OwnedFd) {
    let person = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&person).unwrap();
    unlockpt(&person).unwrap();
    tcsetwinsize(&person, Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
    let path = ptsname(&person, Vec::new()).unwrap();
    let program = open(path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty()).unwrap();
    (person.into(), program)
}

/// Runs a test of this program, which is ignored otherwise, in a terminal. Returns what it has written there.
fn in_terminal(test: &str) -> String {
    let (mut person, program) = terminal();
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", test, "--ignored", "--nocapture"])
        .env("RUST_BACKTRACE", "0")
        .stdin(Stdio::from(program.try_clone().unwrap()))
        .stdout(Stdio::from(program.try_clone().unwrap()))
        .stderr(Stdio::from(program.try_clone().unwrap()))
        .spawn()
        .unwrap();
    let reader = thread::spawn(move || {
        let (mut all, mut buffer) = (Vec::new(), [0; 4096]);
        // A terminal whose last program has ended is an error for its reader.
        while let Ok(count @ 1..) = person.read(&mut buffer) {
            all.extend_from_slice(&buffer[..count]);
        }
        String::from_utf8_lossy(&all).into_owned()
    });
    child.wait().unwrap();
    let modes = tcgetattr(&program).unwrap().local_modes;
    assert!(modes.contains(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG), "the terminal is raw");
    drop(program);
    reader.join().unwrap()
}

/// The other screen, and the usual one again.
const TAKEN: &str = "\x1b[?1049h";
const GIVEN: &str = "\x1b[?1049l";

#[test]
#[ignore = "runs in the terminal of another test"]
fn child_that_ends() {
    let mut screen = Screen::take().unwrap();
    screen.get().unwrap().draw(|frame| frame.render_widget("drawn", frame.area())).unwrap();
}

#[test]
#[ignore = "runs in the terminal of another test"]
fn child_that_panics() {
    let mut screen = Screen::take().unwrap();
    let panicked = thread::spawn(|| panic!("in another thread")).join();
    assert!(panicked.is_err() && screen.get().is_none());
    panic!("in its own thread");
}

#[test]
fn the_terminal_is_given_back() {
    let written = in_terminal("tests::terminal::child_that_ends");
    let [taken, drawn, given] = [TAKEN, "drawn", GIVEN].map(|text| written.find(text).expect(text));
    assert!(taken < drawn && drawn < given, "{written:?}");
    assert_eq!(written.matches(GIVEN).count(), 1);
}

#[test]
fn a_panic_gives_the_terminal_back_and_is_readable() {
    let written = in_terminal("tests::terminal::child_that_panics");
    let [taken, given] = [TAKEN, GIVEN].map(|text| written.find(text).expect(text));
    let [other, own] = ["in another thread", "in its own thread"].map(|text| written.find(text).expect(text));
    assert!(taken < given && given < other && other < own, "{written:?}");
    assert_eq!(written.matches(GIVEN).count(), 1);
}
