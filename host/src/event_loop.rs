//! The thread that owns the bench, and the only file that reads the wall clock.
//!
//! It sleeps until the bench's next deadline or until something comes, brings the bench to that
//! moment, and takes what has come: that is an input's stamp. Requests and calls of the control API
//! are served one at a time.

use std::collections::VecDeque;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::{Arc, Weak, mpsc};
use std::time::{Duration as WallSpan, Instant as WallInstant};

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_protocol::time::TICKS_PER_SECOND;
use drivetwin_sim::bench::{Bench, Settling};
use drivetwin_sim::config::time_mode::Pace;
use rustix::event::EventfdFlags;
use tokio::sync::{oneshot, watch};
use tracing::warn;

use crate::live_file::Followed;
use crate::ports::Ports;

/// How far the bench may fall behind the wall clock before the rest is given up.
const MAX_LAG: Duration = Duration::secs(1);

/// How long the bench may run before somebody looks whether something has come.
const BUDGET: WallSpan = WallSpan::from_millis(20);

/// Bench time between two looks at the wall clock.
const SLICE: Duration = Duration::millis(10);

/// How far the bench goes, at most, until the files follow.
const SWEEP: Duration = Duration::millis(100);

/// Bench time as the wall clock paces it: at `wall` it was `bench`.
struct Clock {
    factor: u32,
    wall: WallInstant,
    bench: Instant,
}

impl Clock {
    /// A clock that shows `bench` at `wall`.
    fn new(factor: u32, wall: WallInstant, bench: Instant) -> Self {
        Self { factor, wall, bench }
    }

    /// What it shows at `wall`.
    fn at(&self, wall: WallInstant) -> Instant {
        let passed = wall.saturating_duration_since(self.wall).as_nanos() * u128::from(self.factor);
        let ticks = passed * u128::from(TICKS_PER_SECOND) / 1_000_000_000;
        self.bench + Duration::from_ticks(u64::try_from(ticks).unwrap_or(u64::MAX))
    }

    /// When it shows `bench`, rounded up; `None` if that is never.
    fn when(&self, bench: Instant) -> Option<WallInstant> {
        if bench == Instant::NEVER {
            return None;
        }
        let ticks = u128::from(bench.since(self.bench).ticks()) * 1_000_000_000;
        let nanos = ticks.div_ceil(u128::from(TICKS_PER_SECOND) * u128::from(self.factor));
        self.wall.checked_add(WallSpan::from_nanos(u64::try_from(nanos).ok()?))
    }
}

/// A piece of work for the bench's thread.
type Job = Box<dyn FnOnce(&mut Host) -> Answer + Send>;

/// Tells who has handed in a piece of work that it has had its whole effect.
type Answer = Box<dyn FnOnce() + Send>;

/// A look at the bench, which changes nothing.
type Look = Box<dyn FnOnce(&Bench) + Send>;

/// Work that was handed in, and whoever waits for it.
struct Asked<T> {
    what: T,
    /// Gone when the caller has left.
    caller: Weak<()>,
}

/// Work that was handed in and is not done yet, the oldest first.
struct Queue<T> {
    from: mpsc::Receiver<Asked<T>>,
    waiting: VecDeque<Asked<T>>,
}

impl<T> Queue<T> {
    fn new(from: mpsc::Receiver<Asked<T>>) -> Self {
        Self { from, waiting: VecDeque::new() }
    }

    /// Takes what has come, and drops what nobody waits for any more: so there is no more than there are callers.
    fn tidy(&mut self) {
        self.waiting.extend(self.from.try_iter());
        self.waiting.retain(|asked| asked.caller.strong_count() > 0);
    }

    fn next(&mut self) -> Option<T> {
        self.waiting.pop_front().map(|asked| asked.what)
    }
}

/// Where other threads hand in work for the bench's thread.
#[derive(Clone)]
pub(crate) struct Door {
    jobs: mpsc::Sender<Asked<Job>>,
    looks: mpsc::Sender<Asked<Look>>,
    bell: Arc<OwnedFd>,
    /// How far the trace has come, told while somebody wants to know.
    grown: Arc<watch::Sender<u64>>,
}

