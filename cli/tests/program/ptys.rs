//! Ptys that several programs use one after the other.

use std::os::fd::OwnedFd;
use std::path::Path;

use crate::running::{Running, Scratch, ask, close};
use drivetwin_protocol::modbus::rtu;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::process::{Signal, WaitOptions, kill_process, waitpid};
use rustix::termios::{Action, InputModes, LocalModes, OptionalActions, tcflow, tcgetattr, tcsetattr};

const USER_REGISTER: u16 = 0x1D;
const SERIAL_PORT_CONFIGURATION: u16 = 0x1C;

/// Opens a pty like a serial program, at 9,600 baud.
fn open(path: &Path) -> OwnedFd {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC | OFlags::NONBLOCK;
    let port = rustix::fs::open(path, flags, Mode::empty()).unwrap();
    let mut settings = tcgetattr(&port).unwrap();
    settings.make_raw();
    settings.set_speed(9_600).unwrap();
    tcsetattr(&port, OptionalActions::Now, &settings).unwrap();
    port
}

/// Writes a request. Its `value` tells it from other requests.
fn request(port: &OwnedFd, value: u16) {
    assert_eq!(rustix::io::write(port, &rtu::write(1, USER_REGISTER, value)), Ok(8), "the output is stopped");
}

/// Waits until there is something to read. The timeout is longer than every action of these tests.
fn wait(port: &OwnedFd) {
    let minute = Timespec { tv_sec: 60, tv_nsec: 0 };
    let came = poll(&mut [PollFd::new(port, PollFlags::IN)], Some(&minute)).unwrap();
    assert_eq!(came, 1, "there is no answer");
}

/// Reads the answer to the request with `value`, and nothing else.
fn answer(port: &OwnedFd, value: u16) {
    let mut came = Vec::new();
    while came.len() < 8 {
        wait(port);
        let mut bytes = [0; 64];
        let count = rustix::io::read(port, &mut bytes).unwrap();
        came.extend_from_slice(&bytes[..count]);
    }
    assert_eq!(came, *rtu::write(1, USER_REGISTER, value));
}

/// Stops the process of `md3` during `act`, so that it sees all changes at the same time.
fn unseen<T>(md3: &Running, act: impl FnOnce() -> T) -> T {
    // First waits until the bench's thread sleeps, because then it is not handling an event.
    let stat = format!("/proc/{}/stat", md3.pid().as_raw_nonzero());
    while !std::fs::read_to_string(&stat).unwrap().contains(") S ") {}
    kill_process(md3.pid(), Signal::STOP).unwrap();
    let (_, status) = waitpid(Some(md3.pid()), WaitOptions::UNTRACED).unwrap().unwrap();
    assert!(status.stopped());
    let result = act();
    kill_process(md3.pid(), Signal::CONT).unwrap();
    result
}

#[test]
fn a_pty_answers_each_of_many_successive_programs() {
    let md3 = Running::md3(&["--fast-boot", "--time", "manual"]);
    for value in 0..500 {
        let port = open(&md3.pty());
        request(&port, value);
        answer(&port, value);
    }
}

#[test]
fn an_opener_of_a_pty_does_not_get_replies_of_the_previous_one() {
    let md3 = Running::md3(&["--fast-boot"]);
    // The bench has taken the first program's request. A part of its reply may have been sent by now, so the
    // next program does not read yet.
    let port = open(&md3.pty());
    request(&port, 1);
    md3.notice();
    let next = unseen(&md3, || {
        close(port);
        let next = open(&md3.pty());
        request(&next, 2);
        next
    });
    md3.notice();
    answer(&next, 2);
    close(next);

    // The requests of both programs are in one queue.
    let port = open(&md3.pty());
    md3.notice();
    let next = unseen(&md3, || {
        request(&port, 3);
        close(port);
        let next = open(&md3.pty());
        request(&next, 4);
        next
    });
    answer(&next, 4);
    close(next);

    // Only the first program's request is in the queue. The next program writes later.
    let port = open(&md3.pty());
    md3.notice();
    let next = unseen(&md3, || {
        request(&port, 5);
        close(port);
        open(&md3.pty())
    });
    md3.notice();
    request(&next, 6);
    answer(&next, 6);
    close(next);

    // The process has not seen that the first program opened the port, either.
    md3.notice();
    let next = unseen(&md3, || {
        let first = open(&md3.pty());
        request(&first, 9);
        close(first);
        let next = open(&md3.pty());
        request(&next, 10);
        next
    });
    answer(&next, 10);
    close(next);

    // The reply has arrived, but the first program does not read it.
    let port = open(&md3.pty());
    request(&port, 7);
    wait(&port);
    let next = unseen(&md3, || {
        close(port);
        open(&md3.pty())
    });
    md3.notice();
    request(&next, 8);
    answer(&next, 8);
}

