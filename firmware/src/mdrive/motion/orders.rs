//! Motion commands, and how one follows another (MC 5-45, 5-47, 5-57, 5-61, 5-68).

use fixed::types::I24F8;

use super::closed::Verdict;
use super::home::Homing;
use super::{Event, Motion, Order};
use crate::device::{Context, Duration, Instant, Plan};
use crate::mdrive::error::Error;
use crate::mdrive::reasons::Why;
use crate::motion::Limits;

/// "The time required to calculate the move is 2.5 mSec" (MC 5-45).
const PLANNING_TIME: Duration = Duration::micros(2_500);

/// Present activity.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Activity {
    Rest,
    /// A move is being calculated.
    Planning(Move),
    Moves(Move),
    /// SL: turns without end at this speed, in the user's unit.
    Slews(i32),
    Jogs {
        back: bool,
    },
    /// Ramp to standstill. The waiting task begins after that, `at_once` or after MT.
    Stops {
        at_once: bool,
    },
    /// Settling time MT, after a move or another motion.
    Settles(Option<Move>),
    Homes(Homing),
    /// The motor follows the clock inputs.
    Follows,
    /// A Hybrid's circuitry turns the motor. C1 stays at `steps`.
    CircuitDriven {
        steps: i32,
        percent: u8,
        preemption: Preemption,
    },
}

/// Treatment of a motion command while a Hybrid's circuitry turns the shaft.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Preemption {
    /// The command is executed at once.
    AtOnce,
    /// The command waits until the rotor is at rest.
    AtStandstill,
    /// The command is ignored.
    Never,
}

/// A move to a position.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Move {
    /// Target position of the plan.
    pub(super) target: i32,
    /// Target count of the encoder, with EE = 1.
    pub(super) encoder_target: Option<i32>,
    /// True if MA or MR ordered the move, false for position maintenance.
    pub(super) ordered: bool,
    /// True if the drive sends its name at the end.
    pub(super) notify_on_end: bool,
    /// True if the motion does not stop at the target.
    pub(super) continuous: bool,
    /// Speed at which the motion continues after the target, in the user's unit: VM when the move began.
    pub(super) speed: u32,
    /// Number of corrections of the position so far.
    pub(super) tries: u8,
}

impl Move {
    /// Move that brings the encoder back to `encoder_target`.
    pub(super) fn back_to(encoder_target: i32) -> Self {
        Self {
            target: 0,
            encoder_target: Some(encoder_target),
            ordered: false,
            notify_on_end: false,
            continuous: false,
            speed: 0,
            tries: 0,
        }
    }
}

