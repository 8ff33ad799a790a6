//! Counts of the masters, and the gate at which they wait while the bench is measured.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::now;

/// Most sentences about wrong replies that are printed.
const SENTENCES: u64 = 20;

/// Longest wait for the masters at the gate.
const PATIENCE: Duration = Duration::from_secs(60);

/// Counts of all masters.
#[derive(Default)]
pub(crate) struct Tally {
    lines: Mutex<BTreeMap<&'static str, &'static Line>>,
    /// Messages to each drive.
    drives: Mutex<BTreeMap<&'static str, &'static AtomicU64>>,
    wrong: AtomicU64,
}

/// Counts of the masters of one port.
#[derive(Default)]
pub(crate) struct Line {
    pub(crate) right: AtomicU64,
    /// Exchanges without a right reply on a port with faults.
    pub(crate) faulty: AtomicU64,
    /// Exchanges with a drive that had no power or was starting.
    pub(crate) powerless: AtomicU64,
    /// Longest time from a request to its right reply, in microseconds. If the port has several connections, it contains the
    /// wait for the replies to the others.
    longest: AtomicU64,
}

impl Line {
    /// Counts a right reply to a request that was sent at `sent`.
    pub(crate) fn answered(&self, sent: Instant) {
        self.right.fetch_add(1, Ordering::Relaxed);
        self.longest.fetch_max((now() - sent).as_micros() as u64, Ordering::Relaxed);
    }
}

/// Counts of a port, or sums of all ports.
#[derive(Clone, Copy, Default)]
pub(crate) struct Counts {
    pub(crate) right: u64,
    pub(crate) faulty: u64,
    pub(crate) powerless: u64,
    /// Zero for a port.
    pub(crate) wrong: u64,
    /// Longest time from a request to its right reply since the start, in microseconds.
    pub(crate) longest: u64,
}

impl Counts {
    /// The counts since those of `before`.
    pub(crate) fn since(self, before: Self) -> Self {
        Self {
            right: self.right - before.right,
            faulty: self.faulty - before.faulty,
            powerless: self.powerless - before.powerless,
            wrong: self.wrong - before.wrong,
            longest: self.longest,
        }
    }
}

/// Name of each port, with its counts.
pub(crate) type Ports = BTreeMap<&'static str, Counts>;

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Tally {
    /// The counts of a port. They live as long as the program.
    pub(crate) fn line(&self, name: &'static str) -> &'static Line {
        lock(&self.lines).entry(name).or_insert_with(|| Box::leak(Box::default()))
    }

    /// The number of messages to a drive.
    pub(crate) fn drive(&self, name: &'static str) -> &'static AtomicU64 {
        lock(&self.drives).entry(name).or_insert_with(|| Box::leak(Box::default()))
    }

    /// The drive that has got the fewest messages, and their number.
    pub(crate) fn slowest(&self) -> (&'static str, u64) {
        let drives = lock(&self.drives);
        let counts = drives.iter().map(|(name, count)| (*name, count.load(Ordering::Relaxed)));
        counts.min_by_key(|(_, count)| *count).unwrap_or(("no drive", 0))
    }

    /// Counts a reply that is wrong or missing without a fault, and prints the first ones.
    pub(crate) fn wrong(&self, sentence: &str) {
        if self.wrong.fetch_add(1, Ordering::Relaxed) < SENTENCES {
            eprintln!("{sentence}");
        }
    }

    /// The counts of each port.
    pub(crate) fn ports(&self) -> Ports {
        let counts = |line: &Line| {
            let [right, faulty, powerless, longest] =
                [&line.right, &line.faulty, &line.powerless, &line.longest]
                    .map(|count| count.load(Ordering::Relaxed));
            Counts { right, faulty, powerless, wrong: 0, longest }
        };
        lock(&self.lines).iter().map(|(name, line)| (*name, counts(line))).collect()
    }

    /// The sums.
    pub(crate) fn counts(&self) -> Counts {
        let mut counts = Counts { wrong: self.wrong.load(Ordering::Relaxed), ..Counts::default() };
        for port in self.ports().values() {
            counts.right += port.right;
            counts.faulty += port.faulty;
            counts.powerless += port.powerless;
            counts.longest = counts.longest.max(port.longest);
        }
        counts
    }
}

/// A gate at which all masters wait, each with its connections open.
#[derive(Default)]
pub(crate) struct Gate {
    is_closed: AtomicBool,
    waiting: Mutex<usize>,
    changed: Condvar,
}

impl Gate {
    /// Waits while the gate is closed.
    pub(crate) fn pass(&self) {
        if !self.is_closed.load(Ordering::Acquire) {
            return;
        }
        let mut waiting = lock(&self.waiting);
        *waiting += 1;
        self.changed.notify_all();
        while self.is_closed.load(Ordering::Acquire) {
            waiting = self.changed.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
        *waiting -= 1;
    }

    /// Returns true if the gate is closed.
    pub(crate) fn is_closed(&self) -> bool {
        self.is_closed.load(Ordering::Acquire)
    }

    /// Closes the gate, and waits until `count` masters are there. Returns false if they are not there in time.
    pub(crate) fn close(&self, count: usize) -> bool {
        self.is_closed.store(true, Ordering::Release);
        let waiting = lock(&self.waiting);
        let waited = self.changed.wait_timeout_while(waiting, PATIENCE, |waiting| *waiting < count);
        !waited.unwrap_or_else(PoisonError::into_inner).1.timed_out()
    }

    /// Opens the gate.
    pub(crate) fn open(&self) {
        let _waiting = lock(&self.waiting);
        self.is_closed.store(false, Ordering::Release);
        self.changed.notify_all();
    }
}
