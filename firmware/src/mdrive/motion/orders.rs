//! The activities of motion, and how one follows another (MC 5-39, 5-43 to 5-47, 5-57, 5-61, 5-68).

use fixed::types::I24F8;

use super::closed::{Drift, Verdict};
use super::contacts::{Contact, limit_error};
use super::events::Event;
use super::follow::{self, Pursuit};
use super::home::{Course, Homing};
use super::queue::{Queue, Task};
use super::{Activity, Motion, Move, Order, Preemption};
use crate::device::{Context, Duration, Instant, Plan};
use crate::mdrive::error::Error;
use crate::mdrive::reasons::Why;
use crate::motion::Limits;

/// "The time required to calculate the move is 2.5 mSec" (MC 5-45).
const PLANNING_TIME: Duration = Duration::micros(2_500);

/// Way to stop a motion.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Brake {
    /// With the deceleration D. The waiting task begins after that, `at_once` or after MT.
    Ramp { at_once: bool },
    /// Without a ramp.
    Halt,
    /// With a ramp, or at the next whole step: LM selects it. The stop is at a whole step because a shaft that fell
    /// back by a part of a step could leave the limit again (MDRIVE-20).
    AtLimit,
}

impl Motion {
    /// Executes a motion command, or stores it as the waiting task. The inner error is the reason why the
    /// command does not begin now.
    pub(super) fn begin_order(
        &mut self,
        at: Instant,
        order: Order,
        out: &mut dyn Context,
    ) -> Result<Result<(), Why>, Error> {
        if let Activity::CircuitDriven { preemption, .. } = self.activity {
            if preemption == Preemption::Never {
                return Ok(Err(Why::TorqueMode));
            }
            self.queue.set(Some(match order {
                Order::To { .. } | Order::By { .. } => Task::Order(order, at + PLANNING_TIME),
                Order::Slew(speed) => Task::Slew(speed),
                Order::Home(_) | Order::HomeToIndex(_) => return Err(Error::Homing),
            }));
            return Ok(Ok(()));
        }
        match order {
            Order::To { .. } | Order::By { .. } => self.begin_or_wait(at, order, out),
            // MT is "the time between moves if consecutive motions are executed" (MC 5-49).
            Order::Slew(speed) if speed != 0 && matches!(self.activity, Activity::Settles(_)) => {
                Ok(self.queue.wait(Task::Slew(speed), Why::AfterSettling))
            }
            Order::Slew(speed) => {
                self.queue.set(None);
                Ok(self.slew(at, speed, out))
            }
            Order::Home(kind) | Order::HomeToIndex(kind) => {
                if !(1..=4).contains(&kind) {
                    return Err(Error::HomeType);
                }
                if !self.activity.is_rest() {
                    return Err(Error::Homing);
                }
                self.home(at, order, out);
                Ok(Ok(()))
            }
        }
    }

    /// Begins MA or MR. During another move the command waits for the end of that move, and replaces a
    /// command that waits already. A slew stops for it (MDRIVE-18).
    fn begin_or_wait(
        &mut self,
        at: Instant,
        order: Order,
        out: &mut dyn Context,
    ) -> Result<Result<(), Why>, Error> {
        let movement = Move::of(order, at, &self.shaft, &self.settings)?;
        let task = Task::Order(order, at + PLANNING_TIME);
        Ok(match self.activity {
            Activity::Rest => {
                if self.is_free(at, movement.target) {
                    self.enter(Activity::Planning(movement), at + PLANNING_TIME);
                    Ok(())
                } else {
                    Err(Why::AtLimit)
                }
            }
            Activity::Planning(_) | Activity::Settles(_) => self.queue.wait(task, Why::AfterMove),
            Activity::Moves(now) if now.tries == 0 => self.queue.wait(task, Why::AfterMove),
            Activity::Slews(_) | Activity::Jogs { .. } | Activity::Follows => {
                let begins = self.queue.wait(task, Why::AfterStop);
                self.brake(at, Brake::Ramp { at_once: true }, out);
                begins
            }
            Activity::Stops { at_once: true } => self.queue.wait(task, Why::AfterStop),
            Activity::Stops { at_once: false } | Activity::Homes(_) => return Err(Error::Homing),
            Activity::Moves(_) => return Err(Error::Correcting),
            Activity::CircuitDriven { .. } => Ok(()),
        })
    }

