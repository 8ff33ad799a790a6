//! Expectations of a trace, at any instant.

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
    /// On which connection; on a serial port, none.
    pub(crate) to: Option<Connection>,
    /// From when on.
    pub(crate) at: Instant,
    /// Start of the output that it follows without a pause. QEMU's UART paces nothing, so it may leave with that.
    pub(crate) earliest: Instant,
    /// The characters.
    pub(crate) bytes: Vec<u8>,
}

/// Expectations of a trace.
pub(crate) struct Expected {
    /// Replies of the drive.
    pub(crate) replies: Vec<Reply>,
    /// The settings of the line, and from when on.
    lines: Vec<(Instant, Line)>,
    /// The changes of each pin, which is low when it is given a level for the first time.
    pins: Vec<Vec<(Instant, bool)>>,
    /// True if it is an input before, and so is released.
    let_go: Vec<bool>,
    /// Times at which each pin was given a level, whether it changed or not.
    given: Vec<Vec<Instant>>,
    /// STEP and DIR, if they serve other purposes, too.
    shared: Option<(Pin, Pin)>,
    motion: Vec<(Instant, Done)>,
    /// True if the board makes steps.
    pub(crate) has_steps: bool,
    /// Each step, and whether it is forward.
    steps: Vec<(Instant, bool)>,
    /// Content of its memory at the end.
    pub(crate) memory: Vec<u8>,
}

impl Expected {
    /// Expectations of a trace with one drive, and of its motor. STEP and DIR may be `shared` pins.
    pub(crate) fn of(trace: &Trace, motion: Vec<(Instant, Done)>, shared: Option<(Pin, Pin)>) -> Self {
        let [drive] = trace.drives.as_slice() else { panic!("a board has one drive") };
        // The motor of an MDrive is inside, and so are its millions of steps.
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
            memory: drive.memory.clone(),
        };
        for (at, seen) in on_shell::expected(trace) {
            match seen {
                Seen::Pin(Pin(pin), high) => {
                    let changes = &mut expected.pins[usize::from(pin)];
                    // There and back at one instant is nothing.
                    if changes.pop_if(|(last, _)| *last == at).is_none() {
                        changes.push((at, high));
                    }
                }
                Seen::Output(OutputRecord::Line { line, .. }) => expected.lines.push((at, line)),
                Seen::Output(OutputRecord::Store { offset, bytes }) => {
                    expected.memory[usize::from(offset)..][..bytes.len()].copy_from_slice(&bytes);
                }
                // Messages are handled below, piece by piece. Motion comes as plans; currents and duties have
                // no pin.
                Seen::Output(_) => {}
            }
        }
        let mut free = Instant::ZERO;
        for entry in trace.events() {
            match &entry.event {
                Event::Output(OutputRecord::Bytes { bytes, .. }) => {
                    let follows = expected.replies.last().filter(|_| free == entry.at);
                    let earliest = follows.map_or(entry.at, |before| before.earliest);
                    // The line setting at power-on holds at once.
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

    /// Returns whether a pin is given a level at any time after `after` and before `before`.
    pub(crate) fn is_given(&self, pin: Pin, after: Instant, before: Instant) -> bool {
        self.given[usize::from(pin.0)].iter().any(|at| (after..before).contains(at))
    }

    /// Returns whether a pin is STEP or DIR at `at`: a plan takes them, a level takes them back.
    pub(crate) fn is_axis(&self, pin: Pin, at: Instant) -> bool {
        let given = self.given[usize::from(pin.0)].iter().rev().find(|given| **given <= at);
        self.shared.is_some_and(|(step, dir)| pin == step || pin == dir)
            && self.motion.iter().any(|(from, _)| *from <= at && given.is_none_or(|given| given <= from))
    }

    /// The pin of the drive that shares its place with STEP.
    pub(crate) fn shared_step(&self) -> Option<Pin> {
        self.shared.map(|(step, _)| step)
    }

    /// The settings of the line at `at`.
    pub(crate) fn line(&self, at: Instant) -> Line {
        let line = self.lines.iter().rev().find(|(from, _)| *from < at);
        line.expect("a drive sets its line at power-on").1
    }

    /// The level of a pin at `at`: high if it is released.
    pub(crate) fn level(&self, pin: Pin, at: Instant) -> bool {
        let place = usize::from(pin.0);
        if self.let_go[place] && !self.given[place].iter().any(|given| *given <= at) {
            return true;
        }
        let change = self.pins[place].iter().rev().find(|(from, _)| *from <= at);
        change.is_some_and(|(_, high)| *high)
    }

    /// Returns whether a pin has that level at any time after `after` and before `before`.
    pub(crate) fn has_level(&self, pin: Pin, high: bool, after: Instant, before: Instant) -> bool {
        let place = usize::from(pin.0);
        let changes = self.pins[place].iter().map(|(at, _)| at).chain(&self.given[place]);
        let mut instants = changes.filter(|at| (after..before).contains(at)).chain([&after]);
        instants.any(|at| self.level(pin, *at) == high)
    }

    /// Steps made at `at` since the beginning: each plan until the next one.
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

    /// Returns whether the motor makes steps that way between `after` and `before`. One that is late, or early by a
    /// part of a step, may also be the one before that or the one behind.
    pub(crate) fn goes(&self, forward: bool, after: Instant, before: Instant) -> bool {
        let first = self.steps.partition_point(|(at, _)| *at < after).saturating_sub(1);
        let last = self.steps.partition_point(|(at, _)| *at < before);
        self.steps.iter().take(last + 1).skip(first).any(|(_, way)| *way == forward)
    }

    /// Last order to the motor, and whether the motor was at rest then.
    pub(crate) fn told(&self, at: Instant) -> Option<(Instant, bool)> {
        let index = self.motion.iter().take_while(|(from, _)| *from <= at).count().checked_sub(1)?;
        let (told, _) = self.motion[index];
        let stood = index.checked_sub(1).is_none_or(|before| match &self.motion[before].1 {
            Done::Planned(_, plan) => plan.end() <= told,
            _ => true,
        });
        Some((told, stood))
    }

    /// Returns whether the motor is given a plan at any time from `after` to `at`.
    pub(crate) fn plans(&self, after: Instant, at: Instant) -> bool {
        let plan = |done: &Done| matches!(done, Done::Planned(..));
        self.motion.iter().any(|(from, done)| plan(done) && (after..=at).contains(from))
    }

    /// The instants between `after` and `before` at which the motor gets another order.
    pub(crate) fn turns(&self, after: Instant, before: Instant) -> impl Iterator<Item = Instant> {
        self.motion.iter().map(|(at, _)| *at).filter(move |at| (after..before).contains(at))
    }

    /// The steps that may slip because a board takes each plan up to `late` after its instant: those of
    /// the old plan, and those of the new one, that are due in between.
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
                    // A motor at rest loses nothing: the new plan is made later as a whole.
                    let moved = old.position_at(*from) != old.position_at(Instant::NEVER);
                    Some(if moved { due(old) + due(new) } else { 0 })
                }
                _ => None,
            })
            .sum()
    }

    /// Instants at which there is something to compare.
    pub(crate) fn instants(&self) -> impl Iterator<Item = Instant> {
        let replies = self.replies.iter().map(|reply| reply.at);
        let pins = self.pins.iter().flatten().map(|(at, _)| *at);
        let motion = self.motion.iter().map(|(at, _)| *at);
        replies.chain(pins).chain(motion)
    }
}

/// Each step up to `end`, and whether it is forward: of each plan until the next one.
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
