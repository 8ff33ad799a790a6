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

use super::Order;
use super::Settings;
use super::contacts::limit_error;
use crate::device::Duration;
use crate::mdrive::error::Error;

/// Minimum time from standstill to the check of the mark. By then the signal of the mark belongs to the shaft
/// at rest.
const LEAST_SETTLING: Duration = Duration::millis(1);

/// A homing in progress.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) struct Homing {
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
    /// True if the shaft was on the mark when that was last checked.
    on_mark: bool,
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
pub(super) enum Course {
    /// The present motion continues.
    Same,
    /// The shaft is at standstill, and MT runs.
    Settle,
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
    pub(super) fn new(order: Order) -> Option<Self> {
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
            on_mark: false,
        })
    }

    /// Order that began the homing.
    pub(super) fn order(&self) -> Order {
        if self.by_index { Order::HomeToIndex(self.kind) } else { Order::Home(self.kind) }
    }

    /// Returns true if the mark is the index, not the switch.
    pub(super) fn is_by_index(&self) -> bool {
        self.by_index
    }

    /// Direction of the motion: true for backward.
    pub(super) fn is_back(&self) -> bool {
        self.back
    }

    /// Settling time: MT, or longer if the signal of the mark needs longer to be valid.
    pub(super) fn time_to_settle(&self, settings: &Settings) -> Duration {
        let debounce = if self.by_index { 0 } else { settings.home_debounce_ms };
        Duration::millis(settings.settle_ms.max(debounce.into()).into()).max(LEAST_SETTLING)
    }

    /// First motion of the homing. If the shaft is on the mark, it leaves the mark; otherwise it searches for
    /// it.
    pub(super) fn begin(&mut self, on_mark: bool) -> Course {
        self.on_mark = on_mark;
        if on_mark { self.creep() } else { self.enter(Stage::Search, Course::Search) }
    }

    /// Checks if the mark has begun or ended, at this position.
    pub(super) fn look(&mut self, here: i32, on_mark: bool) -> Course {
        let changes = core::mem::replace(&mut self.on_mark, on_mark) != on_mark;
        match (self.stage, on_mark) {
            _ if !changes => Course::Same,
            (Stage::Search | Stage::Return, true) => {
                (self.edge, self.turned, self.is_near) = (here, false, self.stage == Stage::Return);
                self.enter(Stage::Slow, Course::Slow)
            }
            (Stage::Seek, true) => self.enter(Stage::Meet, Course::Slow),
            (Stage::Slow, false) => {
                self.edge = here;
                Course::Same
            }
            (Stage::Creep, false) => Course::Arrive,
            _ => Course::Same,
        }
    }

    /// Handles the end of a motion, or of MT.
    pub(super) fn timeout(&mut self, on_mark: bool) -> Course {
        match self.stage {
            Stage::Return => self.enter(Stage::Seek, Course::Creep),
            _ if self.settles => self.settled(on_mark),
            _ => {
                self.settles = true;
                Course::Settle
            }
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
    pub(super) fn limit(&mut self, settings: &Settings) -> Course {
        let is_abrupt = settings.stops_abruptly();
        match self.stage {
            _ if !matches!(settings.limit_mode, 1 | 4) => Course::Fail(limit_error(self.back)),
            // The motion already comes to standstill.
            Stage::Slow | Stage::Meet | Stage::Turn => {
                if is_abrupt {
                    Course::Stand
                } else {
                    Course::Same
                }
            }
            // The shaft cannot leave a mark that ends behind the limit.
            Stage::Creep => Course::Fail(limit_error(self.back)),
            _ if self.turned => Course::Fail(Error::BothLimits),
            Stage::Search | Stage::Return | Stage::Seek => {
                (self.turned, self.back) = (true, !self.back);
                self.enter(Stage::Turn, if is_abrupt { Course::Stand } else { Course::Slow })
            }
        }
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
