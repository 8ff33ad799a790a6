//! A bench with ports and control API, in a thread of this process.

use std::collections::{BTreeMap, HashMap};
use std::ffi::OsString;
use std::io::Write as _;
use std::os::unix::net::UnixStream;
use std::sync::{Arc, Mutex, PoisonError, Weak, mpsc};
use std::thread::JoinHandle;

use drivetwin_firmware::device::Port;
use drivetwin_host::options::{AttachOptions, RunOptions};
use drivetwin_host::{Configuration, Lender, OnBoard, Running};
use drivetwin_sim::bench::DriveId;
use pyo3::prelude::*;

use crate::errors::{Error, wrong};

/// A run of `drivetwin run` in a thread of this process.
pub(crate) struct Server {
    /// URL of the control API; `None` if it is off.
    control: Option<String>,
    /// URIs of each drive and port.
    uris: Uris,
    /// The boards, by their drives on the bench.
    boards: Boards,
    /// True if the bench is a board alone, whose clock it has.
    is_attached: bool,
    run: Arc<Slot>,
}

/// Boards, by their drives on the bench.
type Boards = BTreeMap<DriveId, OnBoard>;

/// Place of a run, and the process that has its thread.
struct Slot {
    /// `None` when the run is ended.
    run: Mutex<Option<Run>>,
    process: u32,
}

/// Runs that may not be ended yet.
static RUNS: Mutex<Vec<Weak<Slot>>> = Mutex::new(Vec::new());

/// A run that is not ended.
struct Run {
    thread: JoinHandle<Result<(), String>>,
    lender: Lender,
    /// Ends the run when it is written to.
    stop: UnixStream,
}

impl Run {
    /// Ends the run, and waits until its files are complete and its ports closed.
    fn end(mut self) -> Result<(), Ended> {
        // A run that has ended by itself hears nothing.
        let _ = self.stop.write_all(b"x");
        self.thread.join().map_err(|_| Ended::Panicked)?.map_err(Ended::Failed)
    }
}

/// Reason why a run did not end well.
enum Ended {
    Panicked,
    Failed(String),
}

impl From<Ended> for PyErr {
    fn from(ended: Ended) -> Self {
        match ended {
            Ended::Panicked => panicked(),
            Ended::Failed(sentence) => wrong(&sentence),
        }
    }
}

impl Slot {
    fn take(&self) -> Option<Run> {
        // A child after a fork has no such thread.
        let is_own = self.process == std::process::id();
        is_own.then(|| self.run.lock().unwrap_or_else(PoisonError::into_inner).take()).flatten()
    }

    fn end(&self) -> Result<(), Ended> {
        self.take().map_or(Ok(()), Run::end)
    }
}

/// Ends all runs that this process has begun. Returns the error of the first one that did not end well.
pub(crate) fn end_all(py: Python<'_>) -> PyResult<()> {
    let ended: Vec<_> = py.detach(|| {
        let runs = std::mem::take(&mut *RUNS.lock().unwrap_or_else(PoisonError::into_inner));
        runs.iter().filter_map(Weak::upgrade).map(|run| run.end()).collect()
    });
    ended.into_iter().collect::<Result<(), Ended>>().map_err(PyErr::from)
}

/// Addresses of a run that has begun, and its lender.
struct Begun {
    lender: Lender,
    control: Option<String>,
    uris: Uris,
    boards: Boards,
}

