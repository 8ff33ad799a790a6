//! `drivetwin view` and `drivetwin run … --view` in a terminal.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::os::fd::OwnedFd;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

use rustix::fs::{Mode, OFlags, open};
use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, Winsize, tcgetattr, tcsetwinsize};

use crate::running::{refused, spawn};

/// Longest wait for something that must happen.
const LIMIT: Duration = Duration::from_secs(60);

/// Maximum number of pieces that a program writes before a text.
const PIECES: usize = 300;

/// The sequence that shows the usual screen of the terminal again.
const GIVEN_BACK: &str = "\x1b[?1049l";

/// The sequence that shows the cursor.
const CURSOR: &str = "\x1b[?25h";

/// A program in a terminal of 100 columns and 30 rows.
struct InTerminal {
    child: Child,
    /// The end of the person.
    person: File,
    /// The end of the program, until the program has ended.
    terminal: Option<OwnedFd>,
    /// Output of the program, as it comes.
    pieces: Receiver<Vec<u8>>,
    written: String,
}

impl InTerminal {
    fn start(arguments: &[&str]) -> Self {
        let person = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&person).unwrap();
        unlockpt(&person).unwrap();
        tcsetwinsize(&person, Winsize { ws_row: 30, ws_col: 100, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
        let path = ptsname(&person, Vec::new()).unwrap();
        let terminal = open(path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty()).unwrap();
        let stdio = || Stdio::from(terminal.try_clone().unwrap());
        // A test that runs under nohup ignores SIGHUP, and so would the program.
        let mut command = Command::new("env");
        command.args(["--default-signal=HUP", env!("CARGO_BIN_EXE_drivetwin")]);
        command.args(arguments).stdin(stdio()).stdout(stdio()).stderr(stdio());
        let child = spawn(&mut command);
        let person = File::from(person);
        let (sender, pieces) = channel();
        let mut reader = person.try_clone().unwrap();
        thread::spawn(move || {
            let mut buffer = [0; 4096];
            // A terminal whose last program has ended is an error for its reader.
            while let Ok(count @ 1..) = reader.read(&mut buffer) {
                let _ = sender.send(buffer[..count].to_vec());
            }
        });
        Self { child, person, terminal: Some(terminal), pieces, written: String::new() }
    }

    /// Waits until the program has written a text.
    fn wait_for(&mut self, text: &str) {
        // A view writes again and again, so that a wait for each piece alone may have no end.
        for _ in 0..PIECES {
            if self.written.contains(text) {
                return;
            }
            let Ok(piece) = self.pieces.recv_timeout(LIMIT) else { break };
            self.written.push_str(&String::from_utf8_lossy(&piece));
        }
        panic!("no '{text}' in {:?}", self.written);
    }

    fn press(&mut self, keys: &str) {
        self.person.write_all(keys.as_bytes()).unwrap();
    }

    fn kill(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Waits for the end of the program, which gives the terminal back. Returns its exit code and what it wrote after.
    fn end(mut self) -> (Option<i32>, String) {
        self.wait_for(GIVEN_BACK);
        let code = self.child.wait().unwrap().code();
        let terminal = self.terminal.take().unwrap();
        let modes = tcgetattr(&terminal).unwrap().local_modes;
        assert!(modes.contains(LocalModes::ICANON | LocalModes::ECHO), "the terminal is raw");
        drop(terminal);
        while let Ok(piece) = self.pieces.recv_timeout(LIMIT) {
            self.written.push_str(&String::from_utf8_lossy(&piece));
        }
        let (_, after) = self.written.rsplit_once(GIVEN_BACK).unwrap();
        assert!(after.contains(CURSOR), "the terminal has no cursor: {after:?}");
        (code, after.replace(CURSOR, ""))
    }
}

impl Drop for InTerminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
    }
}

/// A server of a bench with one drive, for one view. Returns its address.
fn server() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    thread::spawn(move || {
        let state = "{\"state\":{\"time\":{\"mode\":\"real\",\"seconds\":1},\"drives\":{\"x\":{\"index\":0,\"kind\":\"md3\",\"powered\":true}}}}";
        let head = "HTTP/1.1 200 OK\r\ncontent-type: text/event-stream\r\nconnection: close\r\n\r\n";
        let mut streams = Vec::new();
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let _ = stream.read(&mut [0; 4096]);
            let _ = write!(stream, "{head}event: update\ndata: {state}\n\n");
            streams.push(stream);
        }
    });
    address
}

#[test]
fn a_view_ends_by_a_key_and_by_signals() {
    let address = server();
    let mut view = InTerminal::start(&["view", &address]);
    view.wait_for("● live");
    view.press("q");
    assert_eq!(view.end(), (Some(0), String::new()));
    for signal in [Signal::TERM, Signal::INT, Signal::HUP] {
        let mut view = InTerminal::start(&["view", &format!("http://{address}")]);
        view.wait_for("● live");
        view.kill(signal);
        assert_eq!(view.end(), (Some(0), String::new()), "{signal:?}");
    }
}

#[test]
fn a_run_with_its_view_has_the_banner_in_a_pane_and_ends_with_it() {
    for end in ["q", "\x03"] {
        let mut run = InTerminal::start(&["run", "md3", "--view", "--control", "127.0.0.1:0"]);
        run.wait_for("http://127.0.0.1:");
        run.wait_for("help");
        run.press(end);
        let (code, after) = run.end();
        assert_eq!((code, after.as_str()), (Some(0), ""), "nothing of the banner is outside the view");
    }
    let mut run = InTerminal::start(&["run", "md3", "--view"]);
    run.wait_for("help");
    run.kill(Signal::TERM);
    assert_eq!(run.end().0, Some(0));
}

#[test]
fn a_view_without_address_or_terminal_says_so() {
    assert_eq!(
        refused(&["view"]),
        "an address is missing; `drivetwin run` prints it below `control`: drivetwin view http://127.0.0.1:8080"
    );
    assert_eq!(
        refused(&["view", "127.0.0.1:8080"]),
        "the view needs a terminal, and standard output is not one"
    );
    assert_eq!(
        refused(&["view", "https://bench:8080"]),
        "invalid value 'https://bench:8080' for '[URL]': the control API has no TLS; forward its port with `ssh -L`"
    );
    assert_eq!(
        refused(&["run", "md3", "--view", "--control", "off"]),
        "--view and --control off: the view needs the control API"
    );
    assert_eq!(
        refused(&["run", "qsb-d", "--view", "--listen", "stdio:"]),
        "--view and stdio: cannot share the terminal; use one of them"
    );
    let both = refused(&["run", "md3", "--view", "--json"]);
    assert!(both.contains("--view") && both.contains("--json"), "{both}");
}
