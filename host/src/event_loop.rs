//! The thread that owns the bench.
//!
//! The thread sleeps until the bench's next deadline or until input arrives. Then it runs the bench up to
//! that moment and gives the input that moment as its timestamp. Requests and calls of the control API are
//! served one at a time.

use std::collections::{HashMap, VecDeque};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::{Arc, Weak, mpsc};
use std::time::{Duration as WallSpan, Instant as WallInstant};

use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_sim::bench::{Bench, Bus, DriveId, EarlyRequests, IdleRun, StartingRequests};
use drivetwin_sim::config::time_mode::TimeMode;
use drivetwin_sim::decode;
use drivetwin_sim::record::trace::Event;
use rustix::event::EventfdFlags;
use tokio::sync::{oneshot, watch};
use tracing::{Level, enabled, error, info, warn};

use crate::clock::{Clock, wall};
use crate::live_file::LiveFile;
use crate::milestones::Milestones;
use crate::ports::Ports;
use crate::streams::Streams;

/// Longest lag behind the wall clock that the bench makes up. A longer lag is skipped.
const MAX_LAG: Duration = Duration::secs(1);

/// Longest run of the bench between two polls for input.
const BUDGET: WallSpan = WallSpan::from_millis(20);

/// Bench time that runs between two reads of the wall clock.
const SLICE: Duration = Duration::millis(10);

/// Maximum number of messages that one pass of the loop writes to the log.
const MESSAGES: usize = 256;

/// Longest bench time between two writes to the files.
const FILE_INTERVAL: Duration = Duration::millis(100);

/// A job for the bench's thread.
type Job = Box<dyn FnOnce(&mut EventLoop) -> Completion + Send>;

/// Called when a job has had its whole effect on the bench.
type Completion = Box<dyn FnOnce() + Send>;

/// A query of the bench and its clock. It changes nothing.
type Query = Box<dyn FnOnce(&EventLoop) + Send>;

/// Submitted work, with the caller that waits for its result.
struct Submission<T> {
    what: T,
    /// The caller drops its strong reference when it has left.
    caller: Weak<()>,
}

/// Submitted work that is not done yet, in the order of its arrival.
struct Queue<T> {
    from: mpsc::Receiver<Submission<T>>,
    waiting: VecDeque<Submission<T>>,
}

impl<T> Queue<T> {
    fn new(from: mpsc::Receiver<Submission<T>>) -> Self {
        Self { from, waiting: VecDeque::new() }
    }

    /// Collects submitted work and drops work whose caller has left, so that a caller has at most one job in
    /// the queue.
    fn collect(&mut self) {
        self.waiting.extend(self.from.try_iter());
        self.waiting.retain(|submission| submission.caller.strong_count() > 0);
    }

    fn next(&mut self) -> Option<T> {
        self.waiting.pop_front().map(|submission| submission.what)
    }
}

/// Handle by which other threads submit work to the bench's thread.
#[derive(Clone)]
pub(crate) struct BenchHandle {
    jobs: mpsc::Sender<Submission<Job>>,
    queries: mpsc::Sender<Submission<Query>>,
    waker: Arc<OwnedFd>,
    /// A number that changes with what readers see, except for time that goes on by itself. Published only while there
    /// is a reader.
    grown: Arc<watch::Sender<u64>>,
}

/// The receiving end of submitted work, for the bench's thread.
pub(crate) struct Inbox {
    jobs: Queue<Job>,
    queries: Queue<Query>,
    waker: Arc<OwnedFd>,
    grown: Arc<watch::Sender<u64>>,
}

/// A handle for other threads, and the inbox that the [`EventLoop`] takes.
///
/// # Errors
/// The system gives no event descriptor.
pub(crate) fn handle() -> io::Result<(BenchHandle, Inbox)> {
    let waker = rustix::event::eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
    let waker = Arc::new(waker);
    let ((to_jobs, jobs), (to_queries, queries)) = (mpsc::channel(), mpsc::channel());
    let grown = Arc::new(watch::Sender::new(0));
    let handle = BenchHandle {
        jobs: to_jobs,
        queries: to_queries,
        waker: Arc::clone(&waker),
        grown: Arc::clone(&grown),
    };
    let (jobs, queries) = (Queue::new(jobs), Queue::new(queries));
    Ok((handle, Inbox { jobs, queries, waker, grown }))
}

