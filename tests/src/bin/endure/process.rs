//! The process of the bench, and what it uses, from `/proc`.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use crate::control::Control;

/// Longest wait for the line that says where the ports are.
const PATIENCE: Duration = Duration::from_secs(60);

/// The running bench. It is ended when this is dropped, and by the system when this program ends in any other way.
pub(crate) struct Process {
    child: Child,
    /// The line of JSON that says where its ports are.
    pub(crate) ready: Ready,
}

/// Addresses of the bench.
#[derive(Clone)]
pub(crate) struct Ready(String);

impl Ready {
    /// Addresses of a drive, in the order of the ports: `tcp:HOST:PORT`, `rfc2217:HOST:PORT`, `pty:PATH`.
    pub(crate) fn places(&self, name: &str) -> Vec<String> {
        let rest = self.0.split_once(&format!("\"name\":\"{name}\"")).map_or("", |(_, rest)| rest);
        let part = rest.split("\"name\":").next().unwrap_or("").split("\"control\":").next().unwrap_or("");
        let is_place = |word: &&str| ["tcp:", "rfc2217:", "pty:"].iter().any(|start| word.starts_with(start));
        part.split('"').filter(is_place).map(str::to_owned).collect()
    }

    /// The control API.
    pub(crate) fn control(&self) -> Control {
        let address = self.0.split_once("\"control\":\"http://").and_then(|(_, rest)| rest.split('"').next());
        Control(address.unwrap_or_default().to_owned())
    }
}

/// What a process uses.
#[derive(Clone, Copy)]
pub(crate) struct Resources {
    /// Resident memory.
    pub(crate) resident_kib: u64,
    /// The most resident memory so far.
    pub(crate) peak_kib: u64,
    pub(crate) handles: usize,
    pub(crate) threads: u64,
}

impl Process {
    /// Starts the bench of this bench file.
    pub(crate) fn start(drivetwin: &Path, text: &str) -> Result<Self, String> {
        let file = std::env::temp_dir().join(format!("drivetwin-endure-{}.toml", std::process::id()));
        std::fs::write(&file, text)
            .map_err(|error| format!("{} cannot be written: {error}", file.display()))?;
        // A program of util-linux, which the bench then replaces.
        let mut command = Command::new("setpriv");
        command.args(["--pdeathsig", "KILL"]).arg(drivetwin).arg("run").arg(&file).arg("--json");
        let mut child = command
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| format!("setpriv, which starts drivetwin, cannot be started: {error}"))?;
        let (line, ready) = mpsc::channel();
        if let Some(stdout) = child.stdout.take() {
            thread::spawn(move || {
                let mut text = String::new();
                let _ = BufReader::new(stdout).read_line(&mut text);
                let _ = line.send(text);
            });
        }
        let mut process = Self { child, ready: Ready(String::new()) };
        process.ready.0 = ready.recv_timeout(PATIENCE).unwrap_or_default();
        let _ = std::fs::remove_file(&file);
        if process.ready.control().0.is_empty() {
            Err(format!(
                "drivetwin has not said where its ports are within {PATIENCE:?}, or has ended before"
            ))
        } else {
            Ok(process)
        }
    }

    /// Fails if the process has ended.
    pub(crate) fn check(&mut self) -> Result<(), String> {
        match self.child.try_wait() {
            Ok(None) => Ok(()),
            Ok(Some(status)) => Err(format!("drivetwin has ended: {status}")),
            Err(error) => Err(format!("drivetwin cannot be watched: {error}")),
        }
    }

    /// What the process uses now.
    pub(crate) fn resources(&self) -> Result<Resources, String> {
        let status = std::fs::read_to_string(self.file("status"))
            .map_err(|error| format!("drivetwin has no /proc: {error}"))?;
        let number = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name)).unwrap_or("");
            let number = line.split_whitespace().next().and_then(|number| number.parse().ok());
            number.ok_or_else(|| format!("drivetwin has no {name} in /proc"))
        };
        Ok(Resources {
            resident_kib: number("VmRSS:")?,
            peak_kib: number("VmHWM:")?,
            handles: self.handles(),
            threads: number("Threads:")?,
        })
    }

    /// Number of open handles.
    pub(crate) fn handles(&self) -> usize {
        std::fs::read_dir(self.file("fd")).map_or(0, Iterator::count)
    }

    fn file(&self, name: &str) -> String {
        format!("/proc/{}/{name}", self.child.id())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
