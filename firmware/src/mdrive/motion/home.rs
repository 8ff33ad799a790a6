//! Homing to a switch (HM) and to the encoder's index (HI) (MC 5-29 to 5-31, 5-43; MDRIVE-20).
//!
//! [`Homing`] is a machine of its own. It is informed of the mark (the switch or the index), of limits and of the end
//! of its motions, and answers with the [`Course`] that follows.
//!
//! | stage | figure 5.1 | motion | what ends it |
//! |---|---|---|---|
//! | `Search` | 1 | at VM | the mark |
//! | `Slow` | 2 | ramp to standstill | MT: `Creep` on the mark, else `Return`, then `Seek` |
//! | `Return` | 1, backward | a profile to where the mark ended | its end: `Seek`; the mark: `Slow` |
//! | `Seek` | 1, backward | on at VI | the mark |
//! | `Meet` | 2, backward | to a whole step | MT: `Creep`, or the end |
//! | `Creep` | 3 | at VI off the mark | the mark's end: the step is finished (4) |
//! | `Turn` | MC 5-43 | a limit's stop | MT: `Creep` on the mark, else `Search` |

use fixed::types::I24F8;

use super::orders::Activity;
use super::{Contact, Motion, Order};
use crate::device::{Context, Duration, Instant, Plan};
use crate::mdrive::error::Error;

/// Time from standstill to a look at the mark, at least. The shaft is at rest and its wires show that.
const LEAST_SETTLING: Duration = Duration::millis(1);

/// A homing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Homing {
    by_index: bool,
    kind: u8,
    stage: Stage,
    /// At rest, waiting for MT.
    settles: bool,
    /// Direction of its motion.
    back: bool,
    /// A limit has turned it, and it has not come to the mark since.
    turned: bool,
    /// The mark's end was returned to already.
    is_near: bool,
    /// Position of the mark's end that it came to last.
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
    /// At VM.
    Search,
    /// At VI.
    Creep,
    /// A profile to a position.
    Return(i32),
    /// A ramp to standstill, and MT.
    Slow,
    /// To standstill at the next whole step, and MT.
    Stand,
    /// To standstill at the next whole step: it is home.
    Arrive,
    /// The end, with an error.
    Fail(Error),
}

impl Homing {
    /// The homing of an order; none if it orders another motion.
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

    /// The order that began it.
    pub(super) fn order(&self) -> Order {
        if self.by_index { Order::HomeToIndex(self.kind) } else { Order::Home(self.kind) }
    }

    /// Off the mark if it is on it, else on with the search.
    fn begin(&mut self, on_mark: bool) -> Course {
        if on_mark { self.creep() } else { self.enter(Stage::Search, Course::Search) }
    }

    /// The mark begins or ends, at this position.
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

    /// MT has passed at standstill.
    fn settled(&mut self, on_mark: bool) -> Course {
        match self.stage {
            Stage::Turn => self.begin(on_mark),
            // A mark less than a step wide may be behind it already.
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

    /// A limit is in its way. LM 1 and 4 turn a search round; the opposite limit ends it (MC 5-43).
    fn limit(&mut self, mode: u8) -> Option<Course> {
        let is_abrupt = mode >= 4;
        match self.stage {
            _ if !matches!(mode, 1 | 4) => Some(Course::Fail(self.limit_error())),
            // It comes to standstill already.
            Stage::Slow | Stage::Meet | Stage::Turn => is_abrupt.then_some(Course::Stand),
            // A mark that ends behind the limit cannot be left.
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

    /// A homing has come to its instant.
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

    /// MT, but so long that the level of the mark is true then.
    fn time_to_settle(&self, homing: &Homing) -> Duration {
        let debounce = if homing.by_index { 0 } else { self.settings.home_debounce_ms };
        Duration::millis(self.settings.settle_ms.max(debounce.into()).into()).max(LEAST_SETTLING)
    }

    fn is_on_mark(&self, at: Instant, homing: &Homing) -> bool {
        if homing.by_index { self.is_on_index(at) } else { self.is_active(Contact::Home) }
    }

    /// The home switch becomes active, or not.
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

    /// A limit is in the way of a homing.
    pub(super) fn limit_home(&mut self, at: Instant, mut homing: Homing, out: &mut dyn Context) {
        if let Some(course) = homing.limit(self.settings.limit_mode) {
            self.head(at, homing, course, out);
        }
    }

    /// A homing takes this course, unless a limit that is held is in its way.
    fn head(&mut self, at: Instant, homing: Homing, course: Course, out: &mut dyn Context) {
        let rates = self.settings.rates();
        // Stops begin here, too: what stops knows that it moves.
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

    /// Looks whether a homing comes onto the index, or leaves it, and when it will.
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
