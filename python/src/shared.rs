//! The class of a bench, and what its drives, pins and ports share with it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_host::{Loan, Memories, Offline, OnBoard, Possession, Streams, Wait, Waited};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{self, DriveId};
use drivetwin_sim::commands::{Drive, OnBench, Refusal};
use drivetwin_sim::config::time_mode::TimeMode;
use pyo3::prelude::*;
use pyo3::sync::MutexExt as _;

use crate::errors::{Error, NotOnBoard, refused, wrong};
use crate::server::Server;

/// Greatest time in seconds: 31 years.
const LONGEST: f64 = 1e9;

/// Number of events between two looks for Ctrl-C: some milliseconds.
const EVENTS: usize = 4_096;

/// Longest wait for a run in real time between two looks for what a call waits for.
const NAP: std::time::Duration = std::time::Duration::from_millis(1);

/// Longest wait between two looks for Ctrl-C.
const PATIENCE: std::time::Duration = std::time::Duration::from_millis(100);

/// A bench of drives in this process, on virtual time: no ports, no threads. Time passes only in `advance`, `run_until` and
/// `ask`, and the same calls always have the same results. `with Bench() as bench:` closes it at the end. `drivetwin.run`
/// returns one with ports, which are served by a thread.
#[pyclass(frozen, mapping, module = "drivetwin")]
pub(crate) struct Bench {
    pub(crate) shared: Arc<Shared>,
}

/// A bench, its lock, and the process that it belongs to.
pub(crate) struct Shared {
    place: Place,
    /// True while a call asks a drive in real time. A master on a line asks one request after the other.
    asking: AtomicBool,
    process: u32,
}

/// Place of a bench.
enum Place {
    /// Here; `None` when it is closed.
    Here(Mutex<Option<Box<Here>>>),
    /// In the thread of a run. The flag is set while a call uses the bench, and stays set if the call panics.
    Run(Server, AtomicBool),
}

struct Here {
    offline: Offline,
    streams: Streams,
}

/// A bench that is not closed, while a call uses it.
pub(crate) struct Open<'a> {
    pub(crate) bench: &'a mut bench::Bench,
    pub(crate) streams: &'a mut Streams,
    /// Memories of a bench that has no ports.
    pub(crate) memories: &'a mut Memories,
    pub(crate) time_mode: &'a mut TimeMode,
}

impl Open<'_> {
    /// Returns true if only calls move the clock.
    pub(crate) fn is_manual(&self) -> bool {
        *self.time_mode == TimeMode::Manual
    }
}

impl Shared {
    pub(crate) fn new(offline: Offline) -> Arc<Self> {
        let here = Here { offline, streams: Streams::default() };
        Self::at(Place::Here(Mutex::new(Some(Box::new(here)))))
    }

    pub(crate) fn of_run(server: Server) -> Arc<Self> {
        Self::at(Place::Run(server, AtomicBool::new(false)))
    }

    fn at(place: Place) -> Arc<Self> {
        Arc::new(Self { place, asking: AtomicBool::new(false), process: std::process::id() })
    }

    /// The run that serves the bench; `None` if it has no ports.
    pub(crate) fn server(&self) -> Option<&Server> {
        match &self.place {
            Place::Here(_) => None,
            Place::Run(server, _) => Some(server),
        }
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
    pub(crate) fn with<T: Send>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&mut Open<'_>) -> T + Send,
    ) -> PyResult<T> {
        self.check_process()?;
        match &self.place {
            Place::Here(here) => {
                let mut here = here.lock_py_attached(py).map_err(|_| panicked())?;
                here.as_mut().map(|here| here.lend(act)).ok_or_else(closed)
            }
            Place::Run(server, in_use) => borrow(py, server, in_use, act),
        }
    }

    /// The board that is the whole bench; `None` if the bench has its own clock.
    pub(crate) fn board(&self) -> Option<&OnBoard> {
        self.server().and_then(Server::board)
    }

    /// The board of a drive; `None` if the drive is emulated here.
    pub(crate) fn board_of(&self, drive: DriveId) -> Option<&OnBoard> {
        self.server().and_then(|server| server.board_of(drive))
    }

