//! Loans of the bench of a run to other threads of the process.
//!
//! The thread of the bench lends it between two of its jobs and waits until it comes back, so a loan sees a bench at
//! rest, and clients see the effect of a loan as a whole, as that of a call of the control API.

use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::time::Duration as WallSpan;

use drivetwin_sim::bench::Bench;
use drivetwin_sim::config::time_mode::TimeMode;

use crate::event_loop::{BenchHandle, EventLoop};
use crate::streams::Streams;

/// Lends the bench of a run to other threads. [`Running::lender`](crate::Running::lender) returns it.
///
/// ```
/// use std::io::Write as _;
/// use std::os::unix::net::UnixStream;
/// use std::time::Duration;
///
/// use drivetwin_host::options::RunOptions;
/// use drivetwin_host::{Configuration, Waited};
/// use drivetwin_firmware::device::Duration as BenchSpan;
/// use drivetwin_sim::config::time_mode::TimeMode;
///
/// let options = RunOptions { what: "md3".into(), time: Some(TimeMode::Manual), ..RunOptions::default() };
/// let running = Configuration::read(options)?.prepare()?.open()?;
/// let lender = running.lender();
/// let (stop, mut stopper) = UnixStream::pair()?;
/// let other = std::thread::spawn(move || {
///     let Waited::Over(mut loan) = lender.borrow().wait(Duration::from_secs(10)) else { panic!("it is busy") };
///     let at = loan.lent.bench.now() + BenchSpan::secs(3);
///     loan.lent.bench.run_until(at);
///     assert!(matches!(loan.give_back().wait(Duration::from_secs(10)), Waited::Over(())));
///     stopper.write_all(b"x").unwrap();
///     assert!(matches!(lender.borrow().wait(Duration::from_secs(10)), Waited::Ended));
/// });
/// running.serve(&stop)?;
/// other.join().unwrap();
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct Lender {
    handle: BenchHandle,
}

/// A bench and what belongs to it.
pub struct Possession {
    /// The bench.
    pub bench: Bench,
    /// The clients in this process.
    pub streams: Streams,
    /// The time mode; a change takes effect when the loan is over.
    pub time_mode: TimeMode,
}

/// A bench on loan. It goes back when this value is dropped.
pub struct Loan {
    /// The bench, and what belongs to it.
    pub lent: Possession,
    back: Sender<Possession>,
    /// Hears when the changes of the borrower have had their effect.
    effect: Receiver<()>,
}

impl Loan {
    /// Gives the bench back. The wait is over when the changes have had their whole effect.
    #[must_use]
    pub fn give_back(mut self) -> Wait<()> {
        let (_, nothing) = mpsc::channel();
        Wait { from: std::mem::replace(&mut self.effect, nothing), _caller: Arc::new(()) }
    }
}

impl Drop for Loan {
    fn drop(&mut self) {
        let time_mode = self.lent.time_mode;
        let empty = Possession { bench: Bench::default(), streams: Streams::default(), time_mode };
        // The thread of the bench waits for it.
        let _ = self.back.send(std::mem::replace(&mut self.lent, empty));
    }
}

/// A wait for a bench, or for the effect of a loan.
pub struct Wait<T> {
    from: Receiver<T>,
    /// The job is dropped if its caller has left.
    _caller: Arc<()>,
}

/// State of a [`Wait`].
pub enum Waited<T> {
    /// The wait is over.
    Over(T),
    /// The wait goes on.
    NotYet,
    /// The run has ended.
    Ended,
}

impl<T> Waited<T> {
    /// Changes what a wait that is over has.
    pub fn map<U>(self, change: impl FnOnce(T) -> U) -> Waited<U> {
        match self {
            Self::Over(what) => Waited::Over(change(what)),
            Self::NotYet => Waited::NotYet,
            Self::Ended => Waited::Ended,
        }
    }
}

impl<T> Wait<T> {
    /// Waits for at most `span`.
    pub fn wait(&mut self, span: WallSpan) -> Waited<T> {
        match self.from.recv_timeout(span) {
            Ok(what) => Waited::Over(what),
            Err(RecvTimeoutError::Timeout) => Waited::NotYet,
            Err(RecvTimeoutError::Disconnected) => Waited::Ended,
        }
    }
}

impl Lender {
    pub(crate) fn new(handle: BenchHandle) -> Self {
        Self { handle }
    }

    /// Asks for the bench. It comes when all earlier jobs have had their effect.
    #[must_use]
    pub fn borrow(&self) -> Wait<Loan> {
        let (to_borrower, from) = mpsc::sync_channel(1);
        let caller = Arc::new(());
        self.handle.submit(Arc::downgrade(&caller), move |event_loop| lend(event_loop, &to_borrower));
        Wait { from, _caller: caller }
    }
}

/// Lends the bench, and waits for it. Returns the function that tells the borrower that its changes have had their
/// whole effect.
fn lend(event_loop: &mut EventLoop, borrower: &SyncSender<Loan>) -> impl FnOnce() + Send + use<> {
    let (back, returned) = mpsc::channel();
    let (effective, effect) = mpsc::channel();
    let time_mode = event_loop.time_mode();
    let bench = std::mem::take(&mut event_loop.bench);
    let streams = std::mem::take(&mut event_loop.streams);
    let loan = Loan { lent: Possession { bench, streams, time_mode }, back, effect };
    // A borrower that has left drops the loan, which then comes back at once.
    let _ = borrower.send(loan);
    if let Ok(lent) = returned.recv() {
        (event_loop.bench, event_loop.streams) = (lent.bench, lent.streams);
        if lent.time_mode != time_mode {
            event_loop.set_time_mode(lent.time_mode);
        }
    }
    event_loop.begin_idle_run();
    move || {
        // The borrower may have left.
        let _ = effective.send(());
    }
}
