//! Expected outputs of a trace at any instant.

use drivetwin_firmware::device::{Duration, Instant, Line, Pin, Role};
use drivetwin_firmware::motion::StepIterator;
use drivetwin_sim::board::virtual_board::Done;
use drivetwin_sim::record::trace::{Event, OutputRecord, Trace};
use drivetwin_tests::on_shell::{self, Seen};

use crate::host::Connection;
use crate::patience::PLANNING;

/// A reply of the drive.
#[derive(Clone)]
pub(crate) struct Reply {
    /// The connection of the reply; `None` on a serial port.
    pub(crate) to: Option<Connection>,
    /// Instant from which the reply is due.
    pub(crate) at: Instant,
    /// Start of the first output in a sequence without pauses that contains this reply. QEMU's UART does not
    /// pace bytes, so the reply may be sent from then on.
    pub(crate) earliest: Instant,
    /// The bytes of the reply.
    pub(crate) bytes: Vec<u8>,
}

/// Expected outputs of a trace.
pub(crate) struct Expected {
    /// Replies of the drive.
    pub(crate) replies: Vec<Reply>,
    /// The line settings, each with the instant from which it holds.
    lines: Vec<(Instant, Line)>,
    /// Level changes of each pin. Before its first level a pin counts as low.
    pins: Vec<Vec<(Instant, bool)>>,
    /// True for a pin that can be an input: it is released before its first level.
    let_go: Vec<bool>,
    /// Instants at which each pin is given a level, even if the level does not change.
    given: Vec<Vec<Instant>>,
    /// STEP and DIR, if their pins also serve other purposes.
    shared: Option<(Pin, Pin)>,
    motion: Vec<(Instant, Done)>,
    /// True if the board makes step pulses.
    pub(crate) has_steps: bool,
    /// Instant of each step, and true if the step is forward.
    steps: Vec<(Instant, bool)>,
    /// Content of the memory at the end.
    pub(crate) memory: Vec<u8>,
}

impl Expected {
    /// Expectations from a trace with one drive, and from the motion of its motor. `shared` is STEP and DIR,
    /// if their pins also serve other purposes.
    pub(crate) fn of(trace: &Trace, motion: Vec<(Instant, Done)>, shared: Option<(Pin, Pin)>) -> Self {
        let [drive] = trace.drives.as_slice() else { panic!("a board has one drive") };
        // The motor of an MDrive is inside the drive, and the board does not show its millions of steps.
        let has_steps = drive.spec.axes.iter().any(|axis| axis.step_dir.is_some());
        let mut expected = Self {
            replies: Vec::new(),
            lines: Vec::new(),
            pins: vec![Vec::new(); drive.spec.pins.len()],
            let_go: drive.spec.pins.iter().map(|pin| pin.role == Role::Both).collect(),
            given: vec![Vec::new(); drive.spec.pins.len()],
            shared,
            steps: if has_steps { steps(&motion, trace.end + PLANNING) } else { Vec::new() },
            has_steps,
            motion,
            memory: drive.memory.to_vec(),
        };
        for (at, seen) in on_shell::expected(trace) {
            match seen {
                Seen::Pin(Pin(pin), high) => {
                    let changes = &mut expected.pins[usize::from(pin)];
                    // Two changes at one instant cancel each other.
                    if changes.pop_if(|(last, _)| *last == at).is_none() {
                        changes.push((at, high));
                    }
                }
                Seen::Output(OutputRecord::Line { line, .. }) => expected.lines.push((at, line)),
                Seen::Output(OutputRecord::Store { offset, bytes }) => {
                    expected.memory[usize::from(offset)..][..bytes.len()].copy_from_slice(&bytes);
                }
                // The second loop handles messages one by one. Motion is checked by plans; currents and
                // duties have no pin.
                Seen::Output(_) => {}
            }
        }
        let mut free = Instant::ZERO;
        for entry in trace.events() {
            match &entry.event {
                Event::Output(OutputRecord::Bytes { bytes, .. }) => {
                    let follows = expected.replies.last().filter(|_| free == entry.at);
                    let earliest = follows.map_or(entry.at, |before| before.earliest);
                    // The line settings of power-on take effect at once.
                    let line = expected.line(entry.at + Duration::TICK);
                    free = entry.at + line.character() * bytes.len() as u64;
                    let bytes = bytes.clone();
                    expected.replies.push(Reply { to: None, at: entry.at, earliest, bytes });
                }
                Event::Output(OutputRecord::Message { port, link, bytes }) => {
                    let to = Some((*port, *link));
                    let (at, bytes) = (entry.at, bytes.clone());
                    expected.replies.push(Reply { to, at, earliest: at, bytes });
                }
                Event::Output(OutputRecord::Level { pin, .. }) => {
                    expected.given[usize::from(pin.0)].push(entry.at);
                }
                _ => {}
            }
        }
        expected
    }

    /// Returns true if a pin is given a level after `after` and before `before`.
    pub(crate) fn is_given(&self, pin: Pin, after: Instant, before: Instant) -> bool {
        self.given[usize::from(pin.0)].iter().any(|at| (after..before).contains(at))
    }

    /// Returns true if a pin is STEP or DIR at `at`. A plan takes the pins; a level takes its pin back.
    pub(crate) fn is_axis(&self, pin: Pin, at: Instant) -> bool {
        let given = self.given[usize::from(pin.0)].iter().rev().find(|given| **given <= at);
        self.shared.is_some_and(|(step, dir)| pin == step || pin == dir)
            && self.motion.iter().any(|(from, _)| *from <= at && given.is_none_or(|given| given <= from))
    }