impl Server {
    /// Starts a run with these arguments of the command line.
    pub(crate) fn start(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<Self> {
        Self::serve(py, false, move || begin(arguments))
    }

    /// Attaches a board with these arguments of the command line.
    pub(crate) fn attach(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<Self> {
        Self::serve(py, true, move || {
            let options = AttachOptions { recorded: true, ..drivetwin_cli::attach_options(arguments)? };
            drivetwin_host::attach(options)
        })
    }

    /// Serves what `begin` begins, in a thread.
    fn serve(
        py: Python<'_>,
        is_attached: bool,
        begin: impl FnOnce() -> Result<Running, String> + Send + 'static,
    ) -> PyResult<Self> {
        let (stopped, stop) = UnixStream::pair()?;
        let (to_caller, begun) = mpsc::channel();
        // The run belongs to its thread from the beginning.
        let run = move || match begin() {
            Ok(running) => {
                let (lender, control, uris) = (running.lender(), running.control(), uris(&running));
                let boards = running.boards().collect();
                let _ = to_caller.send(Ok(Begun { lender, control, uris, boards }));
                running.serve(&stopped)
            }
            Err(sentence) => {
                let _ = to_caller.send(Err(sentence));
                Ok(())
            }
        };
        let thread = std::thread::Builder::new().name("drivetwin".into()).spawn(run)?;
        let begun = py.detach(move || begun.recv()).map_err(|_| panicked())?;
        let Begun { lender, control, uris, boards } = begun.map_err(|sentence| wrong(&sentence))?;
        let run = Mutex::new(Some(Run { thread, lender, stop }));
        let run = Arc::new(Slot { run, process: std::process::id() });
        let mut runs = RUNS.lock().unwrap_or_else(PoisonError::into_inner);
        runs.retain(|run| run.strong_count() > 0);
        runs.push(Arc::downgrade(&run));
        Ok(Self { control, uris, boards, is_attached, run })
    }

    /// Lends the bench of the run; `None` if the run is ended.
    pub(crate) fn lender(&self) -> Option<Lender> {
        let run = self.run.run.lock().unwrap_or_else(PoisonError::into_inner);
        run.as_ref().map(|run| run.lender.clone())
    }

    /// The board that is the whole bench; `None` if the bench has its own clock.
    pub(crate) fn board(&self) -> Option<&OnBoard> {
        self.boards.values().next().filter(|_| self.is_attached)
    }

    /// The board of a drive; `None` if the drive is emulated here.
    pub(crate) fn board_of(&self, drive: DriveId) -> Option<&OnBoard> {
        self.boards.get(&drive)
    }

    /// Returns true if a drive is on a board.
    pub(crate) fn has_boards(&self) -> bool {
        !self.boards.is_empty()
    }

    /// URL of the control API; `None` if it is off.
    pub(crate) fn control(&self) -> Option<&str> {
        self.control.as_deref()
    }

    /// URIs of a port of a drive.
    pub(crate) fn uris(&self, drive: &str, port: Port) -> &[String] {
        self.uris.get(&(drive.to_owned(), port)).map_or(&[], Vec::as_slice)
    }

    /// Ends the run. Its files are then complete, and its ports are closed.
    pub(crate) fn stop(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.run.end()).map_err(PyErr::from)
    }
}

/// URIs of each drive and port. A board that becomes a drive of another kind keeps its port, with another name.
type Uris = HashMap<(String, Port), Vec<String>>;

/// Opens the ports of a run.
fn begin(arguments: Vec<OsString>) -> Result<Running, String> {
    let options = RunOptions { recorded: true, ..drivetwin_cli::run_options(arguments)? };
    let configuration = Configuration::read(options)?;
    if configuration.uses_stdio() {
        return Err("stdio: is not possible here: standard input is that of Python".to_owned());
    }
    configuration.prepare()?.open()
}

/// URIs of the ports of a run.
fn uris(running: &Running) -> Uris {
    let ports = running.drives().flat_map(|(name, spec)| {
        (0..).map(Port).zip(spec.ports).map(move |(number, port)| (name, number, port.name))
    });
    ports.map(|(name, number, port)| ((name.to_owned(), number), running.uris(name, port))).collect()
}

fn panicked() -> PyErr {
    Error::new_err("the run has panicked, which is a defect of drivetwin")
}

impl Drop for Server {
    fn drop(&mut self) {
        // Nobody hears an error. The thread of the run needs nothing of Python, so it ends also if this one cannot let go
        // of the interpreter.
        let _ = Python::try_attach(|py| self.stop(py));
        let _ = self.run.end();
    }
}
