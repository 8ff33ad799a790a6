//! A bench with ports and control API, in a thread of this process.

use std::ffi::OsString;
use std::io::Write as _;
use std::os::unix::net::UnixStream;
use std::sync::{Mutex, PoisonError, mpsc};
use std::thread::JoinHandle;

use drivetwin_host::{Configuration, Running};
use pyo3::prelude::*;

use crate::errors::{Error, wrong};

/// A run of `drivetwin run` in a thread of this process.
#[pyclass(frozen, module = "drivetwin._native")]
pub(crate) struct Server {
    json: String,
    /// `None` when the run is ended.
    run: Mutex<Option<Run>>,
    process: u32,
}

/// A run that is not ended.
struct Run {
    thread: JoinHandle<Result<(), String>>,
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

#[pymethods]
impl Server {
    /// Starts a run with these arguments of the command line.
    #[new]
    fn new(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<Self> {
        let (stopped, stop) = UnixStream::pair()?;
        let (to_caller, begun) = mpsc::channel();
        // The run belongs to its thread from the beginning.
        let run = move || {
            let running = begin(arguments).and_then(|running| Ok((running.json()?, running)));
            match running {
                Ok((json, running)) => {
                    let _ = to_caller.send(Ok(json));
                    running.serve(&stopped)
                }
                Err(sentence) => {
                    let _ = to_caller.send(Err(sentence));
                    Ok(())
                }
            }
        };
        let thread = std::thread::Builder::new().name("drivetwin".into()).spawn(run)?;
        let json =
            py.detach(move || begun.recv()).map_err(|_| panicked())?.map_err(|sentence| wrong(&sentence))?;
        Ok(Self { json, run: Mutex::new(Some(Run { thread, stop })), process: std::process::id() })
    }

    /// The line of `drivetwin run --json`.
    #[getter]
    fn json(&self) -> &str {
        &self.json
    }

    /// Ends the run. Its files are then complete, and its ports are closed.
    fn stop(&self, py: Python<'_>) -> PyResult<()> {
        let Some(mut run) = self.take_run() else { return Ok(()) };
        let ended = py.detach(|| {
            run.end();
            run.thread.join()
        });
        let ended = ended.map_err(|_| panicked())?;
        ended.map_err(|sentence| wrong(&sentence))
    }
}

/// Opens the ports of a run.
fn begin(arguments: Vec<OsString>) -> Result<Running, String> {
    let configuration = Configuration::read(drivetwin_cli::run_options(arguments)?)?;
    if configuration.uses_stdio() {
        return Err("stdio: is not possible here: standard input is that of Python".to_owned());
    }
    configuration.prepare()?.open()
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