    /// The drive's pin that shares its pin of the board with STEP.
    pub(crate) fn shared_step(&self) -> Option<Pin> {
        self.shared.map(|(step, _)| step)
    }

    /// The line settings at `at`.
    pub(crate) fn line(&self, at: Instant) -> Line {
        let line = self.lines.iter().rev().find(|(from, _)| *from < at);
        line.expect("a drive sets its line at power-on").1
    }

    /// The level of a pin at `at`; a released pin is high.
    pub(crate) fn level(&self, pin: Pin, at: Instant) -> bool {
        let place = usize::from(pin.0);
        if self.let_go[place] && !self.given[place].iter().any(|given| *given <= at) {
            return true;
        }
        let change = self.pins[place].iter().rev().find(|(from, _)| *from <= at);
        change.is_some_and(|(_, high)| *high)
    }

    /// Returns true if a pin has this level at any time after `after` and before `before`.
    pub(crate) fn has_level(&self, pin: Pin, high: bool, after: Instant, before: Instant) -> bool {
        let place = usize::from(pin.0);
        let changes = self.pins[place].iter().map(|(at, _)| at).chain(&self.given[place]);
        let mut instants = changes.filter(|at| (after..before).contains(at)).chain([&after]);
        instants.any(|at| self.level(pin, *at) == high)
    }

    /// Number of steps from the beginning to `at`. Each plan is in effect until the next one.
    pub(crate) fn steps(&self, at: Instant) -> i32 {
        let ends = self.motion.iter().skip(1).map(|(next, _)| *next).chain([Instant::NEVER]);
        let parts = self.motion.iter().zip(ends).take_while(|((from, _), _)| *from <= at);
        parts
            .map(|((from, done), end)| match done {
                Done::Planned(_, plan) => plan.position_at(end.min(at)) - plan.position_at(*from),
                Done::Stepped(_, steps) => *steps,
                _ => 0,
            })
            .sum()
    }

    /// Returns true if the motor makes a step in this direction between `after` and `before`. The step before
    /// and the step after that range count, too: a step may be late, or early by a part of a step.
    pub(crate) fn goes(&self, forward: bool, after: Instant, before: Instant) -> bool {
        let first = self.steps.partition_point(|(at, _)| *at < after).saturating_sub(1);
        let last = self.steps.partition_point(|(at, _)| *at < before);
        self.steps.iter().take(last + 1).skip(first).any(|(_, way)| *way == forward)
    }

    /// Last order to the motor before `at`, and true if the motor was at rest at that time.
    pub(crate) fn told(&self, at: Instant) -> Option<(Instant, bool)> {
        let index = self.motion.iter().take_while(|(from, _)| *from <= at).count().checked_sub(1)?;
        let (told, _) = self.motion[index];
        let stood = index.checked_sub(1).is_none_or(|before| match &self.motion[before].1 {
            Done::Planned(_, plan) => plan.end() <= told,
            _ => true,
        });
        Some((told, stood))
    }

    /// Returns true if the motor gets a plan at any time from `after` to `at`.
    pub(crate) fn plans(&self, after: Instant, at: Instant) -> bool {
        let plan = |done: &Done| matches!(done, Done::Planned(..));
        self.motion.iter().any(|(from, done)| plan(done) && (after..=at).contains(from))
    }

    /// Instants between `after` and `before` at which the motor gets an order.
    pub(crate) fn turns(&self, after: Instant, before: Instant) -> impl Iterator<Item = Instant> {
        self.motion.iter().map(|(at, _)| *at).filter(move |at| (after..before).contains(at))
    }

    /// Greatest number of steps that may slip, because the board begins each plan up to `late` after its
    /// instant. These are the steps of the old plan and of the new plan in that time.
    pub(crate) fn slips(&self, at: Instant, late: Duration) -> i32 {
        let plans = self.motion.iter().take_while(|(from, _)| *from <= at);
        let plans: Vec<_> = plans
            .filter_map(|(from, done)| match done {
                Done::Planned(_, plan) => Some((*from, plan)),
                _ => None,
            })
            .collect();
        plans
            .windows(2)
            .filter_map(|pair| match pair {
                [(_, old), (from, new)] => {
                    let due = |plan: &drivetwin_firmware::device::Plan| {
                        (plan.position_at(*from + late) - plan.position_at(*from)).abs()
                    };
                    // A motor at rest loses no step, because the new plan is made later as a whole.
                    let moved = old.position_at(*from) != old.position_at(Instant::NEVER);
                    Some(if moved { due(old) + due(new) } else { 0 })
                }
                _ => None,
            })
            .sum()
    }

    /// Instants at which an output can be compared.
    pub(crate) fn instants(&self) -> impl Iterator<Item = Instant> {
        let replies = self.replies.iter().map(|reply| reply.at);
        let pins = self.pins.iter().flatten().map(|(at, _)| *at);
        let motion = self.motion.iter().map(|(at, _)| *at);
        replies.chain(pins).chain(motion)
    }
}

/// Each step up to `end`, with true if it is forward. Each plan is in effect until the next one.
fn steps(motion: &[(Instant, Done)], end: Instant) -> Vec<(Instant, bool)> {
    let ends = motion.iter().skip(1).map(|(next, _)| *next).chain([end]);
    let mut steps = Vec::new();
    for ((from, done), end) in motion.iter().zip(ends) {
        match done {
            Done::Planned(_, plan) => {
                let walked = StepIterator::new(plan, *from).take_while(|step| step.at <= end);
                steps.extend(walked.map(|step| (step.at, step.forward)));
            }
            Done::Stepped(_, count) => {
                steps.extend((0..count.unsigned_abs()).map(|_| (*from, *count > 0)));
            }
            _ => {}
        }
    }
    steps
}