/// A task that begins later.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Task {
    /// MA or MR, and the time at which its calculation is complete.
    Order(Order, Instant),
    /// A move that PS has interrupted.
    Move(Move),
    Slew(i32),
    Home(Order),
    /// The jog that the contacts request when the task begins.
    Jog,
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
        match self.activity {
            Activity::CircuitDriven { preemption: Preemption::AtOnce, .. } => self.circuit_end(at, out),
            Activity::CircuitDriven { preemption: Preemption::AtStandstill, .. } => {
                self.waiting = Some(match order {
                    Order::To { .. } | Order::By { .. } => Task::Order(order, at + PLANNING_TIME),
                    Order::Slew(speed) => Task::Slew(speed),
                    Order::Home(_) | Order::HomeToIndex(_) => return Err(Error::Homing),
                });
                return Ok(Ok(()));
            }
            Activity::CircuitDriven { preemption: Preemption::Never, .. } => {
                return Ok(Err(Why::TorqueMode));
            }
            _ => {}
        }
        match order {
            Order::To { .. } | Order::By { .. } => self.begin_or_wait(at, order, out),
            // MT is "the time between moves if consecutive motions are executed" (MC 5-49).
            Order::Slew(speed) if speed != 0 && matches!(self.activity, Activity::Settles(_)) => {
                Ok(self.wait(Task::Slew(speed), Why::AfterSettling))
            }
            Order::Slew(speed) => {
                self.waiting = None;
                Ok(self.slew(at, speed, out))
            }
            Order::Home(kind) | Order::HomeToIndex(kind) => {
                if !(1..=4).contains(&kind) {
                    return Err(Error::HomeType);
                }
                if self.activity != Activity::Rest {
                    return Err(Error::Homing);
                }
                self.home(at, order, out);
                Ok(Ok(()))
            }
        }
    }

    /// Stores the waiting task. Returns the reason why the task does not begin now: `why`, unless there is a
    /// more special reason.
    fn wait(&mut self, task: Task, why: Why) -> Result<(), Why> {
        Err(match self.waiting.replace(task) {
            Some(_) => Why::TakesPlace,
            None if self.paused => Why::Paused,
            None => why,
        })
    }

    /// Begins MA or MR. During another move the command waits for the end of that move, and replaces a
    /// command that waits already. A slew stops for it (MDRIVE-18).
    fn begin_or_wait(
        &mut self,
        at: Instant,
        order: Order,
        out: &mut dyn Context,
    ) -> Result<Result<(), Why>, Error> {
        let movement = self.movement_for(at, order)?;
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
            Activity::Planning(_) | Activity::Settles(_) => self.wait(task, Why::AfterMove),
            Activity::Moves(now) if now.tries == 0 => self.wait(task, Why::AfterMove),
            Activity::Slews(_) | Activity::Jogs { .. } | Activity::Follows => {
                let begins = self.wait(task, Why::AfterStop);
                self.ramp_down(at, true, out);
                begins
            }
            Activity::Stops { at_once: true } => self.wait(task, Why::AfterStop),
            Activity::Stops { at_once: false } | Activity::Homes(_) => return Err(Error::Homing),
            Activity::Moves(_) => return Err(Error::Correcting),
            Activity::CircuitDriven { .. } => Ok(()),
        })
    }

    /// Computes the move that MA or MR makes from here.
    fn movement_for(&self, at: Instant, order: Order) -> Result<Move, Error> {
        let here = self.displayed_position(at);
        let (distance, notify_on_end, continuous) = match order {
            Order::To { position, notify_on_end, continuous } => {
                (position.wrapping_sub(here), notify_on_end, continuous)
            }
            Order::By { distance, notify_on_end, continuous } => (distance, notify_on_end, continuous),
            Order::Slew(_) | Order::Home(_) | Order::HomeToIndex(_) => (0, false, false),
        };
        let steps = self.steps_of(here, distance).ok_or(Error::IllegalValue)?;
        let encoder_target = self.encoder.count(at, &self.motor).wrapping_add(distance);
        Ok(Move {
            target: self.motor.position(at).wrapping_add(steps),
            encoder_target: Some(encoder_target).filter(|_| self.settings.closed),
            ordered: true,
            notify_on_end,
            continuous,
            speed: self.settings.speed,
            tries: 0,
        })
    }

    /// Converts a distance from `here`, in steps or counts, to steps; `None` if it has more than 32 bits.
    pub(super) fn steps_of(&self, here: i32, distance: i32) -> Option<i32> {
        let (scale, here) = (self.settings.scale(), i64::from(here));
        let steps = scale.first_step(here + i64::from(distance)) - scale.first_step(here);
        i32::try_from(steps).ok()
    }

    /// Returns true if no limit forbids a move; otherwise reports the error.
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

    /// Enters rest, because all motion has ended.
    pub(super) fn enter_rest(&mut self, at: Instant) {
        self.enter(Activity::Rest, Instant::NEVER);
        self.rested = at;
    }

    /// Starts another plan. A motor at standstill gets its current first, because without current it would
    /// not follow.
    pub(super) fn start_plan(&mut self, at: Instant, plan: Plan, out: &mut dyn Context) {
        if self.is_idle() {
            self.watch_from(at);
            self.holds = false;
            self.motor.energize(at, self.percent(), self.spins(), out);
        }
        self.motor.set_plan(at, plan, out);
        self.changed = true;
    }

    /// Returns true if no plan runs.
    pub(super) fn is_idle(&self) -> bool {
        matches!(self.activity, Activity::Rest | Activity::Planning(_) | Activity::Settles(_))
    }

    fn begin_move(&mut self, at: Instant, movement: Move, out: &mut dyn Context) {
        if !self.is_free(at, movement.target) {
            return self.over(at, out);
        }
        let rates = self.settings.rates();
        let from = self.motor.position(at);
        let steps = movement.target.wrapping_sub(from);
        if !movement.continuous {
            let plan = Plan::profile(at, from, steps, rates);
            return self.run_plan(at, Activity::Moves(movement), plan, out);
        }
        let speed = I24F8::saturating_from_num(rates.max_speed);
        let plan = self.motor.plan().slew(at, if steps < 0 { -speed } else { speed }, rates);
        self.start_plan(at, plan, out);
        let movement = Move { speed: self.settings.speed, ..movement };
        let passes = if steps == 0 { at } else { self.motor.plan().time_of(at, movement.target) };
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
            self.run_at_speed(at, Activity::Slews(speed), turns, rates, out);
            return Ok(());
        }
        if is_barred {
            self.fail_at_limit(back);
        }
        self.ramp_down(at, false, out);
        if is_barred { Err(Why::AtLimit) } else { Ok(()) }
    }

    /// Runs at a constant speed until another order comes.
    pub(super) fn run_at_speed(
        &mut self,
        at: Instant,
        activity: Activity,
        speed: I24F8,
        rates: Limits,
        out: &mut dyn Context,
    ) {
        let plan = self.motor.plan().slew(at, speed, rates);
        self.start_plan(at, plan, out);
        self.enter(activity, Instant::NEVER);
    }

    /// Runs along a plan that ends.
    pub(super) fn run_plan(&mut self, at: Instant, activity: Activity, plan: Plan, out: &mut dyn Context) {
        self.start_plan(at, plan, out);
        self.enter(activity, plan.end());
    }

    /// Begins a ramp to standstill, if there is a motion. A move that settles is not corrected any more.
    pub(super) fn ramp_down(&mut self, at: Instant, at_once: bool, out: &mut dyn Context) {
        match self.activity {
            Activity::Rest | Activity::CircuitDriven { .. } => {}
            Activity::Settles(_) => self.activity = Activity::Settles(None),
            Activity::Planning(_) => self.over(at, out),
            _ => {
                let plan = self.motor.plan().slew(at, I24F8::ZERO, self.settings.rates());
                self.run_plan(at, Activity::Stops { at_once }, plan, out);
            }
        }
    }

    /// Stops at the present position, without a ramp.
    pub(super) fn stop_at_once(&mut self, at: Instant, out: &mut dyn Context) {
        match self.activity {
            Activity::Rest | Activity::CircuitDriven { .. } => {}
            Activity::Settles(_) => self.activity = Activity::Settles(None),
            Activity::Planning(_) => self.over(at, out),
            _ => {
                let plan = self.motor.plan().halt(at);
                self.start_plan(at, plan, out);
                self.start_settling(at, None, out);
            }
        }
    }

    /// Drops the waiting task and the task that PS has interrupted. A pause ends without RS.
    pub(in crate::mdrive) fn clear_waiting(&mut self) {
        self.waiting = None;
        (self.paused, self.left) = (false, None);
    }

    /// Handles the deadline of the activity.
    pub(super) fn activity_due(&mut self, at: Instant, out: &mut dyn Context) {
        self.due = Instant::NEVER;
        match self.activity {
            Activity::Rest | Activity::Slews(_) | Activity::Jogs { .. } | Activity::CircuitDriven { .. } => {}
            Activity::Planning(movement) => self.begin_move(at, movement, out),
            Activity::Moves(Move { continuous: true, notify_on_end, speed, .. }) => {
                let speed = i32::try_from(speed).unwrap_or(i32::MAX);
                let speed = if self.motor.moves(at, true) { -speed } else { speed };
                self.enter(Activity::Slews(speed), Instant::NEVER);
                self.announce(notify_on_end);
                if self.waiting.is_some() {
                    self.ramp_down(at, true, out);
                }
            }
            Activity::Moves(movement) => self.start_settling(at, Some(movement), out),
            Activity::Stops { at_once: true } => self.over(at, out),
            Activity::Stops { at_once: false } => self.start_settling(at, None, out),
            Activity::Settles(movement) => self.settled(at, movement, out),
            Activity::Homes(homing) => self.home_on(at, homing, out),
            Activity::Follows => self.follow_on(at, out),
        }
    }

    /// Begins the settling time MT at standstill.
    pub(super) fn start_settling(&mut self, at: Instant, movement: Option<Move>, out: &mut dyn Context) {
        let settle = Duration::millis(self.settings.settle_ms.into());
        self.enter(Activity::Settles(movement), at + settle);
        if settle == Duration::ZERO {
            self.settled(at, movement, out);
        }
    }

    fn settled(&mut self, at: Instant, movement: Option<Move>, out: &mut dyn Context) {
        match movement.map(|movement| (movement, self.check_position(at, movement, out))) {
            Some((_, Verdict::Corrected)) => return,
            Some((movement, Verdict::InPosition)) => self.announce(movement.notify_on_end),
            Some((_, Verdict::Off)) => {}
            None => self.keep(at),
        }
        self.over(at, out);
    }

    fn announce(&mut self, notify_on_end: bool) {
        if notify_on_end {
            self.push_event(Event::Announce);
        }
    }

    /// Ends the motion and begins the waiting task.
    pub(super) fn over(&mut self, at: Instant, out: &mut dyn Context) {
        self.enter_rest(at);
        if let Some(task) = self.waiting.take_if(|_| !self.paused) {
            self.begin(at, task, out);
        }
    }

    /// Begins a waiting task from standstill.
    pub(super) fn begin(&mut self, at: Instant, task: Task, out: &mut dyn Context) {
        match task {
            Task::Order(order, ready) => match self.movement_for(at, order) {
                Ok(movement) if ready <= at => self.begin_move(at, movement, out),
                Ok(movement) => self.enter(Activity::Planning(movement), ready),
                Err(error) => self.fail(error),
            },
            Task::Move(movement) => self.begin_move(at, movement, out),
            Task::Slew(speed) => {
                let _ = self.slew(at, speed, out);
            }
            Task::Home(order) => self.home(at, order, out),
            Task::Jog => self.begin_jog(at, out),
        }
    }
}