impl BenchHandle {
    /// Submits a job and wakes the bench's thread; has no effect if that thread has ended. The function that
    /// the job returns is called when the job has had its whole effect. If `caller` is dropped before the job
    /// has begun, the job is dropped as well.
    pub(crate) fn submit<A>(&self, caller: Weak<()>, job: impl FnOnce(&mut EventLoop) -> A + Send + 'static)
    where
        A: FnOnce() + Send + 'static,
    {
        let what: Job = Box::new(|event_loop| Box::new(job(event_loop)));
        if self.jobs.send(Submission { what, caller }).is_ok() {
            wake(&self.waker);
        }
    }

    /// Submits a query. Queries run between two jobs, and also while the effect of a job is still pending.
    pub(crate) fn query(&self, caller: Weak<()>, query: impl FnOnce(&EventLoop) + Send + 'static) {
        if self.queries.send(Submission { what: Box::new(query), caller }).is_ok() {
            wake(&self.waker);
        }
    }

    /// A receiver that is notified when the trace or a journal grows, a job is done, or the clock of manual time advances.
    pub(crate) fn watch(&self) -> watch::Receiver<u64> {
        self.grown.subscribe()
    }
}

/// An advance of the clock in manual time.
struct Advance {
    until: Instant,
    /// Notifies the waiting caller; closed when the caller has left.
    done: oneshot::Sender<()>,
}

/// The bench, its ports, its files and its clock: everything that belongs to the bench's thread.
pub(crate) struct EventLoop {
    /// The bench.
    pub(crate) bench: Bench,
    /// Clients in this process.
    pub(crate) streams: Streams,
    ports: Ports,
    files: Vec<LiveFile>,
    /// The clock; `None` in manual time, and while a board has the clock.
    clock: Option<Clock>,
    /// True if the clock is that of a board.
    follows_board: bool,
    warned: bool,
    advance: Option<Advance>,
    /// In manual time, the run that completes the effect of the last change.
    idle_run: Option<IdleRun>,
    /// Called when the idle run is complete, if a job made the change.
    completion: Option<Completion>,
    /// Time at which the thread wakes without input.
    alarm: Option<WallInstant>,
    inbox: Inbox,
    /// Number of jobs done.
    jobs: u64,
    /// Number of the last received message that is in the log.
    logged: u64,
    /// Number of received messages that are not in the log, because there were too many at once.
    left_out: u64,
    left_out_logged: Milestones,
    /// Number of requests that were too early when the log was last updated.
    logged_early: u64,
    /// The warnings of such requests on each line.
    early: HashMap<Bus, Milestones>,
    /// Number of requests to starting drives when the log was last updated.
    logged_starting: u64,
    /// The warnings of such requests to each drive.
    starting: HashMap<DriveId, Milestones>,
}

impl EventLoop {
    /// An event loop for `bench` with `ports` and `files`, in the given time mode.
    pub(crate) fn new(
        bench: Bench,
        ports: Ports,
        time_mode: TimeMode,
        files: Vec<LiveFile>,
        inbox: Inbox,
    ) -> Self {
        let mut event_loop = Self {
            bench,
            streams: Streams::default(),
            ports,
            files,
            clock: None,
            follows_board: false,
            warned: false,
            advance: None,
            idle_run: None,
            completion: None,
            alarm: None,
            inbox,
            jobs: 0,
            logged: 0,
            left_out: 0,
            left_out_logged: Milestones::default(),
            logged_early: 0,
            early: HashMap::new(),
            logged_starting: 0,
            starting: HashMap::new(),
        };
        event_loop.set_time_mode(time_mode);
        event_loop
    }

    /// Lets the clock be that of a board, whose reports move it.
    pub(crate) fn follow_board(&mut self) {
        (self.clock, self.follows_board) = (None, true);
    }

    /// Returns true if the clock is that of a board.
    pub(crate) fn follows_board(&self) -> bool {
        self.follows_board
    }

