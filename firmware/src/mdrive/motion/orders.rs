//! Orders, and how one follows another (MC 5-45, 5-47, 5-57, 5-61, 5-68).

use fixed::types::I24F8;

use super::closed::Verdict;
use super::home::Homing;
use super::{Event, Motion, Order};
use crate::device::{Context, Duration, Instant, Plan};
use crate::mdrive::error::Error;
use crate::motion::Limits;

/// "The time required to calculate the move is 2.5 mSec" (MC 5-45).
const RECKONING: Duration = Duration::micros(2_500);

/// Present activity.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Activity {
    Rest,
    /// A move is calculated.
    Planning(Move),
    Moves(Move),
    /// SL: on without end, at that speed of the user's.
    Slews(i32),
    Jogs {
        back: bool,
    },
    /// To standstill, from where what waits begins `at_once` or after MT.
    Stops {
        at_once: bool,
    },
    /// MT, after a move or another motion.
    Settles(Option<Move>),
    Homes(Homing),
    /// The clock inputs.
    Follows,
    /// A Hybrid's circuitry turns it, and C1 stays where it is.
    Uncounted {
        steps: i32,
        percent: u8,
        yields: Preemption,
    },
}

/// Treatment of an order while a Hybrid's circuitry turns the shaft.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Preemption {
    /// Carried out at once.
    AtOnce,
    /// Waits until the rotor stands.
    AtStandstill,
    /// Dropped.
    Never,
}

/// A way to a position.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Move {
    /// Target of the plan.
    pub(super) target: i32,
    /// With EE = 1, where the encoder is to be.
    pub(super) aim: Option<i32>,
    /// MA or MR has ordered it, not position maintenance.
    pub(super) ordered: bool,
    /// The name is sent at its end.
    pub(super) announces: bool,
    /// True if it does not stop there.
    pub(super) goes_on: bool,
    /// The user's speed that it goes on with: VM where it began.
    pub(super) speed: u32,
    /// Corrections of its position so far.
    pub(super) tries: u8,
}

impl Move {
    /// Move that brings the encoder back to `aim`.
    pub(super) fn back_to(aim: i32) -> Self {
        Self {
            target: 0,
            aim: Some(aim),
            ordered: false,
            announces: false,
            goes_on: false,
            speed: 0,
            tries: 0,
        }
    }
}

/// Task for later.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Task {
    /// MA or MR, and when it is calculated.
    Order(Order, Instant),
    /// A move that PS has interrupted.
    Move(Move),
    Slew(i32),
    Home(Order),
    /// The jog that contacts ask for then.
    Jog,
}

impl Motion {
    /// Carries out an order, or lets it wait.
    pub(super) fn begin_order(
        &mut self,
        at: Instant,
        order: Order,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        match self.activity {
            Activity::Uncounted { yields: Preemption::AtOnce, .. } => self.end_uncounted(at, out),
            Activity::Uncounted { yields: Preemption::AtStandstill, .. } => {
                self.waiting = Some(match order {
                    Order::To { .. } | Order::By { .. } => Task::Order(order, at + RECKONING),
                    Order::Slew(speed) => Task::Slew(speed),
                    Order::Home(_) | Order::HomeToIndex(_) => return Err(Error::Homing),
                });
                return Ok(());
            }
            Activity::Uncounted { yields: Preemption::Never, .. } => return Ok(()),
            _ => {}
        }
        match order {
            Order::To { .. } | Order::By { .. } => self.begin_or_wait(at, order, out),
            // MT is "the time between moves if consecutive motions are executed" (MC 5-49).
            Order::Slew(speed) if speed != 0 && matches!(self.activity, Activity::Settles(_)) => {
                self.waiting = Some(Task::Slew(speed));
                Ok(())
            }
            Order::Slew(speed) => {
                self.waiting = None;
                self.slew(at, speed, out);
                Ok(())
            }
            Order::Home(kind) | Order::HomeToIndex(kind) => {
                if !(1..=4).contains(&kind) {
                    return Err(Error::HomeType);
                }
                if self.activity != Activity::Rest {
                    return Err(Error::Homing);
                }
                self.home(at, order, out);
                Ok(())
            }
        }
    }

