//! A bench with ports and control API, in a thread of this process.

use std::collections::HashMap;
use std::ffi::OsString;
use std::io::Write as _;
use std::os::unix::net::UnixStream;
use std::sync::{Mutex, PoisonError, mpsc};
use std::thread::JoinHandle;

use drivetwin_host::options::RunOptions;
use drivetwin_host::{Configuration, Lender, Running};
use pyo3::prelude::*;

use crate::errors::{Error, wrong};

/// A run of `drivetwin run` in a thread of this process.
pub(crate) struct Server {
    /// URL of the control API; `None` if it is off.
    control: Option<String>,
    /// URIs of each drive and port.
    uris: Uris,
    /// `None` when the run is ended.
    run: Mutex<Option<Run>>,
    process: u32,
}

/// A run that is not ended.
struct Run {
    thread: JoinHandle<Result<(), String>>,
    lender: Lender,
    /// Ends the run when it is written to.
    stop: UnixStream,
}

impl Run {
    fn end(&mut self) {
        // A run that has ended by itself hears nothing.
        let _ = self.stop.write_all(b"x");
    }
}

impl Server {
    fn take_run(&self) -> Option<Run> {
        // A child after a fork has no such thread.
        let is_own = self.process == std::process::id();
        is_own.then(|| self.run.lock().unwrap_or_else(PoisonError::into_inner).take()).flatten()
    }
}

/// Addresses of a run that has begun, and its lender.
struct Begun {
    lender: Lender,
    control: Option<String>,
    uris: Uris,
}

impl Server {
    /// Starts a run with these arguments of the command line.
    pub(crate) fn start(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<Self> {
        let (stopped, stop) = UnixStream::pair()?;
        let (to_caller, begun) = mpsc::channel();
        // The run belongs to its thread from the beginning.
        let run = move || match begin(arguments) {
            Ok((running, uris)) => {
                let (lender, control) = (running.lender(), running.control());
                let _ = to_caller.send(Ok(Begun { lender, control, uris }));
                running.serve(&stopped)
            }
            Err(sentence) => {
                let _ = to_caller.send(Err(sentence));
                Ok(())
            }
        };
        let thread = std::thread::Builder::new().name("drivetwin".into()).spawn(run)?;
        let begun = py.detach(move || begun.recv()).map_err(|_| panicked())?;
        let Begun { lender, control, uris } = begun.map_err(|sentence| wrong(&sentence))?;
        let run = Mutex::new(Some(Run { thread, lender, stop }));
        Ok(Self { control, uris, run, process: std::process::id() })
    }

    /// Lends the bench of the run; `None` if the run is ended.
    pub(crate) fn lender(&self) -> Option<Lender> {
        let run = self.run.lock().unwrap_or_else(PoisonError::into_inner);
        run.as_ref().map(|run| run.lender.clone())
    }

    /// URL of the control API; `None` if it is off.
    pub(crate) fn control(&self) -> Option<&str> {
        self.control.as_deref()
    }

    /// URIs of a port of a drive.
    pub(crate) fn uris(&self, drive: &str, port: &'static str) -> &[String] {
        self.uris.get(&(drive.to_owned(), port)).map_or(&[], Vec::as_slice)
    }

    /// Ends the run. Its files are then complete, and its ports are closed.
    pub(crate) fn stop(&self, py: Python<'_>) -> PyResult<()> {
        let Some(mut run) = self.take_run() else { return Ok(()) };
        let ended = py.detach(|| {
            run.end();
            run.thread.join()
        });
        let ended = ended.map_err(|_| panicked())?;
        ended.map_err(|sentence| wrong(&sentence))
    }
}

/// URIs of each drive and port.
type Uris = HashMap<(String, &'static str), Vec<String>>;

/// Opens the ports of a run.
fn begin(arguments: Vec<OsString>) -> Result<(Running, Uris), String> {
    let options = RunOptions { recorded: true, ..drivetwin_cli::run_options(arguments)? };
    let configuration = Configuration::read(options)?;
    if configuration.uses_stdio() {
        return Err("stdio: is not possible here: standard input is that of Python".to_owned());
    }
    let running = configuration.prepare()?.open()?;
    let ports =
        running.drives().flat_map(|(name, spec)| spec.ports.iter().map(move |port| (name, port.name)));
    let uris = ports.map(|(name, port)| ((name.to_owned(), port), running.uris(name, port))).collect();
    Ok((running, uris))
}

fn panicked() -> PyErr {
    Error::new_err("the run has panicked, which is a defect of drivetwin")
}

impl Drop for Server {
    fn drop(&mut self) {
        // Its thread ends without being waited for.
        if let Some(mut run) = self.take_run() {
            run.end();
        }
    }
}