    /// Replaces the bench, because a board is a drive of another kind now. The files end with the old bench.
    pub(crate) fn replace_bench(&mut self, bench: Bench) {
        let old = std::mem::replace(&mut self.bench, bench);
        for file in self.files.drain(..) {
            let path = file.path().display().to_string();
            match file.finish(&old) {
                Ok(()) => warn!("{path} ends here, because the board is another drive now"),
                Err(sentence) => error!("{sentence}"),
            }
        }
    }

    /// The time mode.
    pub(crate) fn time_mode(&self) -> TimeMode {
        if self.follows_board {
            return TimeMode::Times(1);
        }
        self.clock.as_ref().map_or(TimeMode::Manual, |clock| TimeMode::Times(clock.factor))
    }

    /// Sets the time mode. In manual time, pending effects are completed first.
    pub(crate) fn set_time_mode(&mut self, time_mode: TimeMode) {
        if self.follows_board {
            return;
        }
        self.bench.set_frame_timeout(time_mode.frame_timeout());
        self.bench.judge_silence(time_mode != TimeMode::Manual);
        self.bench.forget_silence();
        if time_mode == TimeMode::Manual
            && self.bench.buses().into_iter().any(|bus| self.bench.is_strict(bus))
        {
            warn!("strict has no effect in manual time");
        }
        self.clock = match time_mode {
            TimeMode::Times(factor) => Some(Clock::new(factor, wall(), self.bench.now())),
            TimeMode::Manual => None,
        };
        self.begin_idle_run();
    }

    /// Bench time at a wall time.
    pub(crate) fn bench_time(&self, wall: WallInstant) -> Instant {
        self.clock.as_ref().map_or(self.bench.now(), |clock| clock.at(wall))
    }

    /// Runs the bench until `until`, then notifies `done`. If the caller leaves before that, the run stops.
    pub(crate) fn advance(&mut self, until: Instant, done: oneshot::Sender<()>) {
        self.advance = Some(Advance { until, done });
    }

    /// In manual time, starts to run the bench until it is idle, so that a change has its whole effect before
    /// the next change. In other time modes it does nothing.
    pub(crate) fn begin_idle_run(&mut self) {
        if self.clock.is_none() {
            self.idle_run = Some(self.bench.begin_idle_run());
        }
    }

    /// Returns whether an advance or a change is not complete yet. Meanwhile jobs wait.
    fn is_busy(&self) -> bool {
        self.advance.is_some() || self.idle_run.is_some()
    }

    /// Serves until `stop` becomes readable, or until all ports are closed for good.
    ///
    /// # Errors
    /// The system cannot wait for events.
    pub(crate) fn run(&mut self, stop: &impl AsFd) -> io::Result<()> {
        let stop = self.ports.wake_for(stop)?;
        let waker = self.ports.wake_for(&self.inbox.waker)?;
        while !self.ports.are_over() {
            self.sleep()?;
            if self.ports.is_ready(stop) {
                break;
            }
            // If a request from a port took longer than one pass, submitted work goes before further input.
            let others = self.idle_run.is_some() && self.completion.is_none();
            self.catch_up();
            if !others {
                self.take();
            }
            if self.ports.is_ready(waker) {
                self.work();
            }
            self.catch_up();
            self.deliver();
            self.publish();
        }
        Ok(())
    }

    /// Executes the submitted jobs that are left.
    pub(crate) fn do_jobs(&mut self) {
        self.inbox.jobs.collect();
        while let Some(job) = self.inbox.jobs.next() {
            job(self)();
        }
    }

    /// Records that events of a drive on a board may be missing now.
    pub(crate) fn report_missing(&mut self, name: &str) {
        let at = self.bench_time(wall());
        if let Some(drive) = self.bench.find_drive(name) {
            self.bench.report(drive, at, Event::Missing { events: None });
        }
    }

    /// Completes recordings that wait for reports of boards, at the present time.
    pub(crate) fn complete_recordings(&mut self) {
        self.catch_up();
        self.bench.complete_recordings();
    }

