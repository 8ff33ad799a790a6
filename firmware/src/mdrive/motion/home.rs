//! Homing to a switch (HM) and to the encoder's index (HI) (MC 5-29 to 5-31, 5-43; MDRIVE-20).
//!
//! [`Homing`] is a state machine. It gets changes of the mark (the switch or the index), limits and the end
//! of each motion, and returns the next motion, a [`Course`].
//!
//! | stage | figure 5.1 | motion | next |
//! |---|---|---|---|
//! | `Search` | 1 | at VM | on the mark: `Slow` |
//! | `Slow` | 2 | ramp to standstill | after MT: `Creep` if on the mark, else `Return`, later `Seek` |
//! | `Return` | 1, backward | profile to the end of the mark | at its end: `Seek`; on the mark: `Slow` |
//! | `Seek` | 1, backward | continues at VI | on the mark: `Meet` |
//! | `Meet` | 2, backward | to a whole step | after MT: `Creep`, or the end |
//! | `Creep` | 3 | at VI off the mark | off the mark: the step is finished (4) |
//! | `Turn` | MC 5-43 | stop at a limit | after MT: `Creep` if on the mark, else `Search` |

use fixed::types::I24F8;

use super::orders::Activity;
use super::{Contact, Motion, Order};
use crate::device::{Context, Duration, Instant, Plan};
use crate::mdrive::error::Error;

/// Minimum time from standstill to the check of the mark. By then the signal of the mark belongs to the shaft
/// at rest.
const LEAST_SETTLING: Duration = Duration::millis(1);

/// A homing in progress.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Homing {
    by_index: bool,
    kind: u8,
    stage: Stage,
    /// True while the shaft is at rest and MT runs.
    settles: bool,
    /// Direction of the motion: true for backward.
    back: bool,
    /// True if a limit has reversed the search, and the mark was not reached since.
    turned: bool,
    /// True if the shaft has already returned to the end of the mark once.
    is_near: bool,
    /// Position of the last edge of the mark that was passed.
    edge: i32,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stage {
    Search,
    Slow,
    Return,
    Seek,
    Meet,
    Creep,
    Turn,
}

/// A motion of a homing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Course {
    /// Motion at VM.
    Search,
    /// Motion at VI.
    Creep,
    /// A profile to a position.
    Return(i32),
    /// A ramp to standstill, then MT.
    Slow,
    /// A stop at the next whole step, then MT.
    Stand,
    /// A stop at the next whole step, which is the home position.
    Arrive,
    /// The end of the homing, with an error.
    Fail(Error),
}

impl Homing {
    /// Creates the homing of an order; `None` if the order is another motion.
    fn new(order: Order) -> Option<Self> {
        let (by_index, kind) = match order {
            Order::HomeToIndex(kind) => (true, kind),
            Order::Home(kind) => (false, kind),
            Order::To { .. } | Order::By { .. } | Order::Slew(_) => return None,
        };
        let stage = Stage::Search;
        Some(Self {
            by_index,
            kind,
            stage,
            settles: false,
            back: kind <= 2,
            turned: false,
            is_near: false,
            edge: 0,
        })
    }

    /// Order that began the homing.
    pub(super) fn order(&self) -> Order {
        if self.by_index { Order::HomeToIndex(self.kind) } else { Order::Home(self.kind) }
    }

    /// First motion of the homing. If the shaft is on the mark, it leaves the mark; otherwise it searches for
    /// it.
    fn begin(&mut self, on_mark: bool) -> Course {
        if on_mark { self.creep() } else { self.enter(Stage::Search, Course::Search) }
    }

    /// Handles the beginning or end of the mark at this position.
    fn mark(&mut self, here: i32, on_mark: bool) -> Option<Course> {
        match (self.stage, on_mark) {
            (Stage::Search | Stage::Return, true) => {
                (self.edge, self.turned, self.is_near) = (here, false, self.stage == Stage::Return);
                Some(self.enter(Stage::Slow, Course::Slow))
            }
            (Stage::Seek, true) => Some(self.enter(Stage::Meet, Course::Slow)),
            (Stage::Slow, false) => {
                self.edge = here;
                None
            }
            (Stage::Creep, false) => Some(Course::Arrive),
            _ => None,
        }
    }

    /// Handles the end of MT at standstill.
    fn settled(&mut self, on_mark: bool) -> Course {
        match self.stage {
            Stage::Turn => self.begin(on_mark),
            // The shaft may already have passed a mark that is less than a step wide.
            Stage::Meet if !on_mark && self.back == self.creeps_back() => Course::Arrive,
            Stage::Slow if !on_mark => {
                self.back = !self.back;
                match self.is_near {
                    true => self.enter(Stage::Seek, Course::Creep),
                    false => self.enter(Stage::Return, Course::Return(self.edge)),
                }
            }
            _ => self.creep(),
        }
    }

    /// Handles a limit in the direction of motion. With LM 1 and 4 the search is reversed; then the opposite
    /// limit ends the homing (MC 5-43).
    fn limit(&mut self, mode: u8) -> Option<Course> {
        let is_abrupt = mode >= 4;
        match self.stage {
            _ if !matches!(mode, 1 | 4) => Some(Course::Fail(self.limit_error())),
            // The motion already comes to standstill.
            Stage::Slow | Stage::Meet | Stage::Turn => is_abrupt.then_some(Course::Stand),
            // The shaft cannot leave a mark that ends behind the limit.
            Stage::Creep => Some(Course::Fail(self.limit_error())),
            _ if self.turned => Some(Course::Fail(Error::BothLimits)),
            Stage::Search | Stage::Return | Stage::Seek => {
                (self.turned, self.back) = (true, !self.back);
                let stop = if is_abrupt { Course::Stand } else { Course::Slow };
                Some(self.enter(Stage::Turn, stop))
            }
        }
    }

