//! The thread that has the control port of a board.
//!
//! The thread makes one call after the other, receives events between the answers, and asks for the state of a board from which
//! nothing has come for a while. A board that is unplugged, does not answer or starts again is connected again when it is
//! there: a new session, whose number differs. What a caller knows of the drive, for instance the number of a register, is
//! valid within one session.

use std::collections::VecDeque;
use std::io;
use std::mem;
use std::ops::ControlFlow;
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant as WallInstant};

use drivetwin_control::{Call, Events, Message, State, VERSION, fingerprint};
use drivetwin_firmware::device::{Duration as Span, Instant, Line, Spec};
use drivetwin_sim::catalog;
use drivetwin_sim::record::trace::Event;
use rustix::event::{EventfdFlags, PollFlags};
use tracing::{info, warn};

use super::answer::{AnswerTo, Answered, Failure, Hello, reply};
use super::board_clock::Seen;
use super::flash_again;
use super::link::{Link, Stop, frame};
use super::place::Target;
use super::report;
use crate::clock::{Now, now, wall};

/// Longest wait for an answer. The save of a board takes some hundredths of a second.
const PATIENCE: Duration = Duration::from_secs(2);

/// Number of attempts to get a first answer, and the wait for each: the first request may follow garbage.
const ATTEMPTS: u32 = 3;
const GREETED: Duration = Duration::from_millis(500);

/// Time without a message, and without a state, after which the state of the board is asked for.
const QUIET: Duration = Duration::from_millis(250);
const STATED: Duration = Duration::from_secs(1);

/// Greatest time that an event may be ahead of the time that has passed.
const AHEAD: Span = Span::secs(1);

/// Time between two attempts to connect a board again.
const RETRY: Duration = Duration::from_millis(250);

/// Change of a connection, or message of a board, in the order of time.
pub(crate) enum Report {
    /// A session has begun, with the drive in this state at this time.
    Begun(Session, State, Seen),
    /// Events with their times, and the wall time at which they have come.
    Events(Vec<(Instant, Event)>, WallInstant),
    /// The board was at this time.
    At(Seen),
    /// The board is gone; a session may follow.
    Gone {
        /// Time of the last report.
        last: Instant,
        /// Wall time at which the last message has come.
        received: WallInstant,
    },
}

/// Function that takes reports.
pub(crate) type Sink = Box<dyn FnMut(Report) + Send>;

/// Kind of drive that a board shall be.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Wanted {
    /// Any kind. It may become another one.
    Any,
    /// This kind, or any if it is `None`. It must not become another one.
    Kept(Option<&'static str>),
}

/// A board that is connected.
#[derive(Clone, Debug)]
pub(crate) struct Session {
    /// Number of the session.
    pub(super) number: u64,
    /// Description of the kind of drive that the board is.
    pub(crate) spec: &'static Spec,
    /// Version of the board's image.
    pub(crate) image: String,
    /// True if the drive starts without its start-up delay.
    pub(crate) fast_boot: bool,
    /// Name of the board for `drivetwin flash`; empty if its image does not say it.
    pub(super) board: String,
    /// Settings of the bus when the session began.
    pub(crate) line: Option<Line>,
    /// Ticks that the time of the board is behind: it begins with 0 whenever the board starts.
    base: u64,
    /// Time at which the session began.
    pub(crate) began: Instant,
}

impl Session {
    /// Time of `ticks` since the board started.
    pub(super) fn time(&self, ticks: u64) -> Instant {
        Instant::from_ticks(self.base.saturating_add(ticks))
    }
}

/// State that the callers share with the thread.
pub(super) struct Shared {
    status: Mutex<Status>,
    changed: Condvar,
    /// The kind that the board must be in each session; `None` if it may become another one.
    kind: Option<&'static str>,
    jobs: Mutex<Sender<Job>>,
    waker: OwnedFd,
    next_number: AtomicU16,
    stop: Stop,
}

/// The session, or the reason why there is none, in one sentence.
type Status = Result<Session, String>;

/// Work for the thread.
enum Job {
    /// A call of a session.
    Call { session: u64, number: u16, frame: Vec<u8>, answer: AnswerTo },
    /// Connects the board again.
    Reconnect,
}