    /// Completes the files at the present time of the bench. Returns a sentence for each file that is not
    /// complete.
    pub(crate) fn end_files(&mut self) -> Vec<String> {
        self.files.drain(..).filter_map(|file| file.finish(&self.bench).err()).collect()
    }

    /// Next instant at which the bench or a file has work.
    fn next(&self) -> Instant {
        let files = if self.files.is_empty() { Instant::NEVER } else { self.bench.now() + FILE_INTERVAL };
        self.bench.next().min(files)
    }

    /// Writes new events to the files, and notifies readers.
    fn publish(&mut self) {
        self.log_received();
        self.log_early();
        self.log_starting();
        for file in &mut self.files {
            file.update(&self.bench);
        }
        self.bench.mark_written();
        if self.inbox.grown.receiver_count() > 0 {
            let by_hand = if self.clock.is_none() { self.bench.now().ticks() } else { 0 };
            let mark = self.bench.trace().mark() + self.bench.received_count() + self.jobs;
            let is_waiting = self.bench.records_at() < Instant::NEVER;
            let recorded = if is_waiting { self.bench.recorded_until().ticks() } else { 0 };
            let mark = mark.wrapping_add(by_hand).wrapping_add(recorded);
            self.inbox.grown.send_if_modified(|seen| std::mem::replace(seen, mark) != mark);
        }
    }

    /// Writes the messages that the drives have received to the log (`-v`), a line each. If there are too many
    /// to write at once, those that are left out are counted in a line of their own, at each power of ten.
    fn log_received(&mut self) {
        let count = self.bench.received_count();
        if count == self.logged {
            return;
        }
        if enabled!(Level::INFO) {
            let news = self.bench.received_after(self.logged, MESSAGES);
            for (receiver, message) in news.messages() {
                info!("{}", self.bench.received_line(receiver, &message));
            }
            self.left_out += count - news.last() + news.lost();
            if self.left_out_logged.is_reached(self.left_out) {
                info!(
                    "messages so far that are not in this log, because there were too many: {}",
                    self.left_out
                );
            }
        }
        self.logged = count;
    }

    /// Warns of the first request on each line that is too early, and again at each power of ten.
    fn log_early(&mut self) {
        if self.bench.early_count() == self.logged_early {
            return;
        }
        self.logged_early = self.bench.early_count();
        for bus in self.bench.buses() {
            let EarlyRequests { count, last } = self.bench.early_requests(bus);
            let Some(last) = last.filter(|_| self.early.entry(bus).or_default().is_reached(count)) else {
                continue;
            };
            let name = self.bench.bus_name(bus);
            let times = if count == 1 { String::new() } else { format!(", {count} times so far") };
            if self.bench.is_strict(bus) && self.clock.is_some() {
                warn!("{name}: dropped a request that was too early: {last}{times}");
            } else {
                warn!("{name}: a drive may ignore this request on a real line: {last}{times}");
            }
        }
    }

    /// Warns of the first request to each drive that is starting, and again at each power of ten.
    fn log_starting(&mut self) {
        if self.bench.starting_count() == self.logged_starting {
            return;
        }
        self.logged_starting = self.bench.starting_count();
        for drive in self.bench.drives() {
            let StartingRequests { count, left } = self.bench.starting_requests(drive);
            if !self.starting.entry(drive).or_default().is_reached(count) {
                continue;
            }
            let (name, starting) = (self.bench.name(drive), decode::starting(left));
            let times = if count == 1 { String::new() } else { format!(", {count} times so far") };
            warn!("{name}: a request was lost: {starting}{times}");
        }
    }

    /// Takes inputs from the ports, also during an advance of the clock. An immediate answer is delivered
    /// before the next input is taken, so that a client that waits for the first of many answers is woken
    /// only once (HOST-19).
    fn take(&mut self) {
        while self.idle_run.is_none() && self.ports.take(&mut self.bench, self.clock.as_ref()) {
            if self.clock.is_none() {
                self.begin_idle_run();
                self.catch_up();
            } else {
                self.bench.run_until(self.bench.now());
            }
            self.deliver();
        }
    }