    /// MA and MR. One that comes while another runs waits for its end, and takes the place of one that waits; a slew
    /// stops for it (MDRIVE-18).
    fn begin_or_wait(&mut self, at: Instant, order: Order, out: &mut dyn Context) -> Result<(), Error> {
        let way = self.way(at, order)?;
        let task = Task::Order(order, at + RECKONING);
        match self.activity {
            Activity::Rest => {
                if self.is_free(at, way.target) {
                    self.enter(Activity::Planning(way), at + RECKONING);
                }
            }
            Activity::Planning(_) | Activity::Settles(_) => self.waiting = Some(task),
            Activity::Moves(now) if now.tries == 0 => self.waiting = Some(task),
            Activity::Slews(_) | Activity::Jogs { .. } | Activity::Follows => {
                self.waiting = Some(task);
                self.slow(at, true, out);
            }
            Activity::Stops { at_once: true } => self.waiting = Some(task),
            Activity::Stops { at_once: false } | Activity::Homes(_) => return Err(Error::Homing),
            Activity::Moves(_) => return Err(Error::Correcting),
            Activity::Uncounted { .. } => {}
        }
        Ok(())
    }

    /// The way that MA or MR is from here.
    fn way(&self, at: Instant, order: Order) -> Result<Move, Error> {
        let here = self.shown_position(at);
        let (distance, announces, goes_on) = match order {
            Order::To { position, announces, goes_on } => (position.wrapping_sub(here), announces, goes_on),
            Order::By { distance, announces, goes_on } => (distance, announces, goes_on),
            Order::Slew(_) | Order::Home(_) | Order::HomeToIndex(_) => (0, false, false),
        };
        let steps = self.steps_of(here, distance).ok_or(Error::IllegalValue)?;
        let aim = self.encoder.count(at, &self.motor).wrapping_add(distance);
        Ok(Move {
            target: self.motor.position(at).wrapping_add(steps),
            aim: Some(aim).filter(|_| self.settings.closed),
            ordered: true,
            announces,
            goes_on,
            speed: self.settings.speed,
            tries: 0,
        })
    }

    /// The steps of so many steps or counts from a position; none if they have more than 32 bits.
    pub(super) fn steps_of(&self, here: i32, distance: i32) -> Option<i32> {
        let (scale, here) = (self.settings.scale(), i64::from(here));
        let steps = scale.first_step(here + i64::from(distance)) - scale.first_step(here);
        i32::try_from(steps).ok()
    }

    /// Returns whether no limit forbids a move; else reports the error.
    fn is_free(&mut self, at: Instant, target: i32) -> bool {
        let steps = target.wrapping_sub(self.motor.position(at));
        let barred = steps != 0 && self.is_barred(steps < 0);
        if barred {
            self.fail_at_limit(steps < 0);
        }
        !barred
    }

    pub(super) fn enter(&mut self, activity: Activity, due: Instant) {
        (self.activity, self.due) = (activity, due);
        self.holds &= activity == Activity::Rest;
    }

    /// All motion is over.
    pub(super) fn rest(&mut self, at: Instant) {
        self.enter(Activity::Rest, Instant::NEVER);
        self.rested = at;
    }

    /// Makes another plan. What begins to move has its current first, or it would not follow.
    pub(super) fn go(&mut self, at: Instant, plan: Plan, out: &mut dyn Context) {
        if self.stands() {
            self.watch_from(at);
            self.holds = false;
            self.motor.energize(at, self.percent(), self.spins(), out);
        }
        self.motor.go(at, plan, out);
        self.changed = true;
    }

    /// Returns whether no plan runs.
    pub(super) fn stands(&self) -> bool {
        matches!(self.activity, Activity::Rest | Activity::Planning(_) | Activity::Settles(_))
    }

    fn begin_move(&mut self, at: Instant, way: Move, out: &mut dyn Context) {
        if !self.is_free(at, way.target) {
            return self.over(at, out);
        }
        let rates = self.settings.rates();
        let from = self.motor.position(at);
        let steps = way.target.wrapping_sub(from);
        if !way.goes_on {
            let plan = Plan::profile(at, from, steps, rates);
            return self.run_plan(at, Activity::Moves(way), plan, out);
        }
        let speed = I24F8::saturating_from_num(rates.speed);
        let plan = self.motor.plan().slew(at, if steps < 0 { -speed } else { speed }, rates);
        self.go(at, plan, out);
        let way = Move { speed: self.settings.speed, ..way };
        let passes = if steps == 0 { at } else { self.motor.plan().when(at, way.target) };
        self.enter(Activity::Moves(way), passes);
    }

    /// SL: at once, whatever moves; towards a held limit it only stops.
    fn slew(&mut self, at: Instant, speed: i32, out: &mut dyn Context) {
        let back = speed < 0;
        if speed != 0 && self.is_barred(back) {
            self.fail_at_limit(back);
        } else if speed != 0 {
            let (turns, rates) = (self.settings.scale().signed_speed(speed), self.settings.rates());
            return self.turn(at, Activity::Slews(speed), turns, rates, out);
        }
        self.slow(at, false, out);
    }

