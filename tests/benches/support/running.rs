//! The program `drivetwin` started as by users, and the resources of its process from `/proc`.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::time::Duration;

/// Clock ticks of the system per second, the unit of `/proc`.
const TICKS: f64 = 100.0;

/// Sleeps for `span` of wall time.
pub(crate) fn wait(span: Duration) {
    let (_open, never) = mpsc::channel::<()>();
    let _ = never.recv_timeout(span);
}

/// Builds the binary; returns its path.
pub(crate) fn build() -> PathBuf {
    let built = Command::new(env!("CARGO")).args(["build", "--release", "-p", "drivetwin-cli"]).status();
    assert!(built.is_ok_and(|status| status.success()), "drivetwin cannot be built");
    let here = std::env::current_exe().expect("a benchmark is a file");
    // …/release/deps/scale-…
    here.ancestors().nth(2).map(|release| release.join("drivetwin")).expect("it is in a target directory")
}

/// A running program that serves TCP ports. It is killed when this is dropped.
pub(crate) struct Running {
    child: Child,
    /// Address of each port.
    pub(crate) places: Vec<String>,
}

impl Running {
    /// Starts `drivetwin` with the bench file `text`.
    pub(crate) fn start(drivetwin: &Path, text: &str, options: &[&str]) -> Self {
        let file = std::env::temp_dir().join(format!("drivetwin-bench-{}.toml", std::process::id()));
        std::fs::write(&file, text).expect("there is room for a file");
        let running = Self::of(Command::new(drivetwin).arg("run").arg(&file).arg("--json").args(options));
        let _ = std::fs::remove_file(&file);
        running
    }

    /// Starts a program whose first output line has the address of each port as `tcp:HOST:PORT`.
    pub(crate) fn of(command: &mut Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().expect("it starts");
        let mut ready = String::new();
        let stdout = child.stdout.take().expect("it is piped");
        BufReader::new(stdout).read_line(&mut ready).expect("it prints its addresses");
        let places = ready.split("tcp:").skip(1).filter_map(|rest| Some(rest.split('"').next()?.to_owned()));
        Self { child, places: places.collect() }
    }

    /// CPU time used so far, in seconds of a core.
    pub(crate) fn cpu(&self) -> f64 {
        let text = self.proc("stat");
        // The name of the program may contain any characters, but is in brackets.
        let after = text.rsplit(')').next().unwrap_or("");
        let ticks = after.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok());
        ticks.sum::<f64>() / TICKS
    }

    /// Used memory in KiB.
    pub(crate) fn memory(&self) -> f64 {
        let text = self.proc("status");
        let rss = text.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        rss.and_then(|rss| rss.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(f64::NAN)
    }

    fn proc(&self, name: &str) -> String {
        std::fs::read_to_string(format!("/proc/{}/{name}", self.child.id())).expect("it runs")
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