    /// Delivers to the clients what the drives have sent.
    fn deliver(&mut self) {
        self.streams.collect(&mut self.bench);
        let delivered = self.ports.deliver(&mut self.bench);
        if delivered && self.idle_run.is_none() {
            self.begin_idle_run();
        }
    }

    /// Sleeps until input arrives or work is due.
    fn sleep(&mut self) -> io::Result<()> {
        let (due, now) = (self.due(), wall());
        if self.is_busy() || due.is_some_and(|due| due <= now) {
            return self.ports.wait(true);
        }
        // Most inputs do not change the time of the alarm.
        if due != self.alarm {
            self.alarm = due;
            self.ports.set_alarm(due.map(|due| due.saturating_duration_since(now)));
        }
        self.ports.wait(false)
    }

    /// Wall time of the next work that needs no input; `None` for never, as in manual time.
    fn due(&self) -> Option<WallInstant> {
        let next = self.next().min(self.ports.deadline()).min(self.bench.records_at());
        self.clock.as_ref()?.when(next)
    }

    /// Runs the bench up to the present time, but no longer than [`BUDGET`].
    fn catch_up(&mut self) {
        if self.idle_run.is_none()
            && let Some(advance) = self.advance.take()
        {
            self.run_towards(advance.until, wall());
            if self.bench.now() < advance.until && !advance.done.is_closed() {
                self.advance = Some(advance);
                return;
            }
            self.begin_idle_run();
            // The caller may have left.
            self.completion = Some(Box::new(|| {
                let _ = advance.done.send(());
            }));
        }
        if let Some(idle_run) = self.idle_run {
            if !self.run_until_idle_some(idle_run) {
                return;
            }
            self.idle_run = None;
            if let Some(completion) = self.completion.take() {
                completion();
            }
        }
        let next = self.next();
        let Some(clock) = &mut self.clock else { return };
        let wall = wall();
        let lag = clock.at(wall).since(next);
        if lag > MAX_LAG * u64::from(clock.factor) {
            *clock = Clock::new(clock.factor, wall, next);
            self.bench.forget_silence();
            if !std::mem::replace(&mut self.warned, true) {
                warn!(
                    "the bench fell more than a second behind the wall clock; its time is late from now on"
                );
            }
        }
        let target = clock.at(wall);
        self.run_towards(target, wall);
    }

    /// Runs the bench to `target`, but stops when [`BUDGET`] has passed since `began`.
    fn run_towards(&mut self, target: Instant, began: WallInstant) {
        loop {
            let slice = self.next().max(self.bench.now()) + SLICE;
            self.bench.run_until(slice.min(target));
            self.publish();
            if self.bench.now() >= target || began.elapsed() >= BUDGET {
                break;
            }
        }
    }

    /// Continues to run the bench until idle, but no longer than [`BUDGET`]. Returns whether it is idle.
    fn run_until_idle_some(&mut self, idle_run: IdleRun) -> bool {
        let began = wall();
        loop {
            let slice = self.next().max(self.bench.now()) + SLICE;
            if self.bench.continue_idle_run(idle_run, slice) {
                return true;
            }
            if began.elapsed() >= BUDGET {
                return false;
            }
            self.publish();
        }
    }

    /// Executes submitted work: at most one query and one job per pass, so that the ports are served between
    /// two jobs of a caller. While the effect of a job is still pending, queries run and jobs wait.
    fn work(&mut self) {
        let _ = rustix::io::read(&*self.inbox.waker, &mut [0; 8]);
        self.inbox.queries.collect();
        self.inbox.jobs.collect();
        if let Some(query) = self.inbox.queries.next() {
            query(self);
            wake(&self.inbox.waker);
        }
        if self.is_busy() {
            return wake(&self.inbox.waker);
        }
        if let Some(job) = self.inbox.jobs.next() {
            let completion = job(self);
            self.jobs += 1;
            if self.idle_run.is_some() {
                self.completion = Some(completion);
            } else {
                completion();
            }
            // More submitted work may be waiting.
            wake(&self.inbox.waker);
        }
    }
}

fn wake(waker: &OwnedFd) {
    // A write fails only after 2⁶⁴ writes without a read.
    let _ = rustix::io::write(waker, &1_u64.to_ne_bytes());
}

#[cfg(test)]
mod tests {
    use std::io::{Read as _, Write as _};
    use std::net::TcpStream;