    /// On at a speed without end.
    pub(super) fn turn(
        &mut self,
        at: Instant,
        activity: Activity,
        speed: I24F8,
        rates: Limits,
        out: &mut dyn Context,
    ) {
        let plan = self.motor.plan().slew(at, speed, rates);
        self.go(at, plan, out);
        self.enter(activity, Instant::NEVER);
    }

    /// Along a plan that ends.
    pub(super) fn run_plan(&mut self, at: Instant, activity: Activity, plan: Plan, out: &mut dyn Context) {
        self.go(at, plan, out);
        self.enter(activity, plan.end());
    }

    /// A ramp to standstill, if it moves. What settles is corrected no more.
    pub(super) fn slow(&mut self, at: Instant, at_once: bool, out: &mut dyn Context) {
        match self.activity {
            Activity::Rest | Activity::Uncounted { .. } => {}
            Activity::Settles(_) => self.activity = Activity::Settles(None),
            Activity::Planning(_) => self.over(at, out),
            _ => {
                let plan = self.motor.plan().slew(at, I24F8::ZERO, self.settings.rates());
                self.run_plan(at, Activity::Stops { at_once }, plan, out);
            }
        }
    }

    /// Stands where it is, in the same way.
    pub(super) fn stand(&mut self, at: Instant, out: &mut dyn Context) {
        match self.activity {
            Activity::Rest | Activity::Uncounted { .. } => {}
            Activity::Settles(_) => self.activity = Activity::Settles(None),
            Activity::Planning(_) => self.over(at, out),
            _ => {
                let plan = self.motor.plan().halt(at);
                self.go(at, plan, out);
                self.settle(at, None, out);
            }
        }
    }

    /// Neither what waits nor what PS has interrupted begins: a pause ends without RS.
    pub(in crate::mdrive) fn forget_what_waits(&mut self) {
        self.waiting = None;
        (self.paused, self.left) = (false, None);
    }

    /// The activity has come to its instant.
    pub(super) fn go_on(&mut self, at: Instant, out: &mut dyn Context) {
        self.due = Instant::NEVER;
        match self.activity {
            Activity::Rest | Activity::Slews(_) | Activity::Jogs { .. } | Activity::Uncounted { .. } => {}
            Activity::Planning(way) => self.begin_move(at, way, out),
            Activity::Moves(Move { goes_on: true, announces, speed, .. }) => {
                let speed = i32::try_from(speed).unwrap_or(i32::MAX);
                let speed = if self.motor.heads(at, true) { -speed } else { speed };
                self.enter(Activity::Slews(speed), Instant::NEVER);
                self.announce(announces);
                if self.waiting.is_some() {
                    self.slow(at, true, out);
                }
            }
            Activity::Moves(way) => self.settle(at, Some(way), out),
            Activity::Stops { at_once: true } => self.over(at, out),
            Activity::Stops { at_once: false } => self.settle(at, None, out),
            Activity::Settles(way) => self.settled(at, way, out),
            Activity::Homes(homing) => self.home_on(at, homing, out),
            Activity::Follows => self.follow_on(at, out),
        }
    }

    /// Begins the settling time MT at standstill.
    pub(super) fn settle(&mut self, at: Instant, way: Option<Move>, out: &mut dyn Context) {
        let settle = Duration::millis(self.settings.settle_ms.into());
        self.enter(Activity::Settles(way), at + settle);
        if settle == Duration::ZERO {
            self.settled(at, way, out);
        }
    }

    fn settled(&mut self, at: Instant, way: Option<Move>, out: &mut dyn Context) {
        match way.map(|way| (way, self.judge(at, way, out))) {
            Some((_, Verdict::Corrected)) => return,
            Some((way, Verdict::InPosition)) => self.announce(way.announces),
            Some((_, Verdict::Off)) => {}
            None => self.keep(at),
        }
        self.over(at, out);
    }

    fn announce(&mut self, announces: bool) {
        if announces {
            self.tell(Event::Announce);
        }
    }

    /// The motion is over: what waits begins.
    pub(super) fn over(&mut self, at: Instant, out: &mut dyn Context) {
        self.rest(at);
        if let Some(task) = self.waiting.take_if(|_| !self.paused) {
            self.begin(at, task, out);
        }
    }

    /// Begins what waited, from standstill.
    pub(super) fn begin(&mut self, at: Instant, task: Task, out: &mut dyn Context) {
        match task {
            Task::Order(order, ready) => match self.way(at, order) {
                Ok(way) if ready <= at => self.begin_move(at, way, out),
                Ok(way) => self.enter(Activity::Planning(way), ready),
                Err(error) => self.fail(error),
            },
            Task::Move(way) => self.begin_move(at, way, out),
            Task::Slew(speed) => self.slew(at, speed, out),
            Task::Home(order) => self.home(at, order, out),
            Task::Jog => self.begin_jog(at, out),
        }
    }
}