impl Shared {
    fn status(&self) -> MutexGuard<'_, Status> {
        self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set(&self, status: Status) {
        *self.status() = status;
        self.changed.notify_all();
    }

    /// The kind that the board must be in each session; `None` if it may become another one.
    pub(super) fn kind(&self) -> Option<&'static str> {
        self.kind
    }

    /// The present session.
    ///
    /// # Errors
    /// One sentence: the board is gone.
    pub(super) fn session(&self) -> Result<Session, String> {
        self.status().clone()
    }

    /// Waits for a session after the one with number `last`.
    ///
    /// # Errors
    /// One sentence: there is none in time.
    pub(super) fn session_after(&self, last: u64, span: Duration) -> Result<Session, String> {
        let waits = |status: &mut Status| !matches!(status, Ok(session) if session.number > last);
        let waited = self.changed.wait_timeout_while(self.status(), span, waits);
        waited.unwrap_or_else(PoisonError::into_inner).0.clone()
    }

    fn submit(&self, job: Job) {
        // Without a thread there is nobody to work, and the caller sees that its answer never comes.
        let _ = self.jobs.lock().unwrap_or_else(PoisonError::into_inner).send(job);
        let _ = rustix::io::write(&self.waker, &1_u64.to_ne_bytes());
    }

    /// Makes a call in a session.
    ///
    /// # Errors
    /// The board refuses it, or the session is over.
    pub(super) fn ask(&self, session: u64, call: Call<'_>) -> Result<Answered, Failure> {
        self.begin(session, call)?
            .recv()
            .unwrap_or_else(|_| Err(Failure::Away("the board is no longer attached".into())))
    }

    /// Makes a call in a session, and waits for its answer for a time.
    ///
    /// # Errors
    /// The board refuses it or does not answer in time, or the session is over.
    pub(super) fn ask_within(
        &self,
        session: u64,
        call: Call<'_>,
        span: Duration,
    ) -> Result<Answered, Failure> {
        self.begin(session, call)?
            .recv_timeout(span)
            .unwrap_or_else(|_| Err(Failure::Away("the board does not answer in time".into())))
    }

    /// Begins a call in a session. Returns where its answer comes.
    fn begin(&self, session: u64, call: Call<'_>) -> Result<Receiver<Result<Answered, Failure>>, Failure> {
        let number = FIRST + self.next_number.fetch_add(1, Ordering::Relaxed) % (u16::MAX - FIRST);
        let (answer, answered) = mpsc::sync_channel(1);
        self.submit(Job::Call { session, number, frame: frame(number, call)?, answer });
        Ok(answered)
    }

    /// Lets the thread connect the board again.
    pub(super) fn reconnect(&self) {
        self.submit(Job::Reconnect);
    }
}

/// The thread, and what it shares.
pub(super) struct Client {
    pub(super) shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Client {
    fn drop(&mut self) {
        self.shared.stop.stop();
        if let Some(thread) = self.thread.take() {
            // A thread that has panicked has ended, too.
            let _ = thread.join();
        }
    }
}

impl Client {
    /// Connects a board, whose first report goes to `sink` before this function returns.
    ///
    /// # Errors
    /// One sentence: there is no board of this version of drivetwin.
    pub(super) fn connect(mut target: Target, wanted: Wanted, mut sink: Sink) -> Result<Self, String> {
        let waker = rustix::event::eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK);
        let waker = waker.map_err(|error| format!("an event descriptor cannot be created: {error}"))?;
        let first = if let Wanted::Kept(kind) = wanted { kind } else { None };
        let stop = Stop::new()?;
        let (link, session, state, seen) = open(&mut target, &stop, first, 1, (0, Instant::ZERO))?;
        let kind = matches!(wanted, Wanted::Kept(_)).then_some(session.spec.kind);
        let (jobs, from) = mpsc::channel();
        let shared = Arc::new(Shared {
            status: Mutex::new(Ok(session.clone())),
            changed: Condvar::new(),
            kind,
            jobs: Mutex::new(jobs),
            waker,
            next_number: AtomicU16::new(0),
            stop,
        });
        let mut connected = Connected::new(link, session.clone(), state.at);
        sink(Report::Begun(session, state, seen));
        let worker = Worker { shared: Arc::clone(&shared), target, from, sink, session: 1 };
        let thread = std::thread::Builder::new().name("board".into());
        let thread = thread.spawn(move || {
            let mut worker = worker;
            while let Some(end) = worker.serve(connected)
                && let Some(next) = worker.connect_again(end)
            {
                connected = next;
            }
        });
        let thread = thread.map_err(|error| format!("a thread cannot be started: {error}"))?;
        Ok(Self { shared, thread: Some(thread) })
    }
}