    use super::*;

    /// Serves a QSB that streams all the time to `talk`, in real time. Returns the number of queries that the thread of
    /// the bench has executed, and the time.
    fn queries(talk: impl FnOnce(&dyn Fn(&str) -> TcpStream) + Send) -> (usize, WallSpan) {
        let mut bench = Bench::new();
        let device = drivetwin_sim::catalog::make("qsb-d").unwrap();
        let setup = drivetwin_sim::bench::Setup { boot_fast: true, ..Default::default() };
        let qsb = bench.add_with("q", device, setup).unwrap();
        bench.run_until(Instant::ZERO + Duration::millis(10));
        bench.ask(qsb, b"W0C1\r");
        bench.ask(qsb, b"S0E\r");
        let (handle, inbox) = handle().unwrap();
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        listener.set_nonblocking(true).unwrap();
        let address = listener.local_addr().unwrap();
        let (places, boards) = (crate::api::Places::new(), crate::api::Boards::default());
        let _api = crate::api::serve(listener, &[], handle, places, boards).unwrap();
        let ports = Ports::new().unwrap();
        let mut event_loop = EventLoop::new(bench, ports, TimeMode::Times(1), Vec::new(), inbox);
        let ask = move |path: &str| {
            let mut connection = TcpStream::connect(address).unwrap();
            let request = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n");
            connection.write_all(request.as_bytes()).unwrap();
            connection
        };
        let (began, mut count) = (wall(), 0);
        let mark = event_loop.bench.trace().mark();
        std::thread::scope(|scope| {
            let talking = scope.spawn(move || talk(&ask));
            // A bench that has done nothing yet shows nothing.
            while !talking.is_finished() || event_loop.bench.trace().mark() <= mark + 10 {
                event_loop.catch_up();
                event_loop.inbox.queries.collect();
                while let Some(query) = event_loop.inbox.queries.next() {
                    query(&event_loop);
                    count += 1;
                }
                event_loop.inbox.jobs.collect();
                while let Some(job) = event_loop.inbox.jobs.next() {
                    job(&mut event_loop)();
                }
                event_loop.publish();
                std::thread::yield_now();
            }
        });
        (count, began.elapsed())
    }

    /// Reads until `text` has come `count` times.
    fn read_until(connection: &mut TcpStream, text: &str, count: usize) {
        let (mut read, mut piece) = (String::new(), [0; 4096]);
        while read.matches(text).count() < count {
            let length = connection.read(&mut piece).unwrap();
            assert!(length > 0, "the connection is closed: {read}");
            read.push_str(&String::from_utf8_lossy(&piece[..length]));
        }
    }

    #[test]
    fn without_a_reader_the_bench_is_not_looked_at() {
        let (count, _) = queries(|ask| {
            for _ in 0..50 {
                read_until(&mut ask("/api/drives/q"), "\"registers\"", 1);
            }
        });
        assert_eq!(count, 0);
    }

    #[test]
    fn a_reader_looks_at_a_busy_bench_at_most_30_times_a_second() {
        let (count, span) = queries(|ask| read_until(&mut ask("/api/live?drive=q"), "event: update", 20));
        // One query finds the drive, and the first look waits for nothing.
        let most = 2 + span.as_millis() / 33;
        assert!((20..=most).contains(&(count as u128)), "{count} in {span:?}");
    }

    #[test]
    fn work_whose_caller_has_left_is_dropped() {
        let (to, from) = mpsc::channel();
        let mut queue = Queue::new(from);
        let here = Arc::new(());
        for what in 0..1_000 {
            to.send(Submission { what, caller: Weak::new() }).unwrap();
        }
        to.send(Submission { what: 1_000, caller: Arc::downgrade(&here) }).unwrap();
        queue.collect();
        assert_eq!(queue.waiting.len(), 1);
        assert_eq!((queue.next(), queue.next()), (Some(1_000), None));
    }
}
