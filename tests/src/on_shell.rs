//! Replays a golden trace on the shell of a board with simulated hardware.

use drivetwin_firmware::device::{Boot, Device, Duration, Framing, Instant, Level, Line, Pin};
use drivetwin_firmware::shell::{BoardEvent, Inputs, LinkEvent, Shell, TX_ONE_REPLY, TX_REPLIES};
use drivetwin_sim::board::virtual_board::{Board, Done, SimOutputs};
use drivetwin_sim::record::trace::{Course, Event, InputRecord, OutputRecord, Power, Trace, TraceDrive};

/// An output of a drive as a board shows it. Each change of the level of a pin is an output of its own.
#[derive(Clone, PartialEq, Debug)]
pub enum Seen {
    /// Any output other than the level of a pin.
    Output(OutputRecord),
    /// A pin changes to high (true) or low.
    Pin(Pin, bool),
}

/// Outputs that a board should show for a trace with one drive, sorted by instant, then by kind.
#[must_use]
pub fn expected(trace: &Trace) -> Vec<(Instant, Seen)> {
    let mut seen = Vec::new();
    let mut pins = vec![Vec::new(); trace.drives.first().map_or(0, |drive| drive.spec.pins.len())];
    for entry in trace.events() {
        match &entry.event {
            Event::Input(_) | Event::Shaft { .. } | Event::Received(_) | Event::Missing { .. } => {}
            Event::Output(did @ (OutputRecord::Level { pin, .. } | OutputRecord::Wave { pin, .. })) => {
                pins[usize::from(pin.0)].push((entry.at, did.clone()));
            }
            Event::Output(did) => seen.push((entry.at, Seen::Output(did.clone()))),
        }
    }
    for (pin, orders) in (0..).map(Pin).zip(pins) {
        seen.extend(levels(&orders, trace.end).into_iter().map(|(at, high)| (at, Seen::Pin(pin, high))));
    }
    sorted(seen)
}

/// Level changes of a pin that starts low and follows `orders` until `end`.
fn levels(orders: &[(Instant, OutputRecord)], end: Instant) -> Vec<(Instant, bool)> {
    let mut changes = Vec::new();
    for (index, (at, order)) in orders.iter().enumerate() {
        let until = orders.get(index + 1).map_or(end + Duration::TICK, |(next, _)| *next);
        match *order {
            OutputRecord::Level { level, .. } => changes.push((*at, level != Level::Low)),
            OutputRecord::Wave { period, high, .. } => {
                let mut rise = *at;
                while rise < until {
                    changes.push((rise, true));
                    changes.extend(Some((rise + high, false)).filter(|(fall, _)| *fall < until));
                    rise += period;
                }
            }
            _ => {}
        }
    }
    let mut level = false;
    changes.retain(|(_, high)| std::mem::replace(&mut level, *high) != *high);
    changes
}

/// Replays a trace with one drive on a shell and returns what its board showed. `device` makes a new drive.
///
/// # Panics
/// If the trace has an input that a board does not have.
#[must_use]
pub fn play<D: Device>(trace: &Trace, device: impl Fn() -> D) -> Vec<(Instant, Seen)> {
    let board = run(trace, device);
    let seen = board.done().iter().map(|(at, done)| (*at, as_seen(*at, done))).collect();
    sorted(seen)
}

/// Motor outputs of a trace as the shell passes them to a board: plans, and steps without a plan.
///
/// # Panics
/// Same as [`play`].
#[must_use]
pub fn motion<D: Device>(trace: &Trace, device: impl Fn() -> D) -> Vec<(Instant, Done)> {
    let moves = |done: &Done| matches!(done, Done::Planned(..) | Done::Stepped(..));
    let board = run(trace, device);
    board.done().iter().filter(|(_, done)| moves(done)).cloned().collect()
}

/// The board after a replay of the whole trace. It has as much room for replies as the images have.
fn run<D: Device>(trace: &Trace, device: impl Fn() -> D) -> Board {
    let [drive] = trace.drives.as_slice() else { panic!("a board has one drive") };
    match drive.spec.ports[0].framing {
        Framing::Silence => run_with::<D, TX_ONE_REPLY>(trace, drive, device),
        _ => run_with::<D, TX_REPLIES>(trace, drive, device),
    }
}

fn run_with<D: Device, const CHARACTERS: usize>(
    trace: &Trace,
    drive: &TraceDrive,
    device: impl Fn() -> D,
) -> Board {
    let board = Board::new(drive.spec, drive.memory.to_vec());
    let boot = Boot { seed: trace.seed, fast: drive.boot_fast, fast_line: drive.fast_line };
    let mut player: Player<_, _, CHARACTERS> = Player { board, shell: None, boot, device };
    player.go(drive.from);
    player.power(true);
    for entry in trace.events() {
        let Event::Input(fed) = &entry.event else { continue };
        match fed {
            InputRecord::Bytes { port, bytes } => {
                player.sleep_before(entry.at);
                let character = player.line().character();
                for (n, byte) in (0..).zip(bytes.iter()) {
                    player.catch(entry.at + character * n, BoardEvent::Byte(*port, *byte));
                }
            }
            InputRecord::RxError { port } => player.catch(entry.at, BoardEvent::RxError(*port)),
            InputRecord::Idle { port } => player.catch(entry.at, BoardEvent::Idle(*port)),
            InputRecord::HostPresence { port, here } => {
                player.catch(entry.at, BoardEvent::HostPresence(*port, *here));
            }
            InputRecord::Edge { pin, high } => player.catch(entry.at, BoardEvent::Edge(*pin, *high)),
            InputRecord::Millivolts { pin, mv } => player.catch(entry.at, BoardEvent::Millivolts(*pin, *mv)),
            InputRecord::Fault { fault, on } => player.catch(entry.at, BoardEvent::Fault(*fault, *on)),
            InputRecord::StepsCorrection { axis, steps } => {
                player.catch(entry.at, BoardEvent::StepsCorrection(*axis, *steps));
            }
            InputRecord::Opened { port, link } => {
                player.sleep_before(entry.at);
                player.board.come(entry.at, *port, *link, LinkEvent::Opened);
            }
            InputRecord::Message { port, link, bytes } => {
                player.sleep_before(entry.at);
                player.board.say(entry.at, *port, *link, bytes);
            }
            InputRecord::Closed { port, link } => {
                player.sleep_before(entry.at);
                player.board.come(entry.at, *port, *link, LinkEvent::Closed);
            }
            InputRecord::Power(power @ (Power::On | Power::Off)) => {
                player.sleep_before(entry.at);
                player.board.set_now(entry.at);
                player.power(*power == Power::On);
            }
            other => panic!("a board has no such input: {other:?}"),
        }
    }
    player.go(trace.end);
    assert_eq!(player.shell.map_or(0, |shell| shell.failures()), 0, "something on the board failed");
    player.board
}