/// The state of the thread, beside its connection.
struct Worker {
    shared: Arc<Shared>,
    target: Target,
    from: Receiver<Job>,
    sink: Sink,
    /// Number of the last session.
    session: u64,
}

/// A connection within a session.
struct Connected {
    link: Link,
    session: Session,
    queue: VecDeque<(u16, Vec<u8>, AnswerTo)>,
    /// The call that waits for its answer.
    pending: Option<Pending>,
    /// Number of the next event; `None` before the first one.
    next_event: Option<u32>,
    /// Time of the last report.
    last: Instant,
    /// Time of the last message, and of the question to which the last state is the answer.
    received: Now,
    stated: Now,
    /// Time of the board in its last state.
    at: u64,
}

/// A call that waits for its answer.
struct Pending {
    number: u16,
    asked: Now,
    /// Where the answer goes; `None` for a question about the state.
    answer: Option<AnswerTo>,
}

impl Pending {
    /// Wall time at which patience ends.
    fn until(&self) -> WallInstant {
        self.asked.wall + PATIENCE
    }
}

/// The base of a session that has ended, and the time of its last report.
type End = (u64, Instant);

/// Least number of a call; those below are for calls of the thread itself.
const FIRST: u16 = 16;

/// Number of the questions of the thread.
const OWN: u16 = 0;

impl Connected {
    fn new(link: Link, session: Session, at: u64) -> Self {
        let queue = VecDeque::new();
        let last = session.began;
        Self {
            link,
            session,
            queue,
            pending: None,
            next_event: None,
            last,
            received: now(),
            stated: now(),
            at,
        }
    }

    /// Takes the next jobs. Returns false if the connection shall end.
    fn take(&mut self, from: &Receiver<Job>) -> bool {
        for job in from.try_iter() {
            match job {
                Job::Call { session, number, frame, answer } if session == self.session.number => {
                    self.queue.push_back((number, frame, answer));
                }
                Job::Call { answer, .. } => {
                    let over = "the board has started again meanwhile; repeat the call";
                    let _ = answer.send(Err(Failure::Away(over.into())));
                }
                Job::Reconnect => return false,
            }
        }
        true
    }

    /// Sends the next call, if none waits for its answer.
    fn send(&mut self) -> io::Result<()> {
        if self.pending.is_some() {
            return Ok(());
        }
        let asked = now();
        if let Some((number, frame, answer)) = self.queue.pop_front() {
            self.pending = Some(Pending { number, asked, answer: Some(answer) });
            return self.link.write(&frame);
        }
        if asked.wall >= question(asked, self.received, self.stated) {
            self.pending = Some(Pending { number: OWN, asked, answer: None });
            let Ok(frame) = frame(OWN, Call::State) else { return Ok(()) };
            return self.link.write(&frame);
        }
        Ok(())
    }

    /// Time until something must be done without a message.
    fn patience(&self) -> Duration {
        let now = now();
        let question = || question(now, self.received, self.stated);
        let until = self.pending.as_ref().map_or_else(question, Pending::until);
        until.saturating_duration_since(now.wall)
    }