    /// Refuses what a bench cannot do that is a board alone.
    pub(crate) fn refuse_on_board(&self, reason: &'static str) -> PyResult<()> {
        if self.board().is_some() { Err(NotOnBoard::new_err(reason)) } else { Ok(()) }
    }

    /// Refuses what the board of a drive cannot do.
    pub(crate) fn refuse_on_board_of(&self, drive: DriveId, reason: &'static str) -> PyResult<()> {
        if self.board_of(drive).is_some() { Err(NotOnBoard::new_err(reason)) } else { Ok(()) }
    }

    /// Refuses what a bench with a board cannot do.
    pub(crate) fn refuse_with_boards(&self, reason: &'static str) -> PyResult<()> {
        let has_boards = self.server().is_some_and(Server::has_boards);
        if has_boards { Err(NotOnBoard::new_err(reason)) } else { Ok(()) }
    }

    /// Acts on a drive of the bench, or on the board.
    pub(crate) fn act<T: Send>(
        &self,
        py: Python<'_>,
        id: DriveId,
        act: impl FnOnce(&mut dyn Drive) -> Result<T, Refusal> + Send,
    ) -> PyResult<T> {
        let done = match self.board_of(id) {
            None => self.with(py, |open| act(&mut OnBench::new(open.bench, id)))?,
            Some(board) => {
                self.check_process()?;
                if self.is_closed(py)? {
                    return Err(closed());
                }
                py.detach(|| act(&mut board.drive()?))
            }
        };
        done.map_err(refused)
    }

    /// Waits until the recording has what a board has done until now.
    pub(crate) fn catch_up(&self, py: Python<'_>) -> PyResult<()> {
        if !self.server().is_some_and(Server::has_boards) {
            return Ok(());
        }
        let at = match self.board() {
            Some(board) => py.detach(|| board.drive()?.now()).map_err(refused)?,
            None => self.with(py, |open| open.bench.now())?,
        };
        self.poll(py, |open| (open.bench.recorded_until() >= at).then_some(()))
    }

    /// Like [`with`](Self::with), while other threads of Python run: for what takes long.
    pub(crate) fn with_detached<T: Send>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&mut Open<'_>) -> T + Send,
    ) -> PyResult<T> {
        self.check_process()?;
        match &self.place {
            Place::Here(here) => {
                let act = |here: &mut Box<Here>| here.lend(act);
                let done = py.detach(|| here.lock().map(|mut here| here.as_mut().map(act)).map_err(drop));
                done.map_err(|()| panicked())?.ok_or_else(closed)
            }
            Place::Run(server, in_use) => borrow(py, server, in_use, act),
        }
    }

    /// Calls `act` until it returns something. While the clock follows the wall clock, there is a pause before the next
    /// call; else `act` moves the clock. Looks for Ctrl-C in between.
    pub(crate) fn poll<T: Send>(
        &self,
        py: Python<'_>,
        mut act: impl FnMut(&mut Open<'_>) -> Option<T> + Send,
    ) -> PyResult<T> {
        loop {
            let (done, is_manual) = self.with_detached(py, |open| (act(open), open.is_manual()))?;
            if let Some(done) = done {
                return Ok(done);
            }
            if !is_manual {
                py.detach(nap);
            }
            py.check_signals()?;
        }
    }

    /// Lets a span pass: at once in virtual time, else by the wall clock. Looks for Ctrl-C in between.
    pub(crate) fn wait(&self, py: Python<'_>, span: Duration) -> PyResult<()> {
        if self.board().is_none() {
            let (until, is_manual) = self.with(py, |open| (open.bench.now() + span, open.is_manual()))?;
            if is_manual {
                return self.run(py, until);
            }
            return self.poll(py, |open| (open.bench.now() >= until).then_some(()));
        }
        let now = || self.board().map_or(Ok(Instant::NEVER), |board| board.drive()?.now());
        let until = py.detach(now).map_err(refused)? + span;
        while py.detach(now).map_err(refused)? < until {
            py.detach(nap);
            py.check_signals()?;
        }
        Ok(())
    }

    /// Waits until no other thread asks a drive. The turn ends when the returned value is dropped.
    pub(crate) fn begin_to_ask(&self, py: Python<'_>) -> PyResult<Turn<'_>> {
        self.poll(py, |_| (!self.asking.swap(true, Ordering::Acquire)).then_some(()))?;
        Ok(Turn(&self.asking))
    }

    /// Runs the bench until `at`, while other threads of Python run. Looks for Ctrl-C in between.
    pub(crate) fn run(&self, py: Python<'_>, at: Instant) -> PyResult<()> {
        let moved = self.poll(py, |open| {
            let time_mode = *open.time_mode;
            if time_mode != TimeMode::Manual {
                return Some(Err(time_mode));
            }
            open.bench.run_some(at, EVENTS).then_some(Ok(()))
        })?;
        moved.map_err(|time_mode| {
            Error::new_err(format!(
                "the clock follows the wall clock (time is '{time_mode}'), so a call cannot move it; use time='manual'"
            ))
        })
    }

    pub(crate) fn is_closed(&self, py: Python<'_>) -> PyResult<bool> {
        self.check_process()?;
        Ok(match &self.place {
            Place::Here(here) => here.lock_py_attached(py).is_ok_and(|here| here.is_none()),
            Place::Run(server, _) => server.lender().is_none(),
        })
    }

    /// Ends the bench. Files of memories are then on the disk, and ports closed.
    pub(crate) fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.check_process()?;
        let here = match &self.place {
            Place::Here(here) => here,
            Place::Run(server, _) => return server.stop(py),
        };
        let closed = here.lock_py_attached(py).ok().and_then(|mut here| here.take());
        match closed {
            Some(here) => py.detach(|| here.offline.memories.sync()).map_err(|sentence| wrong(&sentence)),
            None => Ok(()),
        }
    }
}