    /// Returns true if no limit forbids a move; otherwise reports the error.
    fn is_free(&mut self, at: Instant, target: i32) -> bool {
        let steps = target.wrapping_sub(self.shaft.position(at));
        let barred = steps != 0 && self.is_barred(steps < 0);
        if barred {
            self.events.fail(limit_error(steps < 0));
        }
        !barred
    }

    /// Returns true if an active limit forbids a direction. In clock mode limits have no effect (MC 5-13).
    fn is_barred(&self, back: bool) -> bool {
        self.contacts.is_at_limit(back) && !self.settings.follows_clock
    }

    pub(super) fn enter(&mut self, activity: Activity, due: Instant) {
        (self.activity, self.due) = (activity, due);
        self.current.run();
    }

    /// Starts another plan. A motor at standstill gets its current first, because without current it would
    /// not follow.
    fn start_plan(&mut self, at: Instant, plan: Plan, out: &mut dyn Context) {
        if self.activity.is_idle() {
            self.closed.begin(at, &self.shaft);
            self.current.run();
            self.energize(at, out);
        }
        self.shaft.set_plan(at, plan, out);
    }

    /// Sets the current that the activity needs.
    pub(super) fn energize(&mut self, at: Instant, out: &mut dyn Context) {
        let percent = self.current.percent(&self.settings, &self.activity);
        self.shaft.energize(at, percent, self.activity.spins(), out);
    }

    fn begin_move(&mut self, at: Instant, movement: Move, out: &mut dyn Context) {
        if !self.is_free(at, movement.target) {
            return self.over(at, out);
        }
        let rates = self.settings.rates();
        let from = self.shaft.position(at);
        let steps = movement.target.wrapping_sub(from);
        if !movement.continuous {
            let plan = Plan::profile(at, from, steps, rates);
            return self.run(at, Activity::Moves(movement), plan, out);
        }
        let speed = I24F8::saturating_from_num(rates.max_speed);
        let plan = self.shaft.plan().slew(at, if steps < 0 { -speed } else { speed }, rates);
        self.start_plan(at, plan, out);
        let movement = Move { speed: self.settings.speed, ..movement };
        let passes = if steps == 0 { at } else { self.shaft.plan().time_of(at, movement.target) };
        self.enter(Activity::Moves(movement), passes);
    }

    /// SL: takes effect at once, during any motion. Towards an active limit it only stops.
    ///
    /// # Errors
    /// The limit is active.
    fn slew(&mut self, at: Instant, speed: i32, out: &mut dyn Context) -> Result<(), Why> {
        let back = speed < 0;
        let is_barred = speed != 0 && self.is_barred(back);
        if speed != 0 && !is_barred {
            let (turns, rates) = (self.settings.scale().signed_speed(speed), self.settings.rates());
            let plan = self.shaft.plan().slew(at, turns, rates);
            self.run(at, Activity::Slews(speed), plan, out);
            return Ok(());
        }
        if is_barred {
            self.events.fail(limit_error(back));
        }
        self.brake(at, Brake::Ramp { at_once: false }, out);
        if is_barred { Err(Why::AtLimit) } else { Ok(()) }
    }

    /// Runs along a plan, to its end if it has one.
    fn run(&mut self, at: Instant, activity: Activity, plan: Plan, out: &mut dyn Context) {
        self.start_plan(at, plan, out);
        self.enter(activity, plan.end());
    }