    fn limit_error(&self) -> Error {
        if self.back { Error::MinusLimit } else { Error::PlusLimit }
    }

    fn creep(&mut self) -> Course {
        self.back = self.creeps_back();
        self.enter(Stage::Creep, Course::Creep)
    }

    fn creeps_back(&self) -> bool {
        matches!(self.kind, 2 | 3)
    }

    fn enter(&mut self, stage: Stage, course: Course) -> Course {
        (self.stage, self.settles) = (stage, false);
        course
    }
}

impl Motion {
    /// Begins a homing, from standstill.
    pub(super) fn home(&mut self, at: Instant, order: Order, out: &mut dyn Context) {
        let Some(mut homing) = Homing::new(order) else { return };
        self.watch_from(at);
        let course = homing.begin(self.is_on_mark(at, &homing));
        self.head(at, homing, course, out);
    }

    /// Handles the deadline of a homing: a motion or MT has ended.
    pub(super) fn home_on(&mut self, at: Instant, mut homing: Homing, out: &mut dyn Context) {
        match homing.stage {
            Stage::Return => {
                let course = homing.enter(Stage::Seek, Course::Creep);
                self.head(at, homing, course, out);
            }
            _ if homing.settles => {
                let course = homing.settled(self.is_on_mark(at, &homing));
                self.head(at, homing, course, out);
            }
            _ => {
                homing.settles = true;
                self.enter(Activity::Homes(homing), at + self.time_to_settle(&homing));
            }
        }
    }

    /// Settling time: MT, or longer if the signal of the mark needs longer to be valid.
    fn time_to_settle(&self, homing: &Homing) -> Duration {
        let debounce = if homing.by_index { 0 } else { self.settings.home_debounce_ms };
        Duration::millis(self.settings.settle_ms.max(debounce.into()).into()).max(LEAST_SETTLING)
    }

    fn is_on_mark(&self, at: Instant, homing: &Homing) -> bool {
        if homing.by_index { self.is_on_index(at) } else { self.is_active(Contact::Home) }
    }

    /// Handles a change of the home switch.
    pub(super) fn see_home(&mut self, at: Instant, active: bool, out: &mut dyn Context) {
        if let Activity::Homes(homing) = self.activity
            && !homing.by_index
        {
            self.see_mark(at, homing, active, out);
        }
    }

    fn see_mark(&mut self, at: Instant, mut homing: Homing, on_mark: bool, out: &mut dyn Context) {
        match homing.mark(self.motor.position(at), on_mark) {
            Some(course) => self.head(at, homing, course, out),
            None => self.activity = Activity::Homes(homing),
        }
    }

    /// Handles a limit in the direction of a homing.
    pub(super) fn limit_home(&mut self, at: Instant, mut homing: Homing, out: &mut dyn Context) {
        if let Some(course) = homing.limit(self.settings.limit_mode) {
            self.head(at, homing, course, out);
        }
    }

    /// Begins a course, unless an active limit forbids its direction.
    fn head(&mut self, at: Instant, homing: Homing, course: Course, out: &mut dyn Context) {
        let rates = self.settings.rates();
        // Also set before a stop, because a stop needs the activity of the motion.
        let moves = Activity::Homes(homing);
        match course {
            Course::Search | Course::Creep | Course::Return(_) if self.is_barred(homing.back) => {
                self.activity = moves;
                self.limit_home(at, homing, out);
            }
            Course::Search | Course::Creep => {
                let most = if course == Course::Search { rates.max_speed } else { rates.start_speed };
                let speed = I24F8::saturating_from_num(most);
                self.run_at_speed(at, moves, if homing.back { -speed } else { speed }, rates, out);
            }
            Course::Return(to) => {
                let from = self.motor.position(at);
                let plan = Plan::profile(at, from, to.wrapping_sub(from), rates);
                self.run_plan(at, moves, plan, out);
            }
            Course::Slow => {
                let plan = self.motor.plan().stop_on_step(at, rates);
                self.run_plan(at, moves, plan, out);
            }
            Course::Stand => {
                let plan = self.motor.plan().finish_step(at);
                self.run_plan(at, moves, plan, out);
            }
            Course::Arrive => {
                let plan = self.motor.plan().finish_step(at);
                self.run_plan(at, Activity::Stops { at_once: false }, plan, out);
            }
            Course::Fail(Error::BothLimits) => {
                self.activity = moves;
                self.fail(Error::BothLimits);
                self.stop_for_limit(at, out);
            }
            Course::Fail(_) => {
                self.activity = moves;
                self.stop_at_limit(at, homing.back, out);
            }
        }
    }

    /// Checks if a homing has reached or left the index, and computes the time of the next change.
    pub(super) fn look_at_index(&mut self, at: Instant, out: &mut dyn Context) {
        self.index_due = Instant::NEVER;
        let Activity::Homes(Homing { by_index: true, .. }) = self.activity else { return };
        let now = self.is_on_index(at);
        if core::mem::replace(&mut self.on_index, now) != now
            && let Activity::Homes(homing) = self.activity
        {
            self.see_mark(at, homing, now, out);
        }
        if let Activity::Homes(Homing { by_index: true, .. }) = self.activity {
            self.index_due = self.encoder.index_changes(at, &self.motor);
        }
    }
}