/// What was handed in, as the bench's thread finds it.
pub(crate) struct Inbox {
    jobs: Queue<Job>,
    looks: Queue<Look>,
    bell: Arc<OwnedFd>,
    grown: Arc<watch::Sender<u64>>,
}

/// A door for others, and what is behind it for the [`Host`].
///
/// # Errors
/// The system gives no event descriptor.
pub(crate) fn door() -> io::Result<(Door, Inbox)> {
    let bell = rustix::event::eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
    let bell = Arc::new(bell);
    let ((to_jobs, jobs), (to_looks, looks)) = (mpsc::channel(), mpsc::channel());
    let grown = Arc::new(watch::Sender::new(0));
    let door = Door { jobs: to_jobs, looks: to_looks, bell: Arc::clone(&bell), grown: Arc::clone(&grown) };
    let (jobs, looks) = (Queue::new(jobs), Queue::new(looks));
    Ok((door, Inbox { jobs, looks, bell, grown }))
}

impl Door {
    /// Hands in a piece of work and wakes the thread; without effect when that has ended. What the work returns
    /// is called when its whole effect is there. Work that has not begun when its `caller` is gone is dropped.
    pub(crate) fn hand_in<A>(&self, caller: Weak<()>, job: impl FnOnce(&mut Host) -> A + Send + 'static)
    where
        A: FnOnce() + Send + 'static,
    {
        let what: Job = Box::new(|host| Box::new(job(host)));
        if self.jobs.send(Asked { what, caller }).is_ok() {
            ring(&self.bell);
        }
    }

    /// Hands in a look at the bench. It is let in between two jobs, and also while one of them has its effect.
    pub(crate) fn look(&self, caller: Weak<()>, look: impl FnOnce(&Bench) + Send + 'static) {
        if self.looks.send(Asked { what: Box::new(look), caller }).is_ok() {
            ring(&self.bell);
        }
    }

    /// Who is told whenever something new is in the trace. What is there already is not told of.
    pub(crate) fn watch(&self) -> watch::Receiver<u64> {
        self.grown.subscribe()
    }
}

/// A way to go in manual time.
struct Advance {
    until: Instant,
    /// Who waits for it; gone if nobody does any more.
    done: oneshot::Sender<()>,
}

/// The bench, its ports, and its clock.
pub(crate) struct Host {
    /// The bench.
    pub(crate) bench: Bench,
    ports: Ports,
    files: Vec<Followed>,
    /// The clock; `None` in manual time.
    clock: Option<Clock>,
    warned: bool,
    advance: Option<Advance>,
    /// In manual time, what was done last, until it has had its whole effect.
    settling: Option<Settling>,
    /// Who waits for that, if it was no port.
    answer: Option<Answer>,
    /// When the thread wakes though nothing comes.
    alarm: Option<WallInstant>,
    inbox: Inbox,
}

impl Host {
    /// `bench` with `ports`, paced by `pace` from now on, and followed by `files`.
    pub(crate) fn new(bench: Bench, ports: Ports, pace: Pace, files: Vec<Followed>, inbox: Inbox) -> Self {
        let mut host = Self {
            bench,
            ports,
            files,
            clock: None,
            warned: false,
            advance: None,
            settling: None,
            answer: None,
            alarm: None,
            inbox,
        };
        host.set_pace(pace);
        host
    }

    /// How time runs.
    pub(crate) fn pace(&self) -> Pace {
        self.clock.as_ref().map_or(Pace::Manual, |clock| Pace::Times(clock.factor))
    }

    /// Lets time run otherwise from now on. Where it stands, what was under way has its whole effect
    /// first.
    pub(crate) fn set_pace(&mut self, pace: Pace) {
        self.bench.set_patience(pace.patience());
        self.clock = match pace {
            Pace::Times(factor) => Some(Clock::new(factor, wall(), self.bench.now())),
            Pace::Manual => None,
        };
        self.settle();
    }

