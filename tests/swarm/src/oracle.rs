//! The oracle: every property that must hold for each plan.

use std::cell::RefCell;
use std::fmt;
use std::panic::{self, AssertUnwindSafe};

use drivetwin_sim::catalog;
use drivetwin_sim::record::trace::Trace;
use drivetwin_sim::replay;
use peak_alloc::PeakAlloc;

use crate::late;
use crate::plan::Plan;
use crate::replies;
use crate::run::{self, Happened, Life, Mode};

#[global_allocator]
static ALLOCATED: PeakAlloc = PeakAlloc;

/// Most bytes of memory for a bench with a [ring](run::RING) as trace, including all that its clients
/// received.
const MOST_BYTES: usize = 4 << 20;

/// Name of the failure of a plan whose pins change too often. It shows no defect of a drive.
pub(crate) const TOO_MUCH: &str = "too much";

/// A property that does not hold.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Failure {
    /// Name of the failure. Two plans with the same name fail in the same way.
    pub(crate) what: String,
    pub(crate) detail: String,
}

impl Failure {
    pub(crate) fn new(what: impl Into<String>, detail: impl fmt::Display) -> Self {
        Self { what: what.into(), detail: detail.to_string() }
    }

    /// The same failure under another name. A plan with [too many events](TOO_MUCH) keeps its name, so that
    /// it is given up wherever that happens.
    pub(crate) fn of(self, what: &str) -> Self {
        if self.what == TOO_MUCH {
            return self;
        }
        Self { what: what.into(), detail: format!("{}: {}", self.what, self.detail) }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.what, self.detail)
    }
}

/// Counts of the checks made.
#[derive(Clone, Copy, Default, Debug)]
pub(crate) struct Tally {
    pub(crate) answered: u64,
    pub(crate) saved: u64,
    pub(crate) events: u64,
    /// Plans that were given up because their pins changed too often.
    pub(crate) given_up: u64,
    /// Plans whose last steps were left out because there were enough events.
    pub(crate) cut_short: u64,
    /// Power cuts after which a drive had the new values, the old ones, and the factory's.
    pub(crate) after_cuts: [u64; 3],
    /// Most bytes of memory that a bench took.
    pub(crate) bytes: usize,
}

impl Tally {
    /// Adds the counts of another run.
    pub(crate) fn add(&mut self, other: Self) {
        self.answered += other.answered;
        self.saved += other.saved;
        self.events += other.events;
        self.given_up += other.given_up;
        self.cut_short += other.cut_short;
        self.after_cuts.iter_mut().zip(other.after_cuts).for_each(|(sum, cuts)| *sum += cuts);
        self.bytes = self.bytes.max(other.bytes);
    }
}

thread_local! {
    /// Place and message of the last panic.
    static PANIC: RefCell<Option<(String, String)>> = const { RefCell::new(None) };
}

/// Stores panics for [`judge`] instead of printing them.
pub(crate) fn keep_panics() {
    panic::set_hook(Box::new(|info| {
        let place = info.location().map_or_else(String::new, ToString::to_string);
        let said = info.payload_as_str().unwrap_or_default().to_owned();
        PANIC.with_borrow_mut(|panic| *panic = Some((place, said)));
    }));
}

/// Runs a plan in each mode and checks every property.
pub(crate) fn judge(plan: &Plan) -> Result<Tally, Failure> {
    let judged = panic::catch_unwind(AssertUnwindSafe(|| judge_all(plan))).unwrap_or_else(|_| {
        let (place, said) = PANIC.take().unwrap_or_default();
        Err(Failure::new(format!("panic at {place}"), said))
    });
    match judged {
        Err(failure) if failure.what == TOO_MUCH => Ok(Tally { given_up: 1, ..Tally::default() }),
        judged => judged,
    }
}

fn judge_all(plan: &Plan) -> Result<Tally, Failure> {
    let whole = run::run(plan, Mode::Whole)?;
    let pieces =
        run::run(plan, Mode::Pieces).map_err(|failure| failure.of("pieces of time change something"))?;
    alike(&whole, &pieces)?;
    drop(pieces);
    let mut tally = Tally {
        answered: whole.answered,
        saved: whole.saved,
        cut_short: whole.cut_short.into(),
        after_cuts: whole.after_cuts,
        ..Tally::default()
    };
    for life in &whole.lives {
        recorded(life)?;
        late::judge(life.bench.trace())?;
        replies::judge(life.bench.trace(), &whole.addresses, &whole.delays)?;
        tally.events += life.bench.trace().mark();
    }
    let heard = whole.heard.clone();
    drop(whole);
    let before = ALLOCATED.current_usage();
    ALLOCATED.reset_peak_usage();
    let lean =
        run::run(plan, Mode::Lean).map_err(|failure| failure.of("a shorter trace changes something"))?;
    tally.bytes = ALLOCATED.peak_usage().saturating_sub(before);
    if lean.heard != heard {
        return Err(Failure::new("a shorter trace changes something", "clients hear something else"));
    }
    if tally.bytes > MOST_BYTES {
        return Err(Failure::new("memory", format!("{} bytes", tally.bytes)));
    }
    Ok(tally)
}

/// Compares a run in whole waits with a run in pieces.
fn alike(whole: &Happened, pieces: &Happened) -> Result<(), Failure> {
    let what = "pieces of time change something";
    for (one, other) in whole.lives.iter().zip(&pieces.lives) {
        differ(what, &one.recording, &other.recording)?;
        if !one.bench.trace().events().eq(other.bench.trace().events()) {
            return Err(Failure::new(what, "another order of what happens at one instant"));
        }
        for seat in one.bench.drives() {
            if one.bench.memory(seat) != other.bench.memory(seat) {
                return Err(Failure::new(what, format!("the memory of {}", one.bench.name(seat))));
            }
        }
    }
    if whole.heard == pieces.heard && whole.lives.len() == pieces.lives.len() {
        return Ok(());
    }
    Err(Failure::new(what, "clients hear something else"))
}

/// Fails with the first text line in which two texts differ.
fn differ(what: &str, one: &str, other: &str) -> Result<(), Failure> {
    if one == other {
        return Ok(());
    }
    let differs = one.lines().zip(other.lines()).find(|(one, other)| one != other);
    let (one, other) = differs.unwrap_or(("the end of one", "more of the other"));
    Err(Failure::new(what, format!("{one:?} and {other:?}")))
}

/// Compares a recording with the trace, and replays it.
fn recorded(life: &Life) -> Result<(), Failure> {
    let sorted = |text: &str| {
        let mut lines: Vec<&str> = text.lines().collect();
        lines.sort_unstable();
        lines.join("\n")
    };
    let told = life.bench.trace().to_text();
    differ("a recording is not what happened", &sorted(&told), &sorted(&life.recording))?;
    let make = |kind: &str| catalog::make(kind).ok();
    let recorded = Trace::parse(&life.recording, &make)
        .map_err(|error| Failure::new("a recording that cannot be read", error))?;
    match replay::run(&recorded, &make) {
        Ok(None) => Ok(()),
        Ok(Some(difference)) => Err(Failure::new("a replay differs", difference)),
        Err(error) => Err(Failure::new("a recording that cannot be played", error)),
    }
}