    /// Takes messages, and passes reports to `sink`.
    ///
    /// # Errors
    /// The port is gone, or the board has started again.
    fn receive(&mut self, sink: &mut Sink) -> io::Result<()> {
        let Self { link, session, pending, next_event, last, received, stated, at, .. } = self;
        let latest = latest(*last, now().since(*received));
        let mut events: Vec<(Instant, Event)> = Vec::new();
        let (mut states, mut restarted) = (Vec::new(), false);
        link.read(|message| {
            *received = now();
            if let Message::Events(of) = message {
                take_events(session, of, latest, next_event, &mut events);
            }
            let Some((number, answer)) = reply(&message) else { return ControlFlow::Continue(()) };
            // An answer that comes too late belongs to nobody.
            let Some(Pending { asked, answer: to, .. }) =
                pending.take_if(|expected| expected.number == number)
            else {
                return ControlFlow::Continue(());
            };
            if let Ok(Answered::State(state)) = &answer {
                restarted |= state.at < *at;
                (*at, *stated) = (state.at, asked);
                let at = session.time(state.at);
                states.push(Seen { at, asked: asked.wall, answered: received.wall });
            }
            if let Some(to) = to {
                let _ = to.send(answer);
            }
            ControlFlow::Continue(())
        })?;
        if restarted {
            return Err(io::Error::other("it has started again"));
        }
        let times = events.iter().map(|(at, _)| *at).chain(states.iter().map(|seen| seen.at));
        *last = times.max().map_or(*last, |at| at.max(*last));
        if !events.is_empty() {
            sink(Report::Events(events, received.wall));
        }
        states.into_iter().for_each(|seen| sink(Report::At(seen)));
        Ok(())
    }

    /// Ends the session: no call is answered any more.
    fn end(&mut self, sentence: &str) {
        let pending = self.pending.take().and_then(|pending| pending.answer);
        let queue = mem::take(&mut self.queue).into_iter().map(|(.., answer)| answer);
        for answer in pending.into_iter().chain(queue) {
            let _ = answer.send(Err(Failure::Away(sentence.into())));
        }
    }
}

/// Wall time of the next question about the state, after a message and a state. A computer that was suspended asks at once,
/// because the board went on.
fn question(now: Now, received: Now, stated: Now) -> WallInstant {
    if now.was_suspended_since(stated) {
        return now.wall;
    }
    (received.wall + QUIET).min(stated.wall + STATED)
}

/// Latest time that an event can have if `passed` has passed since the last message, with a report at `last`: the board may
/// be more ahead than a clock can be wrong.
fn latest(last: Instant, passed: Duration) -> Instant {
    last + Span::micros(u64::try_from(passed.as_micros()).unwrap_or(u64::MAX)) + AHEAD
}

/// Takes events from a message, after [`Event::Missing`] if messages were lost on their way. An event after `latest` has a
/// wrong time, and is missing.
fn take_events(
    session: &Session,
    of: Events<'_>,
    latest: Instant,
    next: &mut Option<u32>,
    into: &mut Vec<(Instant, Event)>,
) {
    if let Some(lost @ 1..) = next.map(|next| report::missing(next, of.number)) {
        into.push((session.time(of.at).min(latest), Event::Missing { events: Some(lost) }));
    }
    let mut number = of.number;
    for (at, event) in of.decode() {
        let (at, entry) = (session.time(at), report::entry(session.spec, session.time(0), event));
        into.push(if at <= latest { (at, entry) } else { (latest, Event::Missing { events: Some(1) }) });
        number = number.wrapping_add(1);
    }
    *next = Some(number);
}

impl Worker {
    fn drain_waker(&self) {
        let _ = rustix::io::read(&self.shared.waker, &mut [0; 8]);
    }

    /// Serves a connection until it breaks, and closes it. Returns `None` if the client ends.
    fn serve(&mut self, mut connected: Connected) -> Option<End> {
        let mut is_asked_for = false;
        let broken = loop {
            if let Err(error) = connected.link.wait(&self.shared.waker, connected.patience()) {
                break error.to_string();
            }
            self.drain_waker();
            if self.shared.stop.has_come() {
                connected.end("the board is no longer attached");
                return None;
            }
            if let Err(error) = connected.receive(&mut self.sink) {
                break match error.kind() {
                    io::ErrorKind::UnexpectedEof => "it is gone".into(),
                    _ => error.to_string(),
                };
            }
            if connected.pending.as_ref().is_some_and(|pending| pending.until() <= wall()) {
                break "it does not answer".into();
            }
            if !connected.take(&self.from) {
                is_asked_for = true;
                break "it starts again".into();
            }
            if let Err(error) = connected.send() {
                break error.to_string();
            }
        };
        let sentence = format!("the board at {} cannot be reached: {broken}", self.target);
        // Whoever sees that the board is gone finds this in the recording.
        (self.sink)(Report::Gone { last: connected.last, received: connected.received.wall });
        self.shared.set(Err(sentence.clone()));
        connected.end(&sentence);
        if is_asked_for {
            info!("the board at {} starts again", self.target);
        } else {
            warn!("{sentence}; it is connected again when it is back");
        }
        Some((connected.session.base, connected.last))
    }