    /// Stops, if there is a motion. A move that settles is not corrected any more.
    pub(super) fn brake(&mut self, at: Instant, how: Brake, out: &mut dyn Context) {
        match self.activity {
            Activity::Rest | Activity::CircuitDriven { .. } => return,
            Activity::Settles(_) => return self.activity = Activity::Settles(None),
            Activity::Planning(_) => return self.over(at, out),
            _ => {}
        }
        let (plan, rates) = (self.shaft.plan(), self.settings.rates());
        let plan = match how {
            Brake::Ramp { .. } => plan.slew(at, I24F8::ZERO, rates),
            Brake::AtLimit if self.settings.stops_abruptly() => plan.finish_step(at),
            Brake::AtLimit => plan.stop_on_step(at, rates),
            Brake::Halt => plan.halt(at),
        };
        if how == Brake::Halt {
            self.start_plan(at, plan, out);
            self.start_settling(at, None, out);
        } else {
            let at_once = how == Brake::Ramp { at_once: true };
            self.run(at, Activity::Stops { at_once }, plan, out);
        }
    }

    /// Handles the deadline of the activity.
    pub(super) fn activity_due(&mut self, at: Instant, out: &mut dyn Context) {
        self.due = Instant::NEVER;
        match self.activity {
            Activity::Rest | Activity::Slews(_) | Activity::Jogs { .. } | Activity::CircuitDriven { .. } => {}
            Activity::Planning(movement) => self.begin_move(at, movement, out),
            Activity::Moves(Move { continuous: true, notify_on_end, speed, .. }) => {
                let speed = i32::try_from(speed).unwrap_or(i32::MAX);
                let speed = if self.shaft.moves(at, true) { -speed } else { speed };
                self.enter(Activity::Slews(speed), Instant::NEVER);
                if notify_on_end {
                    self.events.push(Event::Announce);
                }
                if self.queue.is_waiting() {
                    self.brake(at, Brake::Ramp { at_once: true }, out);
                }
            }
            Activity::Moves(movement) => self.start_settling(at, Some(movement), out),
            Activity::Stops { at_once: true } => self.over(at, out),
            Activity::Stops { at_once: false } => self.start_settling(at, None, out),
            Activity::Settles(movement) => self.settled(at, movement, out),
            Activity::Homes(mut homing) => {
                let course = homing.timeout(self.is_on_mark(at, &homing));
                self.head(at, homing, course, out);
            }
            Activity::Follows => self.pursue_clock(at, out),
        }
    }

    /// Adapts the plan to the clock that the motor follows.
    fn pursue_clock(&mut self, at: Instant, out: &mut dyn Context) {
        self.due = at + follow::CHECK_PERIOD;
        let ramps = !self.settings.follows_at_once();
        let rates = self.settings.rates();
        match self.follow.pursue(at, &self.shaft, ramps) {
            Pursuit::Continues => {}
            Pursuit::Slew(speed) => self.start_plan(at, self.shaft.plan().slew(at, speed, rates), out),
            Pursuit::Move(steps) => {
                self.start_plan(at, Plan::profile(at, self.shaft.position(at), steps, rates), out);
            }
            Pursuit::Ends => self.start_settling(at, None, out),
        }
    }

    /// Begins the settling time MT at standstill.
    fn start_settling(&mut self, at: Instant, movement: Option<Move>, out: &mut dyn Context) {
        let settle = Duration::millis(self.settings.settle_ms.into());
        self.enter(Activity::Settles(movement), at + settle);
        if settle == Duration::ZERO {
            self.settled(at, movement, out);
        }
    }

    fn settled(&mut self, at: Instant, movement: Option<Move>, out: &mut dyn Context) {
        match movement {
            None => self.closed.keep(at, &self.shaft, &self.settings),
            Some(movement) => match self.closed.check(at, &movement, &self.shaft, &self.settings) {
                Verdict::InPosition if movement.notify_on_end => self.events.push(Event::Announce),
                Verdict::InPosition => {}
                Verdict::Off(counts) if self.correct(at, movement, counts, out) => return,
                Verdict::Off(_) => {}
                Verdict::Failed => self.events.fail(Error::PositionError),
            },
        }
        self.over(at, out);
    }