/// The turn of a thread that asks a drive.
pub(crate) struct Turn<'a>(&'a AtomicBool);

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Release);
    }
}

impl Here {
    fn lend<T>(&mut self, act: impl FnOnce(&mut Open<'_>) -> T) -> T {
        let Self { offline: Offline { bench, memories }, streams } = self;
        act(&mut Open { bench, streams, memories, time_mode: &mut TimeMode::Manual })
    }
}

/// Calls `act` with the bench of a run, and waits until its changes have had their effect. Other threads of Python run
/// meanwhile: the bench does not wait for one of them.
fn borrow<T: Send>(
    py: Python<'_>,
    server: &Server,
    in_use: &AtomicBool,
    act: impl FnOnce(&mut Open<'_>) -> T + Send,
) -> PyResult<T> {
    let lender = server.lender().ok_or_else(closed)?;
    let mut act = Some(act);
    let mut loan = lender.borrow();
    let (done, mut effect) =
        until_over(py, || loan.wait(PATIENCE).map(|loan| use_loan(loan, in_use, act.take())))?;
    let Some(done) = done else { return Err(panicked()) };
    until_over(py, || effect.wait(PATIENCE))?;
    Ok(done)
}

/// Calls `act` with a bench on loan, and gives it back; `None` if an earlier call has panicked.
fn use_loan<T>(
    mut loan: Loan,
    in_use: &AtomicBool,
    act: Option<impl FnOnce(&mut Open<'_>) -> T>,
) -> (Option<T>, Wait<()>) {
    let mut done = None;
    if !in_use.swap(true, Ordering::Relaxed) {
        let Possession { bench, streams, time_mode } = &mut loan.lent;
        let mut open = Open { bench, streams, memories: &mut Memories::default(), time_mode };
        done = act.map(|act| act(&mut open));
        in_use.store(false, Ordering::Relaxed);
    }
    (done, loan.give_back())
}

/// Calls `wait` until it is over, while other threads of Python run. Looks for Ctrl-C in between.
fn until_over<T: Send>(py: Python<'_>, mut wait: impl FnMut() -> Waited<T> + Send) -> PyResult<T> {
    loop {
        match py.detach(&mut wait) {
            Waited::Over(what) => return Ok(what),
            Waited::NotYet => py.check_signals()?,
            Waited::Ended => return Err(closed()),
        }
    }
}

/// Waits for the wall clock.
#[expect(
    clippy::disallowed_methods,
    reason = "no event tells when a call can go on that waits for bench time"
)]
fn nap() {
    std::thread::sleep(NAP);
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