    /// Connects the board again when it is there. Returns `None` if the client ends.
    fn connect_again(&mut self, before: End) -> Option<Connected> {
        loop {
            match open(&mut self.target, &self.shared.stop, self.shared.kind, self.session + 1, before) {
                Ok((link, session, state, seen)) => {
                    self.session += 1;
                    info!("the board at {} is back", self.target);
                    (self.sink)(Report::Begun(session.clone(), state, seen));
                    self.shared.set(Ok(session.clone()));
                    return Some(Connected::new(link, session, state.at));
                }
                Err(sentence) => self.shared.set(Err(sentence)),
            }
            let until = wall() + RETRY;
            loop {
                let left = until.saturating_duration_since(wall());
                // If the system cannot wait, the next attempt comes at once.
                let _ = self.shared.stop.wait(&self.shared.waker, PollFlags::IN, left);
                self.drain_waker();
                if self.shared.stop.has_come() {
                    return None;
                }
                for job in self.from.try_iter() {
                    if let (Job::Call { answer, .. }, Err(sentence)) = (job, self.shared.session()) {
                        let _ = answer.send(Err(Failure::Away(sentence)));
                    }
                }
                if wall() >= until {
                    break;
                }
            }
        }
    }
}

/// Opens the control port, learns what board is there, and begins the trace. `before` is the base of the last session and the
/// time of its last report, which no report of this session precedes. Returns also the state of the drive, and its time.
///
/// # Errors
/// One sentence: there is no board of this version of drivetwin, or it is not of the wanted kind.
fn open(
    target: &mut Target,
    stop: &Stop,
    wanted: Option<&str>,
    number: u64,
    (base, last): End,
) -> Result<(Link, Session, State, Seen), String> {
    let (mut link, hello) = greet(target, stop)?;
    let spec = check(target, &hello)?;
    if let Some(wanted) = wanted.filter(|wanted| *wanted != spec.kind) {
        return Err(format!(
            "the board at {target} is a drive of the kind {}, and not {wanted}; change kind in the file, or the kind of the board: drivetwin attach, PUT /api/drives/board/kind",
            spec.kind
        ));
    }
    let mut ask = |call| match link.ask(number_of(call), call, wall() + PATIENCE) {
        Ok(answered) => Ok(answered),
        Err(Failure::Refused(_)) => Ok(Answered::Done),
        Err(Failure::Away(why)) => Err(format!("the board at {target} cannot be reached: {why}")),
    };
    ask(Call::Trace(true))?;
    let line = match ask(Call::Statistics)? {
        Answered::Statistics(statistics) => report::line(statistics.line),
        _ => None,
    };
    let asked = wall();
    let Answered::State(state) = ask(Call::State)? else {
        return Err(format!("there is no board at {target}: it answers something else"));
    };
    // The clock of a board that has started again begins with 0.
    let base = if base.saturating_add(state.at) >= last.ticks() { base } else { last.ticks() };
    let began = Instant::from_ticks(base.saturating_add(state.at));
    let seen = Seen { at: began, asked, answered: wall() };
    let Hello { image, fast_boot, board, .. } = hello;
    Ok((link, Session { number, spec, image, fast_boot, board, line, base, began }, state, seen))
}

/// Opens the control port, and learns what board is there.
///
/// # Errors
/// One sentence: there is no board, or another program uses it.
fn greet(target: &mut Target, stop: &Stop) -> Result<(Link, Hello), String> {
    let port = target.open(stop);
    let link = port.and_then(|port| Link::new(port, stop.clone()));
    let mut link = link.map_err(|error| format!("{target} cannot be opened: {error}"))?;
    let (mut failure, mut is_silent) = (String::new(), false);
    for _ in 0..ATTEMPTS {
        match link.ask(number_of(Call::Hello), Call::Hello, wall() + GREETED) {
            Ok(Answered::Hello(hello)) => return Ok((link, hello)),
            Ok(_) | Err(Failure::Refused(_)) => {
                (failure, is_silent) = ("it answers something else".into(), false);
            }
            Err(Failure::Away(why)) => (failure, is_silent) = (why, true),
        }
    }
    // A server has one connection to each board. It closes a second one, or lets it wait.
    Err(if is_silent && target.is_tcp() {
        format!("the board at {target} is in use by another program, or there is none: {failure}")
    } else {
        format!("there is no board at {target}: {failure}")
    })
}