    /// Begins a correction by these counts at VI (MC 5-56). Returns true if one has begun.
    fn correct(&mut self, at: Instant, movement: Move, off: i32, out: &mut dyn Context) -> bool {
        let Some(steps) = self.shaft.steps_of(at, off) else { return false };
        if self.is_barred(off < 0) {
            self.events.fail(limit_error(off < 0));
            self.closed.give_up();
            return false;
        }
        let rates = self.settings.rates();
        let from = self.shaft.position(at);
        let plan = Plan::profile(at, from, steps, Limits { max_speed: rates.start_speed, ..rates });
        let movement = Move { target: from.wrapping_add(steps), tries: movement.tries + 1, ..movement };
        self.run(at, Activity::Moves(movement), plan, out);
        true
    }

    /// PM: brings back a shaft that is at rest and was forced out of its position.
    pub(super) fn maintain(&mut self, at: Instant, out: &mut dyn Context) {
        match self.closed.drift(at, &self.shaft, &self.settings, &self.activity) {
            Drift::None => {}
            Drift::Stall => self.events.fail(Error::Stall),
            Drift::From { target, off } => {
                self.correct(at, Move::back_to(target), off, out);
            }
        }
    }

    /// Ends the motion and begins the waiting task.
    pub(super) fn over(&mut self, at: Instant, out: &mut dyn Context) {
        (self.activity, self.due) = (Activity::Rest, Instant::NEVER);
        self.current.rest(at);
        if let Some(task) = self.queue.next() {
            self.begin(at, task, out);
        }
    }

    /// Begins a waiting task from standstill.
    pub(super) fn begin(&mut self, at: Instant, task: Task, out: &mut dyn Context) {
        match task {
            Task::Order(order, ready) => match Move::of(order, at, &self.shaft, &self.settings) {
                Ok(movement) if ready <= at => self.begin_move(at, movement, out),
                Ok(movement) => self.enter(Activity::Planning(movement), ready),
                Err(error) => self.events.fail(error),
            },
            Task::Move(movement) => self.begin_move(at, movement, out),
            Task::Slew(speed) => {
                let _ = self.slew(at, speed, out);
            }
            Task::Home(order) => self.home(at, order, out),
            Task::Jog => self.begin_jog(at, out),
        }
    }

    /// Handles a change of a jog contact. At standstill an activation begins a jog. A jog ends when its own
    /// contact becomes inactive. If a contact is active when the motor has stopped, another jog begins.
    pub(super) fn jog(&mut self, at: Instant, active: bool, out: &mut dyn Context) {
        match self.activity {
            Activity::Jogs { back } if !self.contacts.jogs(back) => {
                self.queue.set(Some(Task::Jog));
                self.brake(at, Brake::Ramp { at_once: false }, out);
            }
            Activity::Rest if active => self.begin_jog(at, out),
            _ => {}
        }
    }

    /// Begins the jog that the contacts request, if any.
    pub(super) fn begin_jog(&mut self, at: Instant, out: &mut dyn Context) {
        let Some(back) = self.contacts.jog().filter(|_| self.settings.jogs) else { return };
        if self.settings.follows_clock {
            self.events.fail(Error::JogInClockMode);
        } else if self.is_barred(back) {
            self.events.fail(limit_error(back));
        } else {
            let rates = self.settings.rates();
            let speed = I24F8::saturating_from_num(rates.max_speed);
            let plan = self.shaft.plan().slew(at, if back { -speed } else { speed }, rates);
            self.run(at, Activity::Jogs { back }, plan, out);
        }
    }

