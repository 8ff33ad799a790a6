//! The class of a bench, and what its drives, pins and ports share with it.

use std::sync::{Arc, Mutex};

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_host::{Memories, Offline};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench;
use pyo3::prelude::*;
use pyo3::sync::MutexExt as _;

use crate::errors::{Error, wrong};

/// Greatest time in seconds: 31 years.
const LONGEST: f64 = 1e9;

/// Number of events between two looks for Ctrl-C: some milliseconds.
const EVENTS: usize = 4_096;

/// A bench of drives on virtual time, in this process: no ports, no threads. Time passes only in `advance`, `run_until` and
/// `ask`, and the same calls always have the same results. `with Bench() as bench:` closes it at the end.
#[pyclass(frozen, mapping, module = "drivetwin")]
pub(crate) struct Bench {
    pub(crate) shared: Arc<Shared>,
}

/// A bench, its lock, and the process that it belongs to.
pub(crate) struct Shared {
    /// `None` when the bench is closed.
    open: Mutex<Option<Open>>,
    process: u32,
}

/// A bench that is not closed.
pub(crate) struct Open {
    pub(crate) bench: bench::Bench,
    pub(crate) memories: Memories,
}

impl Shared {
    pub(crate) fn new(Offline { bench, memories }: Offline) -> Arc<Self> {
        let open = Mutex::new(Some(Open { bench, memories }));
        Arc::new(Self { open, process: std::process::id() })
    }

    /// Returns whether this is the process that made the bench. After a fork, a thread of the parent may have left the
    /// lock taken.
    fn is_own(&self) -> bool {
        self.process == std::process::id()
    }

    fn check_process(&self) -> PyResult<()> {
        if self.is_own() {
            return Ok(());
        }
        Err(Error::new_err("the bench belongs to the process that made it; make another one after a fork"))
    }

    /// Calls `act` with the bench, when no other thread uses it. `act` creates no Python object.
    pub(crate) fn with<T>(&self, py: Python<'_>, act: impl FnOnce(&mut Open) -> T) -> PyResult<T> {
        self.check_process()?;
        let open = self.open.lock_py_attached(py);
        let mut open = open.map_err(|_| panicked())?;
        open.as_mut().map(act).ok_or_else(closed)
    }

    /// Like [`with`](Self::with), while other threads of Python run: for what takes long.
    pub(crate) fn with_detached<T: Send>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&mut Open) -> T + Send,
    ) -> PyResult<T> {
        self.check_process()?;
        let done = py.detach(|| self.open.lock().map(|mut open| open.as_mut().map(act)).map_err(drop));
        done.map_err(|()| panicked())?.ok_or_else(closed)
    }

    /// Runs the bench until `at`, while other threads of Python run. Looks for Ctrl-C in between.
    pub(crate) fn run(&self, py: Python<'_>, at: Instant) -> PyResult<()> {
        while !self.with_detached(py, |open| open.bench.run_some(at, EVENTS))? {
            py.check_signals()?;
        }
        Ok(())
    }

    pub(crate) fn is_closed(&self, py: Python<'_>) -> PyResult<bool> {
        self.check_process()?;
        Ok(self.open.lock_py_attached(py).is_ok_and(|open| open.is_none()))
    }

    /// Ends the bench. Files of memories are then on the disk.
    pub(crate) fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.check_process()?;
        let closed = self.open.lock_py_attached(py).ok().and_then(|mut open| open.take());
        match closed {
            Some(open) => py.detach(|| open.memories.sync()).map_err(|sentence| wrong(&sentence)),
            None => Ok(()),
        }
    }
}

fn panicked() -> PyErr {
    Error::new_err("a call of the bench has panicked, which is a defect of drivetwin; its state is lost")
}

fn closed() -> PyErr {
    Error::new_err("the bench is closed")
}

/// A span of `seconds`, which an argument `name` has.
pub(crate) fn span(name: &str, seconds: f64) -> PyResult<Duration> {
    if !(0.0..=LONGEST).contains(&seconds) {
        return Err(Error::new_err(format!("{name} takes seconds from 0 to {LONGEST}, not {seconds}")));
    }
    Ok(Duration::from_ticks((seconds * TICKS_PER_SECOND as f64).round() as u64))
}

/// Seconds since the start of the bench.
pub(crate) fn seconds(at: Instant) -> f64 {
    at.ticks() as f64 / TICKS_PER_SECOND as f64
}