#[test]
fn two_programs_that_have_a_pty_open_are_one() {
    let md3 = Running::md3(&["--fast-boot"]);
    // Two programs at once, like `cat` and `echo` in a shell.
    let reader = open(&md3.pty());
    md3.notice();
    unseen(&md3, || request(&open(&md3.pty()), 1));
    answer(&reader, 1);
}

#[test]
fn output_that_a_program_stopped_does_not_outlive_it() {
    let md3 = Running::md3(&["--fast-boot"]);
    // The process sees neither the opening nor the closing by the first program.
    let port = unseen(&md3, || {
        let stopped = open(&md3.pty());
        tcflow(&stopped, Action::OOff).unwrap();
        close(stopped);
        open(&md3.pty())
    });
    md3.notice();
    request(&port, 4);
    answer(&port, 4);
    close(port);
    md3.notice();

    let port = open(&md3.pty());
    tcflow(&port, Action::OOff).unwrap();
    close(port);
    md3.notice();
    let port = open(&md3.pty());
    request(&port, 1);
    answer(&port, 1);

    // The reply to the first program contains Ctrl-S, which is 0x13.
    let mut settings = tcgetattr(&port).unwrap();
    settings.input_modes.insert(InputModes::IXON);
    tcsetattr(&port, OptionalActions::Now, &settings).unwrap();
    request(&port, 0x1313);
    wait(&port);
    md3.notice();
    close(port);
    md3.notice();
    let port = open(&md3.pty());
    request(&port, 2);
    answer(&port, 2);

    // The next program opens the pty before the process sees that the previous program has closed it.
    md3.notice();
    let port = unseen(&md3, || {
        tcflow(&port, Action::OOff).unwrap();
        close(port);
        open(&md3.pty())
    });
    md3.notice();
    request(&port, 3);
    answer(&port, 3);
}

#[test]
fn a_pty_with_default_settings_changes_no_character() {
    let md3 = Running::md3(&["--fast-boot"]);
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC | OFlags::NONBLOCK;
    // Ctrl-C, Ctrl-\\, Ctrl-Z, Ctrl-S, Ctrl-Q, Ctrl-D, CR and LF, in both directions.
    for value in [0x031C, 0x1A13, 0x1104, 0x0D0A] {
        let port = rustix::fs::open(md3.pty(), flags, Mode::empty()).unwrap();
        request(&port, value);
        answer(&port, value);
        // The next program inherits none of these terminal functions.
        let mut settings = tcgetattr(&port).unwrap();
        settings.local_modes |= LocalModes::ECHO | LocalModes::ICANON | LocalModes::ISIG;
        settings.input_modes |= InputModes::ICRNL | InputModes::ISTRIP | InputModes::IXON;
        tcsetattr(&port, OptionalActions::Now, &settings).unwrap();
        close(port);
        md3.notice();
    }
}

/// Default baud rate of a pty.
fn baud(path: &Path) -> u32 {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let port = rustix::fs::open(path, flags, Mode::empty()).unwrap();
    let baud = tcgetattr(&port).unwrap().output_speed();
    close(port);
    baud
}

#[test]
fn a_pty_has_the_baud_rate_of_its_drive() {
    let md3 = Running::md3(&["--fast-boot", "--time", "manual"]);
    assert_eq!(baud(&md3.pty()), 9_600);
    md3.notice();
    // Baud rate code 2 (MD3 User Guide, 7.22).
    let mut line = md3.connect();
    let faster = rtu::write(1, SERIAL_PORT_CONFIGURATION, 0x22);
    assert_eq!(ask(&mut line, &faster, 8), *faster);
    md3.notice();
    assert_eq!(baud(&md3.pty()), 19_200);
    // As on a hardware port, the settings of a program stay after it has closed the port.
    close(open(&md3.pty()));
    md3.notice();
    assert_eq!(baud(&md3.pty()), 9_600);

    let qsb = Running::start("qsb-d", &["--fast-boot"], std::process::Stdio::inherit());
    assert_eq!(baud(&qsb.pty()), 230_400);
}

#[test]
fn a_pty_is_listed_with_its_link() {
    let scratch = Scratch::new("told");
    let link = scratch.file("md3.tty");
    let md3 = Running::md3(&["--listen", &format!("pty:{link}")]);
    let pty = std::fs::read_link(&link).unwrap();
    let told = [format!("pty:{}", pty.display()), format!("pty:{link}")];
    assert_eq!(md3.ready["devices"][0]["ports"]["rs485"], serde_json::json!(told));
}
