//! Starts `drivetwin`, communicates with it, and stops it.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

/// Held while a process starts. Until its program runs, it has a copy of every file that this process has open, and a port
/// that is closed meanwhile stays open.
static STARTS: Mutex<()> = Mutex::new(());

/// Starts a process.
pub(crate) fn spawn(command: &mut Command) -> Child {
    let _starts = STARTS.lock().unwrap_or_else(PoisonError::into_inner);
    command.spawn().unwrap()
}

/// Closes a port, which no process has open then.
pub(crate) fn close(port: OwnedFd) {
    let _starts = STARTS.lock().unwrap_or_else(PoisonError::into_inner);
    drop(port);
}

/// Runs `drivetwin` until it ends.
pub(crate) fn drivetwin(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_drivetwin"));
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    spawn(&mut command).wait_with_output().unwrap()
}

/// Runs `drivetwin` with arguments that it refuses. Returns its error message.
pub(crate) fn refused(arguments: &[&str]) -> String {
    let output = drivetwin(arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
    assert!(output.stdout.is_empty(), "{arguments:?}: {:?}", output.stdout);
    let sentence = said.strip_prefix("drivetwin: ").and_then(|said| said.strip_suffix('\n')).unwrap();
    assert!(!sentence.contains('\n'), "{arguments:?}: {sentence}");
    sentence.to_owned()
}

/// A running `drivetwin`, which is killed when the test ends.
pub(crate) struct Running {
    /// The name of the first drive.
    name: String,
    child: Child,
    /// The banner as JSON.
    pub(crate) ready: Value,
}

impl Running {
    /// Starts an MD3 and waits until it is ready.
    pub(crate) fn md3(options: &[&str]) -> Self {
        Self::start("md3", options, Stdio::inherit())
    }

    /// Starts a kind of drive or a bench file, with `stderr` as its standard error, and waits until it is
    /// ready.
    pub(crate) fn start(what: &str, options: &[&str], stderr: Stdio) -> Self {
        let mut child = spawn(
            Command::new(env!("CARGO_BIN_EXE_drivetwin"))
                .args(["run", what, "--json"])
                .args(options)
                .stdout(Stdio::piped())
                .stderr(stderr),
        );
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let ready: Value = serde_json::from_str(&line).unwrap();
        let name = ready["devices"][0]["name"].as_str().unwrap().to_owned();
        Self { name, child, ready }
    }

    /// Starts a bench from the bench file at the path `file`.
    pub(crate) fn bench(file: &str, options: &[&str]) -> Self {
        Self::start(file, options, Stdio::inherit())
    }

    fn address(&self, drive: usize, scheme: &str) -> String {
        let ports = self.ready["devices"][drive]["ports"].as_object().unwrap();
        let mut uris = ports.values().filter_map(Value::as_array).flatten();
        let uri = uris.find_map(|uri| uri.as_str()?.strip_prefix(scheme));
        uri.unwrap().to_owned()
    }

    /// Process id of the program.
    pub(crate) fn pid(&self) -> Pid {
        Pid::from_child(&self.child)
    }

    /// Path of the pty of the first drive.
    pub(crate) fn pty(&self) -> PathBuf {
        self.address(0, "pty:").into()
    }

    /// A new connection to the line of the first drive.
    pub(crate) fn connect(&self) -> TcpStream {
        self.connect_to(0)
    }

    /// A new connection to the line of a drive.
    pub(crate) fn connect_to(&self, drive: usize) -> TcpStream {
        patient(TcpStream::connect(self.address(drive, "tcp:")).unwrap())
    }

    /// A new connection to the control API.
    pub(crate) fn control(&self) -> TcpStream {
        let address = self.ready["control"].as_str().unwrap().strip_prefix("http://").unwrap();
        patient(TcpStream::connect(address).unwrap())
    }

    /// Calls the control API with the headers that it requires.
    pub(crate) fn call(&self, method: &str, path: &str, body: &str) -> Answer {
        let length = body.len();
        let headers = format!(
            "Host: localhost\r\nContent-Type: application/json\r\nContent-Length: {length}\r\nConnection: close\r\n"
        );
        self.request(&format!("{method} {path} HTTP/1.1\r\n{headers}\r\n{body}"))
    }

    /// Sends any request. The request must make the API close the connection.
    pub(crate) fn request(&self, request: &str) -> Answer {
        let mut connection = self.control();
        connection.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        connection.read_to_string(&mut answer).unwrap();
        Answer::read(&answer)
    }

    /// Returns when the program has taken everything that was sent to its ports. The first call may be served
    /// together with a new connection; the second call is served after the bytes of this connection.
    pub(crate) fn notice(&self) {
        self.drive();
        self.drive();
    }

    /// The state of the first drive.
    pub(crate) fn drive(&self) -> Value {
        self.call("GET", &format!("/api/drives/{}", self.name), "").ok()
    }

    /// Advances the clock in manual time.
    pub(crate) fn advance(&self, seconds: f64) -> Value {
        self.call("POST", "/api/time/advance", &format!("{{\"seconds\":{seconds}}}")).ok()
    }

    /// Stops the program as a user would. Returns its exit code.
    pub(crate) fn stop(mut self) -> Option<i32> {
        self.signal(Signal::TERM);
        self.child.wait().unwrap().code()
    }

    /// Waits for the end of the program. Returns its exit code, or `None` if it was killed.
    pub(crate) fn wait(mut self) -> Option<i32> {
        self.child.wait().unwrap().code()
    }

    /// Kills the program.
    pub(crate) fn kill(mut self) {
        self.signal(Signal::KILL);
        self.child.wait().unwrap();
    }

    fn signal(&self, signal: Signal) {
        kill_process(self.pid(), signal).unwrap();
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sets a read timeout on a connection, so that a test that would hang ends.
fn patient(connection: TcpStream) -> TcpStream {
    connection.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    connection
}

/// Answer of the control API.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: String,
}

impl Answer {
    fn read(text: &str) -> Self {
        let (head, body) = text.split_once("\r\n\r\n").unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        let head = head.to_lowercase();
        let body =
            if head.contains("transfer-encoding: chunked") { unchunked(body) } else { body.to_owned() };
        Self { status, head, body }
    }

    /// The body of a successful answer.
    pub(crate) fn ok(&self) -> Value {
        assert_eq!(self.status, 200, "{self:?}");
        serde_json::from_str(&self.body).unwrap()
    }

    /// The detail of an answer that must be a problem document with this status.
    pub(crate) fn problem(&self, status: u16) -> String {
        assert_eq!(self.status, status, "{self:?}");
        assert!(self.head.contains("content-type: application/problem+json"), "{self:?}");
        let problem: Value = serde_json::from_str(&self.body).unwrap();
        assert_eq!(problem["status"], status);
        assert_eq!(problem["type"], "about:blank");
        assert!(problem["title"].is_string());
        problem["detail"].as_str().unwrap().to_owned()
    }
}

/// Joins a body that was sent in chunks (RFC 9112, section 7.1).
fn unchunked(mut rest: &str) -> String {
    let mut body = String::new();
    loop {
        let (length, chunk) = rest.split_once("\r\n").unwrap();
        let length = usize::from_str_radix(length, 16).unwrap();
        if length == 0 {
            return body;
        }
        body.push_str(&chunk[..length]);
        rest = chunk[length..].strip_prefix("\r\n").unwrap();
    }
}

/// Sends a request on a line, and reads `reply` bytes.
pub(crate) fn ask(line: &mut TcpStream, request: &[u8], reply: usize) -> Vec<u8> {
    line.write_all(request).unwrap();
    let mut bytes = vec![0; reply];
    line.read_exact(&mut bytes).unwrap();
    bytes
}

/// A directory that is removed after the test.
pub(crate) struct Scratch(PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("drivetwin-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir(&path).unwrap();
        Self(path)
    }

    /// The path of a file in the directory.
    pub(crate) fn file(&self, name: &str) -> String {
        self.path().join(name).to_str().unwrap().to_owned()
    }

    fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