fn as_seen(at: Instant, done: &Done) -> Seen {
    Seen::Output(match done {
        Done::Level(pin, high) => return Seen::Pin(*pin, *high),
        Done::Sent(port, bytes) => OutputRecord::Bytes { port: *port, bytes: bytes.clone() },
        Done::Message(port, link, bytes) => {
            OutputRecord::Message { port: *port, link: *link, bytes: bytes.clone() }
        }
        Done::Closed(port, link) => OutputRecord::Close { port: *port, link: *link },
        Done::Line(port, line) => OutputRecord::Line { port: *port, line: *line },
        Done::Stored(offset, bytes) => OutputRecord::Store { offset: *offset as u16, bytes: bytes.clone() },
        Done::Planned(axis, plan) => {
            OutputRecord::Course { axis: *axis, course: Box::new(Course::of(plan, at)) }
        }
        Done::Stepped(axis, steps) => OutputRecord::Step { axis: *axis, steps: *steps },
        Done::Current(axis, ma) => OutputRecord::CurrentLimit { axis: *axis, ma: *ma },
        Done::Duty(axis, duty) => OutputRecord::Duty { axis: *axis, duty: *duty },
    })
}

/// Outputs sorted by instant, with messages joined. A board shows outputs in the order in which it made them;
/// a trace may list an output with a later timestamp first. On a line, bytes without a pause between them are
/// one message, even if they were written in several parts. After sorting and joining both agree.
fn sorted(mut seen: Vec<(Instant, Seen)>) -> Vec<(Instant, Seen)> {
    seen.sort_by_key(|(at, seen)| (*at, format!("{seen:?}")));
    let mut character = Duration::ZERO;
    // Index of the last message, and the instant at which its last character has been sent.
    let mut last = None;
    let mut joined: Vec<(Instant, Seen)> = Vec::new();
    for (at, seen) in seen {
        match &seen {
            Seen::Output(OutputRecord::Line { line, .. }) => character = line.character(),
            Seen::Output(OutputRecord::Bytes { bytes, .. }) => {
                let end = at + character * bytes.len() as u64;
                if let Some((place, free)) = last.replace((joined.len(), end))
                    && free == at
                    && let (_, Seen::Output(OutputRecord::Bytes { bytes: before, .. })) = &mut joined[place]
                {
                    before.extend_from_slice(bytes);
                    last = Some((place, end));
                    continue;
                }
            }
            _ => {}
        }
        joined.push((at, seen));
    }
    joined
}

/// A board, and the loop that the `main` of an image would be.
struct Player<D, M, const CHARACTERS: usize> {
    board: Board,
    shell: Option<Shell<D, Board, SimOutputs, CHARACTERS>>,
    boot: Boot,
    device: M,
}

impl<D: Device, M: Fn() -> D, const CHARACTERS: usize> Player<D, M, CHARACTERS> {
    fn power(&mut self, on: bool) {
        self.shell = on.then(|| {
            let mut shell = Shell::new((self.device)(), self.board.clone(), self.board.outputs());
            shell.power_on(self.board.now(), self.boot);
            shell
        });
    }

    /// The line setting after all events so far.
    fn line(&mut self) -> Line {
        let changed = self.board.done().iter().rev().find_map(|(_, done)| match done {
            Done::Line(_, line) => Some(*line),
            _ => None,
        });
        changed.expect("a drive sets its line at power-on")
    }

    /// Sleeps until the tick before `at`, then queues an event for the instant `at`, as an interrupt would.
    fn catch(&mut self, at: Instant, caught: BoardEvent) {
        self.sleep_before(at);
        self.board.catch(at, caught);
    }

    /// Sleeps until the tick before `at`. An input at the instant of a power-on is queued before the loop
    /// polls for the first time.
    fn sleep_before(&mut self, at: Instant) {
        if self.board.now() < at {
            self.go(at - Duration::TICK);
        }
    }

    /// Sleeps and polls until `until`.
    fn go(&mut self, until: Instant) {
        loop {
            self.turn();
            let due = self.shell.as_ref().map_or(Instant::NEVER, Shell::deadline);
            let next = due.min(self.board.room_at()).min(self.board.caught_at());
            if next > until {
                break;
            }
            self.board.set_now(next);
        }
        self.board.set_now(until);
        self.turn();
    }

    fn turn(&mut self) {
        if let Some(shell) = &mut self.shell {
            while shell.poll().is_ok() {}
        }
    }
}