/// Reason why a boot loader has not been started.
pub(crate) enum NotStarted {
    /// The board is another one than the user has named.
    Other {
        /// Text of its place.
        place: String,
        /// Its name for `drivetwin flash`; empty if its image does not say it.
        name: String,
    },
    /// Any other reason, in one sentence.
    Failed(String),
}

impl From<String> for NotStarted {
    fn from(sentence: String) -> Self {
        Self::Failed(sentence)
    }
}

/// Starts the boot loader of a board, if it is the one with this name for `drivetwin flash`.
///
/// # Errors
/// There is no board, or another one, or it does not start a boot loader. The drive goes on.
pub(super) fn start_boot_loader(target: &mut Target, name: &str) -> Result<(), NotStarted> {
    let (mut link, hello) = greet(target, &Stop::new()?)?;
    same_version(target, &hello)?;
    if hello.board != name {
        return Err(NotStarted::Other { place: target.to_string(), name: hello.board });
    }
    match link.ask(number_of(Call::Bootloader), Call::Bootloader, wall() + PATIENCE) {
        Err(Failure::Refused(_)) => {
            Err(NotStarted::Failed(format!("the board at {target} has no boot loader that it can start")))
        }
        // The connection breaks when the boot loader starts.
        Ok(_) | Err(Failure::Away(_)) => Ok(()),
    }
}

/// Number for a call before a session: each has its own, so that a late answer to another one is ignored.
fn number_of(call: Call<'_>) -> u16 {
    match call {
        Call::Hello => 1,
        Call::Trace(_) => 2,
        Call::Statistics => 3,
        _ => 4,
    }
}

/// Checks that a board has this version of the protocol.
///
/// # Errors
/// One sentence: it has another one.
fn same_version(target: &Target, hello: &Hello) -> Result<(), String> {
    if hello.version == VERSION {
        return Ok(());
    }
    Err(format!(
        "the board at {target} has version {} of the control protocol, and this drivetwin has {VERSION}",
        hello.version
    ))
}

/// The description of the kind of drive that a board is.
///
/// # Errors
/// One sentence: the board is of another version of drivetwin.
fn check(target: &Target, hello: &Hello) -> Result<&'static Spec, String> {
    let again = flash_again(&hello.board);
    same_version(target, hello).map_err(|why| format!("{why}: {again}"))?;
    let spec = catalog::make(&hello.kind).map(|device| device.spec());
    let spec = spec.map_err(|_| {
        let kind = hello.kind.escape_debug();
        format!(
            "the board at {target} is a drive of a kind that this drivetwin does not know, {kind}: {again}"
        )
    })?;
    if hello.tables != fingerprint(spec) {
        return Err(format!("the board at {target} has the tables of another version of drivetwin: {again}"));
    }
    Ok(spec)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A suspended computer: its wall clock stands still, and the board goes on.
    #[test]
    fn after_a_suspension_the_events_of_the_board_are_taken_and_its_time_is_asked_for_at_once() {
        let start = now();
        let after = |awake: u64, asleep: u64| Now {
            wall: start.wall + Duration::from_millis(awake),
            since_boot: start.since_boot + Duration::from_millis(awake + asleep),
        };
        let last = Instant::ZERO + Span::secs(100);
        let hour = 3_600_000;
        // 100 ms after the last message, then a suspension of an hour, or none.
        let (soon, resumed) = (after(100, 0), after(100, hour));
        let session_time = |now: Now| latest(last, now.since(start));
        assert_eq!(session_time(soon), last + Span::millis(100) + AHEAD);
        assert_eq!(session_time(resumed), last + Span::millis(100 + hour) + AHEAD);
        assert_eq!(question(soon, start, start), start.wall + QUIET);
        assert_eq!(question(resumed, start, start), resumed.wall);
        // A message has come since, but no answer to a question behind the suspension.
        assert_eq!(question(after(120, hour), resumed, start), after(120, hour).wall);
        assert_eq!(question(after(130, hour), resumed, resumed), resumed.wall + QUIET);
    }
}