    /// Runs the bench for `span`; `done` is told when it is there. A caller that is gone stops it.
    pub(crate) fn advance(&mut self, span: Duration, done: oneshot::Sender<()>) {
        self.advance = Some(Advance { until: self.bench.now() + span, done });
    }

    /// In manual time, what was just done, or is due now, has its whole effect before anything else is done.
    pub(crate) fn settle(&mut self) {
        if self.clock.is_none() {
            self.settling = Some(self.bench.begin_to_settle());
        }
    }

    /// Whether something is still on its way to its end, and jobs wait.
    fn is_busy(&self) -> bool {
        self.advance.is_some() || self.settling.is_some()
    }

    /// Serves until something can be read from `stop`, or the ports are of no use any more.
    ///
    /// # Errors
    /// The system does not let it wait.
    pub(crate) fn run(&mut self, stop: &impl AsFd) -> io::Result<()> {
        let stop = self.ports.wake_for(stop)?;
        let bell = self.ports.wake_for(&self.inbox.bell)?;
        while !self.ports.are_over() {
            self.sleep()?;
            if self.ports.is_ready(stop) {
                break;
            }
            // After a long request it is the others' turn.
            let others = self.settling.is_some() && self.answer.is_none();
            self.catch_up();
            if !others {
                self.take();
            }
            if self.ports.is_ready(bell) {
                self.work();
            }
            self.catch_up();
            self.hand_out();
            self.follow();
        }
        Ok(())
    }

    /// Ends the files where the bench has come to; of each one that is not complete a sentence that says why.
    pub(crate) fn end_files(&mut self) -> Vec<String> {
        self.files.drain(..).filter_map(|file| file.finish(&self.bench).err()).collect()
    }

    /// When something is to be done with the bench.
    fn next(&self) -> Instant {
        let sweep = if self.files.is_empty() { Instant::NEVER } else { self.bench.now() + SWEEP };
        self.bench.next().min(sweep)
    }

    /// Lets those follow what has happened who want to know.
    fn follow(&mut self) {
        for file in &mut self.files {
            file.follow(&self.bench);
        }
        self.bench.has_written();
        if self.inbox.grown.receiver_count() > 0 {
            let mark = self.bench.trace().mark();
            self.inbox.grown.send_if_modified(|told| std::mem::replace(told, mark) != mark);
        }
    }

    /// Takes what has come to the ports, also while the clock is advanced. Each is answered before the next is looked at,
    /// if a drive answers at once: who waits for the first of many answers is woken once, and not again by each.
    fn take(&mut self) {
        while self.settling.is_none() && self.ports.take(&mut self.bench, self.clock.is_none()) {
            if self.clock.is_none() {
                self.settle();
                self.catch_up();
            } else {
                self.bench.run_until(self.bench.now());
            }
            self.hand_out();
        }
    }

    /// Hands out what the drives have sent.
    fn hand_out(&mut self) {
        let heard = self.ports.deliver(&mut self.bench);
        if heard && self.settling.is_none() {
            self.settle();
        }
    }

    /// Sleeps until something comes or is due; not at all if it is already.
    fn sleep(&mut self) -> io::Result<()> {
        let (due, now) = (self.due(), wall());
        if self.is_busy() || due.is_some_and(|due| due <= now) {
            return self.ports.wait(true);
        }
        // Mostly what came has changed nothing of that.
        if due != self.alarm {
            self.alarm = due;
            self.ports.set_alarm(due.map(|due| due.saturating_duration_since(now)));
        }
        self.ports.wait(false)
    }

    /// The time at which something is to be done though nothing comes; `None`: never, as in manual time.
    fn due(&self) -> Option<WallInstant> {
        self.clock.as_ref()?.when(self.next().min(self.ports.deadline()))
    }

