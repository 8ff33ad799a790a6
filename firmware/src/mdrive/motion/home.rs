//! Homing to a switch (HM) and to the encoder's index (HI) (MC 5-29 to 5-31).
//!
//! It searches at VM, slows down when it sees what it searches for, creeps off it at VI and stops when it sees it no more.
//! What it has run over it goes back to where it saw it last, and creeps on from there until it sees it again: the
//! contact may be late, by its debounce time. MT passes after every stop.

use fixed::types::I24F8;

use super::orders::Activity;
use super::{Contact, Motion, Order};
use crate::device::{Duration, Instant, Plan, Sink};
use crate::mdrive::error::Error;
use crate::motion::Rates;

/// A homing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Home {
    /// To the index, not to the switch.
    by_index: bool,
    kind: u8,
    pub(super) stage: Stage,
    /// The direction in which it goes, or will go when it has turned round.
    pub(super) back: bool,
    /// A limit has turned it round.
    turned: bool,
    /// Where it saw it last, once it has seen it.
    seen: Option<i32>,
}

/// What a homing is at; the numbers are those of figure 5.1.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Stage {
    /// 1.
    Searches,
    /// 2.
    Slows,
    /// To standstill because of a limit.
    Turns,
    /// MT.
    Settles,
    /// Back to where it saw it last: 1 and 2, after an overshoot.
    Returns,
    /// On from there at VI.
    Seeks,
    /// 3.
    Creeps,
    /// It has left the index, and comes to its next step: what stands falls back by a part of one.
    Leaves,
}

impl Home {
    fn new(by_index: bool, kind: u8) -> Self {
        Self { by_index, kind, stage: Stage::Searches, back: kind <= 2, turned: false, seen: None }
    }

    /// The order that began it.
    pub(super) fn order(&self) -> Order {
        if self.by_index { Order::HomeToIndex(self.kind) } else { Order::Home(self.kind) }
    }

    /// The direction in which it leaves what it has found.
    fn creeps_back(&self) -> bool {
        matches!(self.kind, 2 | 3)
    }
}

impl Motion {
    /// Begins a homing, from standstill.
    pub(super) fn home(&mut self, at: Instant, order: Order, out: &mut dyn Sink) {
        let home = match order {
            Order::HomeToIndex(kind) => Home::new(true, kind),
            Order::Home(kind) => Home::new(false, kind),
            Order::To { .. } | Order::By { .. } | Order::Slew(_) => return,
        };
        self.watch_from(at);
        self.home_from_rest(at, home, out);
    }

    /// Whether a homing sees what it searches for.
    fn sees(&self, at: Instant, home: &Home) -> bool {
        if home.by_index { self.is_on_index(at) } else { self.is_active(Contact::Home) }
    }

    /// From standstill: off what it sees, back to what it has run over, or on searching.
    fn home_from_rest(&mut self, at: Instant, home: Home, out: &mut dyn Sink) {
        let rates = self.settings.rates();
        let (stage, back) = match home.seen {
            _ if self.sees(at, &home) => (Stage::Creeps, home.creeps_back()),
            None => (Stage::Searches, home.back),
            Some(_) => (Stage::Returns, !home.back),
        };
        let home = Home { stage, back, ..home };
        if self.is_barred(back) {
            return self.limit_home(at, home, out);
        }
        match (stage, home.seen) {
            (Stage::Returns, Some(seen)) => {
                let from = self.motor.position(at);
                self.go(at, Plan::profile(at, from, seen.wrapping_sub(from), rates), out);
                self.enter(Activity::Homes(home), self.motor.plan().end());
            }
            (Stage::Searches, _) => self.home_at(at, home, rates, out),
            _ => self.creep(at, home, out),
        }
    }

    /// At VM in its direction.
    fn home_at(&mut self, at: Instant, home: Home, rates: Rates, out: &mut dyn Sink) {
        let speed = I24F8::saturating_from_num(rates.speed);
        self.turn(at, Activity::Homes(home), if home.back { -speed } else { speed }, rates, out);
    }