    /// Handles a limit that becomes active: stops a motion that goes in its direction, now or later.
    pub(super) fn limit(&mut self, at: Instant, back: bool, out: &mut dyn Context) {
        if !self.is_barred(back) || !self.shaft.moves(at, back) {
            return;
        }
        match self.activity {
            Activity::CircuitDriven { .. } => {}
            Activity::Homes(mut homing) => {
                let course = homing.limit(&self.settings);
                self.head(at, homing, course, out);
            }
            _ => self.stop_at_limit(at, back, out),
        }
    }

    /// Stops the motion at a limit and reports the error. With LM 3 and 6 the program ends, too.
    fn stop_at_limit(&mut self, at: Instant, back: bool, out: &mut dyn Context) {
        // The program ends before the error is reported, so that the error's handler can still run.
        if matches!(self.settings.limit_mode, 3 | 6) {
            self.events.push(Event::StopsProgram);
        }
        self.events.fail(limit_error(back));
        self.queue = Queue::EMPTY;
        self.brake(at, Brake::AtLimit, out);
    }

    /// Begins a homing, from standstill.
    fn home(&mut self, at: Instant, order: Order, out: &mut dyn Context) {
        let Some(mut homing) = Homing::new(order) else { return };
        self.closed.begin(at, &self.shaft);
        let course = homing.begin(self.is_on_mark(at, &homing));
        self.head(at, homing, course, out);
    }

    fn is_on_mark(&self, at: Instant, homing: &Homing) -> bool {
        if homing.is_by_index() { self.shaft.is_on_index(at) } else { self.contacts.is_active(Contact::Home) }
    }

    /// Checks if a homing has reached or left its mark, and computes the time of the next change of the index.
    pub(super) fn look_at_mark(&mut self, at: Instant, out: &mut dyn Context) {
        self.index_due = Instant::NEVER;
        let Activity::Homes(mut homing) = self.activity else { return };
        let course = homing.look(self.shaft.position(at), self.is_on_mark(at, &homing));
        self.head(at, homing, course, out);
        if homing.is_by_index() && matches!(self.activity, Activity::Homes(_)) {
            self.index_due = self.shaft.index_changes(at);
        }
    }

    /// Begins a course, unless an active limit forbids its direction.
    fn head(&mut self, at: Instant, mut homing: Homing, mut course: Course, out: &mut dyn Context) {
        let rates = self.settings.rates();
        let moves = matches!(course, Course::Search | Course::Creep | Course::Return(_));
        if moves && self.is_barred(homing.is_back()) {
            // A stop needs the activity of the motion.
            self.activity = Activity::Homes(homing);
            course = homing.limit(&self.settings);
        }
        let activity = Activity::Homes(homing);
        match course {
            Course::Same => self.activity = activity,
            Course::Settle => self.enter(activity, at + homing.time_to_settle(&self.settings)),
            Course::Search | Course::Creep => {
                let most = if course == Course::Search { rates.max_speed } else { rates.start_speed };
                let speed = I24F8::saturating_from_num(most);
                let speed = if homing.is_back() { -speed } else { speed };
                self.run(at, activity, self.shaft.plan().slew(at, speed, rates), out);
            }
            Course::Return(to) => {
                let from = self.shaft.position(at);
                let plan = Plan::profile(at, from, to.wrapping_sub(from), rates);
                self.run(at, activity, plan, out);
            }
            Course::Slow => self.run(at, activity, self.shaft.plan().stop_on_step(at, rates), out),
            Course::Stand => self.run(at, activity, self.shaft.plan().finish_step(at), out),
            Course::Arrive => {
                let plan = self.shaft.plan().finish_step(at);
                self.run(at, Activity::Stops { at_once: false }, plan, out);
            }
            Course::Fail(Error::BothLimits) => {
                self.activity = activity;
                self.events.fail(Error::BothLimits);
                self.queue = Queue::EMPTY;
                self.brake(at, Brake::AtLimit, out);
            }
            Course::Fail(_) => {
                self.activity = activity;
                self.stop_at_limit(at, homing.is_back(), out);
            }
        }
    }
}