    /// Brings the bench to where it should be now, or as near as a slice of time gets it.
    fn catch_up(&mut self) {
        if self.settling.is_none()
            && let Some(advance) = self.advance.take()
        {
            self.run_towards(advance.until, wall());
            if self.bench.now() < advance.until && !advance.done.is_closed() {
                self.advance = Some(advance);
                return;
            }
            self.settle();
            // Nobody may wait for it any more.
            self.answer = Some(Box::new(|| {
                let _ = advance.done.send(());
            }));
        }
        if let Some(settling) = self.settling {
            if !self.settle_some(settling) {
                return;
            }
            self.settling = None;
            if let Some(answer) = self.answer.take() {
                answer();
            }
        }
        let next = self.next();
        let Some(clock) = &mut self.clock else { return };
        let wall = wall();
        let lag = clock.at(wall).since(next);
        if lag > MAX_LAG * u64::from(clock.factor) {
            *clock = Clock::new(clock.factor, wall, next);
            if !std::mem::replace(&mut self.warned, true) {
                warn!(
                    "the bench fell more than a second behind the wall clock; its time is late from now on"
                );
            }
        }
        let target = clock.at(wall);
        self.run_towards(target, wall);
    }

    /// Runs the bench to `target`, but from `began` on no longer than is good for who waits.
    fn run_towards(&mut self, target: Instant, began: WallInstant) {
        loop {
            let slice = self.next().max(self.bench.now()) + SLICE;
            self.bench.run_until(slice.min(target));
            self.follow();
            if self.bench.now() >= target || began.elapsed() >= BUDGET {
                break;
            }
        }
    }

    /// Goes on to settle, but no longer than is good for who waits; whether that is over.
    fn settle_some(&mut self, settling: Settling) -> bool {
        let began = wall();
        loop {
            let slice = self.next().max(self.bench.now()) + SLICE;
            if self.bench.settle_until(settling, slice) {
                return true;
            }
            if began.elapsed() >= BUDGET {
                return false;
            }
            self.follow();
        }
    }

    /// Does what another thread handed in, to its end. One job at a time: who hands in the next one
    /// because this one is done may rely on it that the ports are looked at in between. Until it has its
    /// whole effect others may look, and jobs wait.
    fn work(&mut self) {
        let _ = rustix::io::read(&*self.inbox.bell, &mut [0; 8]);
        self.inbox.looks.tidy();
        self.inbox.jobs.tidy();
        if let Some(look) = self.inbox.looks.next() {
            look(&self.bench);
            ring(&self.inbox.bell);
        }
        if self.is_busy() {
            return ring(&self.inbox.bell);
        }
        if let Some(job) = self.inbox.jobs.next() {
            let answer = job(self);
            if self.settling.is_some() {
                self.answer = Some(answer);
            } else {
                answer();
            }
            // There may be more of them.
            ring(&self.inbox.bell);
        }
    }
}

fn ring(bell: &OwnedFd) {
    // It fails only when the bell has rung 2⁶⁴ times unheard.
    let _ = rustix::io::write(bell, &1_u64.to_ne_bytes());
}

#[expect(clippy::disallowed_methods, reason = "this file is the one that reads the wall clock")]
fn wall() -> WallInstant {
    WallInstant::now()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_waits_for_is_dropped() {
        let (to, from) = mpsc::channel();
        let mut queue = Queue::new(from);
        let here = Arc::new(());
        for what in 0..1_000 {
            to.send(Asked { what, caller: Weak::new() }).unwrap();
        }
        to.send(Asked { what: 1_000, caller: Arc::downgrade(&here) }).unwrap();
        queue.tidy();
        assert_eq!(queue.waiting.len(), 1);
        assert_eq!((queue.next(), queue.next()), (Some(1_000), None));
    }

    #[test]
    fn a_clock_shows_bench_time_and_wakes_no_tick_early() {
        let start = wall();
        let clock = Clock::new(10, start, Instant::from_ticks(7));
        assert_eq!(clock.at(start), Instant::from_ticks(7));
        assert_eq!(clock.at(start + WallSpan::from_millis(1)), Instant::from_ticks(7 + 160_000));
        assert_eq!(clock.when(Instant::NEVER), None);
        for ticks in [1, 2, 15, 16, 17, 12_345_678] {
            let due = Instant::from_ticks(7 + ticks);
            let when = clock.when(due).unwrap();
            assert!(clock.at(when) >= due);
            assert!(clock.at(when - WallSpan::from_nanos(1)) < due);
        }
    }
}