    /// At VI in its direction.
    fn creep(&mut self, at: Instant, home: Home, out: &mut dyn Sink) {
        let rates = self.settings.rates();
        self.home_at(at, home, Rates { speed: rates.start, ..rates }, out);
    }

    /// A homing has come to its instant.
    pub(super) fn home_on(&mut self, at: Instant, home: Home, out: &mut dyn Sink) {
        match home.stage {
            Stage::Slows | Stage::Turns => {
                let settle = Duration::millis(self.settings.settle_ms.into());
                self.enter(Activity::Homes(Home { stage: Stage::Settles, ..home }), at + settle);
            }
            Stage::Settles => self.home_from_rest(at, home, out),
            Stage::Returns => self.creep(at, Home { stage: Stage::Seeks, ..home }, out),
            Stage::Leaves => self.stand(at, out),
            Stage::Searches | Stage::Seeks | Stage::Creeps => {}
        }
    }

    /// The home switch becomes active, or not.
    pub(super) fn see_home(&mut self, at: Instant, active: bool, out: &mut dyn Sink) {
        if let Activity::Homes(home) = self.activity
            && !home.by_index
        {
            self.see(at, home, active, out);
        }
    }

    /// What it searches for comes, or goes.
    fn see(&mut self, at: Instant, home: Home, active: bool, out: &mut dyn Sink) {
        let here = self.motor.position(at);
        match (home.stage, active) {
            (Stage::Searches | Stage::Returns | Stage::Seeks, true) => {
                let plan = self.motor.plan().slew(at, I24F8::ZERO, self.settings.rates());
                self.go(at, plan, out);
                let home = Home { stage: Stage::Slows, seen: Some(here), ..home };
                self.enter(Activity::Homes(home), self.motor.plan().end());
            }
            (Stage::Slows | Stage::Settles, false) if home.seen.is_some() => {
                self.activity = Activity::Homes(Home { seen: Some(here), ..home });
            }
            (Stage::Creeps, false) if home.by_index => {
                let next = here.wrapping_add(if home.back { -1 } else { 1 });
                let leaves = self.motor.plan().when(at, next);
                self.enter(Activity::Homes(Home { stage: Stage::Leaves, ..home }), leaves);
            }
            (Stage::Creeps, false) => self.stand(at, out),
            _ => {}
        }
    }

    /// A limit is in its way: LM 1 and 4 turn it round once, any other ends it.
    pub(super) fn limit_home(&mut self, at: Instant, home: Home, out: &mut dyn Sink) {
        // So that what stops it knows that it moves.
        self.activity = Activity::Homes(home);
        match self.settings.limit_mode {
            1 | 4 if home.turned => {
                self.fail(Error::BothLimits);
                self.stop_for_limit(at, out);
            }
            mode @ (1 | 4) => {
                let ramp = self.motor.plan().slew(at, I24F8::ZERO, self.settings.rates());
                let plan = if mode == 1 { ramp } else { self.motor.plan().halt(at) };
                self.go(at, plan, out);
                let home = Home { stage: Stage::Turns, back: !home.back, turned: true, seen: None, ..home };
                self.enter(Activity::Homes(home), self.motor.plan().end());
            }
            _ => self.stop_at_limit(at, home.back, out),
        }
    }

    /// Looks whether a homing comes onto the index, or leaves it, and when it will.
    pub(super) fn look_at_index(&mut self, at: Instant, out: &mut dyn Sink) {
        self.index_due = Instant::NEVER;
        let Activity::Homes(Home { by_index: true, .. }) = self.activity else { return };
        let now = self.is_on_index(at);
        if core::mem::replace(&mut self.on_index, now) != now
            && let Activity::Homes(home) = self.activity
        {
            self.see(at, home, now, out);
        }
        if let Activity::Homes(Home { by_index: true, .. }) = self.activity {
            self.index_due = self.encoder.index_changes(at, &self.motor);
        }
    }
}
