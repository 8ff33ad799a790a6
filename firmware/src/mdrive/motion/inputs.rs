//! Inputs of the motion, and what the rest of the drive reads of it.

use fixed::types::I24F8;

use super::closed::Closed;
use super::contacts::{Contact, Contacts};
use super::current::Current;
use super::encoder::Channel;
use super::events::{Event, Events};
use super::follow::{self, Follow};
use super::orders::Brake;
use super::queue::Queue;
use super::shaft::Shaft;
use super::{Activity, Circuit, Motion, Order, Preemption, Settings};
use crate::device::{Context, Instant, Plan};
use crate::mdrive::error::Error;
use crate::mdrive::reasons::Why;

impl Motion {
    /// Creates a motor at rest at position 0. The settings give the number of lines of the built-in
    /// encoder.
    pub(in crate::mdrive) fn new(settings: Settings) -> Self {
        Self {
            shaft: Shaft::new(&settings),
            settings,
            activity: Activity::Rest,
            due: Instant::NEVER,
            queue: Queue::EMPTY,
            contacts: Contacts::NONE,
            closed: Closed::NEW,
            follow: Follow::NEW,
            index_due: Instant::NEVER,
            current: Current::at_power_on(Instant::ZERO),
            events: Events::NONE,
        }
    }

    /// Handles power-on or a restart: clears everything except the shaft's position, the levels of the remote
    /// encoder, and the blocking of the shaft. Contacts that are active follow as events.
    pub(in crate::mdrive) fn power_on(&mut self, at: Instant, settings: Settings, out: &mut dyn Context) {
        self.settings = settings;
        self.shaft.power_on(at, &settings, out);
        (self.activity, self.due) = (Activity::Rest, Instant::NEVER);
        (self.queue, self.contacts) = (Queue::EMPTY, Contacts::NONE);
        (self.closed, self.follow) = (Closed::NEW, Follow::NEW);
        self.closed.keep(at, &self.shaft, &self.settings);
        self.current = Current::at_power_on(at);
        self.events = Events::NONE;
        self.refresh(at, out);
    }

    /// Applies new values of variables. A move in progress keeps the speed and the ramps with which it began
    /// (MDRIVE-17). Returns true if the bridge goes off although the circuitry is on.
    pub(in crate::mdrive) fn set(&mut self, at: Instant, settings: Settings, out: &mut dyn Context) -> bool {
        let before = core::mem::replace(&mut self.settings, settings);
        if settings == before {
            return false;
        }
        self.shaft.set(at, &settings, out);
        let is_another = settings.machine.steps_per_rev != before.machine.steps_per_rev;
        if is_another {
            self.shaft.clear_lag(at);
        }
        if is_another || (settings.closed, settings.lines) != (before.closed, before.lines) {
            self.closed.begin(at, &self.shaft);
        }
        if (settings.closed && settings.maintains) != (before.closed && before.maintains) {
            self.closed.keep(at, &self.shaft, &self.settings);
        }
        // CM has changed, or CR between with ramps and without ramps (MDRIVE-33).
        let ends_following = (settings.follows_clock, settings.follows_at_once())
            != (before.follows_clock, before.follows_at_once());
        if ends_following && self.activity == Activity::Follows {
            self.brake(at, Brake::Ramp { at_once: false }, out);
        }
        // JE = 0 ends a jog. JE = 1 begins one if a contact is active already.
        match self.activity {
            Activity::Jogs { .. } if !settings.jogs => self.brake(at, Brake::Ramp { at_once: false }, out),
            Activity::Rest if settings.jogs && !before.jogs => self.begin_jog(at, out),
            _ => {}
        }
        if settings.enabled && !before.enabled {
            self.maintain(at, out);
        }
        self.refresh(at, out);
        settings.lacks_bridge() && !before.lacks_bridge()
    }

    /// Executes a motion command.
    ///
    /// # Errors
    /// Error 81, 85, 93: the state forbids it; 21: the distance has more than 32 bits of steps. Nothing has changed
    /// then. (The I/O reports 80, the Hybrid 88.) The inner error is the reason why the command does not begin now.
    pub(in crate::mdrive) fn order(
        &mut self,
        at: Instant,
        order: Order,
        out: &mut dyn Context,
    ) -> Result<Result<(), Why>, Error> {
        if let Activity::CircuitDriven { preemption: Preemption::AtOnce, .. } = self.activity {
            self.end_circuit(at, out);
        }
        let begins = self.begin_order(at, order, out)?;
        self.refresh(at, out);
        Ok(begins)
    }

    /// Stops any motion with the deceleration D.
    pub(in crate::mdrive) fn stop(&mut self, at: Instant, out: &mut dyn Context) {
        self.clear_waiting();
        self.brake(at, Brake::Ramp { at_once: false }, out);
        self.refresh(at, out);
    }

    /// Stops any motion without a ramp (Esc).
    pub(in crate::mdrive) fn halt(&mut self, at: Instant, out: &mut dyn Context) {
        self.clear_waiting();
        self.brake(at, Brake::Halt, out);
        self.refresh(at, out);
    }

    /// Drops the waiting task and the task that PS has interrupted. A pause ends without RS.
    pub(in crate::mdrive) fn clear_waiting(&mut self) {
        self.queue = Queue::EMPTY;
    }

    /// PS: stops with D and stores the rest of the motion.
    pub(in crate::mdrive) fn pause(&mut self, at: Instant, out: &mut dyn Context) {
        self.queue.pause(self.activity.task());
        if !matches!(self.activity, Activity::Settles(_)) {
            self.brake(at, Brake::Ramp { at_once: false }, out);
        }
        self.refresh(at, out);
    }

    /// RS: continues with the stored motion.
    pub(in crate::mdrive) fn resume(&mut self, at: Instant, out: &mut dyn Context) {
        if !self.queue.resume() {
            return;
        }
        match self.queue.take_interrupted() {
            Some(task) if self.activity.is_rest() => {
                self.begin(at, task, out);
                // A limit may have prevented the start of the task.
                if self.activity.is_rest() {
                    self.over(at, out);
                }
            }
            // Another motion was commanded meanwhile.
            Some(task) => {
                self.queue.set(Some(task));
                if self.activity.is_endless() {
                    self.brake(at, Brake::Ramp { at_once: true }, out);
                }
            }
            None if self.activity.is_rest() => self.over(at, out),
            None => {}
        }
        self.refresh(at, out);
    }

    /// Handles a contact that becomes active or inactive.
    pub(in crate::mdrive) fn contact(
        &mut self,
        at: Instant,
        contact: Contact,
        active: bool,
        out: &mut dyn Context,
    ) {
        if !self.contacts.set(contact, active) {
            return;
        }
        match contact {
            Contact::PlusLimit if active => self.limit(at, false, out),
            Contact::MinusLimit if active => self.limit(at, true, out),
            Contact::PlusLimit | Contact::MinusLimit => {}
            // `refresh` looks at the mark.
            Contact::Home => {}
            Contact::JogPlus | Contact::JogMinus => self.jog(at, active, out),
        }
        self.refresh(at, out);
    }

    /// Makes steps that the clock inputs request. They are ignored during any other motion.
    pub(in crate::mdrive) fn follow(&mut self, at: Instant, steps: i32, out: &mut dyn Context) {
        let begins = self.activity.is_rest();
        if !self.settings.follows_clock || !begins && self.activity != Activity::Follows {
            return;
        }
        if begins {
            self.closed.begin(at, &self.shaft);
            self.follow = Follow::begin(at, self.shaft.position(at));
            self.enter(Activity::Follows, at + follow::CHECK_PERIOD);
        }
        self.follow.take(at, steps);
        if self.settings.follows_at_once() {
            self.shaft.step(at, steps, out);
        }
        self.refresh(at, out);
    }

    /// Sets the level of a remote encoder's pin; `None` if nothing drives the pin any more.
    pub(in crate::mdrive) fn channel(
        &mut self,
        at: Instant,
        channel: Channel,
        level: Option<bool>,
        out: &mut dyn Context,
    ) {
        self.shaft.set_channel(at, channel, level);
        self.counted(at, out);
        self.refresh(at, out);
    }

    /// Adds edges that a remote encoder has made. Its channels A and B have these levels now.
    pub(in crate::mdrive) fn count(
        &mut self,
        at: Instant,
        edges: i32,
        channels: [bool; 2],
        out: &mut dyn Context,
    ) {
        self.shaft.take_edges(at, edges, channels);
        self.counted(at, out);
        self.refresh(at, out);
    }

    /// Blocks the shaft, or releases it.
    pub(in crate::mdrive) fn block_shaft(&mut self, at: Instant, blocked: bool, out: &mut dyn Context) {
        self.shaft.set_blocked(at, blocked);
        self.counted(at, out);
        self.refresh(at, out);
    }

    /// Lets a rotor that is free again continue from its present position, without waiting for standstill.
    pub(in crate::mdrive) fn resynchronise_rotor(&mut self, at: Instant, out: &mut dyn Context) {
        self.shaft.resynchronise(at);
        self.refresh(at, out);
    }

    /// Begins a motion of the circuitry with a percentage of the motor's current, in place of a running one. The
    /// axis must be at rest or circuit-driven; otherwise nothing happens.
    pub(in crate::mdrive) fn begin_circuit(
        &mut self,
        at: Instant,
        circuit: Circuit,
        percent: u8,
        out: &mut dyn Context,
    ) {
        if !self.activity.is_rest() && !self.activity.is_circuit_driven() {
            return;
        }
        let plan = self.shaft.plan();
        let (plan, preemption) = match circuit {
            Circuit::Turn { steps, rates } => {
                (Plan::profile(at, plan.position_at(at), steps, rates), Preemption::AtOnce)
            }
            Circuit::Spin { speed, acceleration } => {
                // A command that waits since the last torque mode has no effect in this one (MDRIVE-28).
                if matches!(
                    self.activity,
                    Activity::CircuitDriven { preemption: Preemption::AtStandstill, .. }
                ) {
                    self.queue.set(None);
                }
                (plan.ramp_to(at, speed, acceleration), Preemption::Never)
            }
            Circuit::Slow { deceleration } => {
                (plan.ramp_to(at, I24F8::ZERO, deceleration), Preemption::AtStandstill)
            }
        };
        self.shaft.hold_c1(at);
        self.enter(Activity::CircuitDriven { percent, preemption }, Instant::NEVER);
        // The current is set first, because without current the shaft would not follow.
        self.refresh(at, out);
        self.shaft.set_plan(at, plan, out);
    }

    /// Stops a spinning shaft at once, because something outside stops it.
    pub(in crate::mdrive) fn stop_circuit(&mut self, at: Instant, out: &mut dyn Context) {
        self.shaft.set_plan(at, self.shaft.plan().halt(at), out);
    }

    /// Ends the motion of the circuitry at its present position. A waiting task begins.
    pub(in crate::mdrive) fn end_circuit(&mut self, at: Instant, out: &mut dyn Context) {
        if self.activity.is_circuit_driven() {
            self.stop_circuit(at, out);
            self.shaft.release_c1(at);
            self.closed.begin(at, &self.shaft);
            self.over(at, out);
            self.refresh(at, out);
        }
    }

    /// Takes the oldest event, if any.
    pub(in crate::mdrive) fn next_event(&mut self) -> Option<Event> {
        self.events.next()
    }

    pub(in crate::mdrive) fn deadline(&self) -> Instant {
        let shaft = self.shaft.deadline().min(self.index_due).min(self.closed.deadline());
        shaft.min(self.due).min(self.current.deadline(&self.settings, &self.activity))
    }

    pub(in crate::mdrive) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if at < self.deadline() {
            return;
        }
        if self.shaft.timeout(at, out) {
            self.closed.rebase(at, &self.shaft, &self.settings);
            self.counted(at, out);
        }
        if self.closed.deadline() <= at {
            self.counted(at, out);
        }
        if self.due <= at {
            self.activity_due(at, out);
        }
        self.refresh(at, out);
    }

    /// Handles an encoder count that may have changed: a stall stops the motion unless SM is 1.
    fn counted(&mut self, at: Instant, out: &mut dyn Context) {
        if self.closed.stalls(at, &self.shaft, &self.settings, &self.activity) {
            self.events.fail(Error::Stall);
            if !self.settings.goes_on_stalled {
                self.clear_waiting();
                self.brake(at, Brake::Halt, out);
            }
        }
        self.maintain(at, out);
    }

    /// Updates the motor current and the deadlines.
    fn refresh(&mut self, at: Instant, out: &mut dyn Context) {
        self.look_at_mark(at, out);
        self.current.timeout(at, &self.settings, &self.activity);
        self.energize(at, out);
        self.closed.watch(at, &self.shaft, &self.settings, &self.activity);
    }

    /// The shaft with its counters.
    pub(in crate::mdrive) fn shaft(&self) -> &Shaft {
        &self.shaft
    }

    /// The shaft, to set its counters.
    pub(in crate::mdrive) fn shaft_mut(&mut self) -> &mut Shaft {
        &mut self.shaft
    }

    pub(in crate::mdrive) fn activity(&self) -> &Activity {
        &self.activity
    }

    /// V: velocity in steps/s, or counts/s with EE = 1, rounded.
    pub(in crate::mdrive) fn velocity(&self, at: Instant) -> i32 {
        self.shaft.displayed_speed(match self.activity {
            Activity::Follows if self.settings.follows_at_once() => self.follow.speed().into(),
            Activity::CircuitDriven { .. } => return 0,
            _ => self.shaft.plan().speed_at(at),
        })
    }

    /// Returns true if a motion that C1 counts is in progress or about to begin (MV).
    pub(in crate::mdrive) fn is_moving(&self) -> bool {
        match self.activity {
            Activity::Rest => false,
            Activity::CircuitDriven { .. } => self.queue.is_waiting(),
            _ => true,
        }
    }

    /// Returns true if a move to a position is in progress or waiting (MP).
    pub(in crate::mdrive) fn is_positioning(&self) -> bool {
        match self.activity {
            Activity::Planning(way) | Activity::Moves(way) | Activity::Settles(Some(way)) => way.ordered,
            _ => self.queue.holds_move(),
        }
    }

    /// Returns true if the speed changes (VC).
    pub(in crate::mdrive) fn is_changing(&self, at: Instant) -> bool {
        self.is_moving() && self.shaft.plan().segment_at(at).0.acceleration != 0
    }

    /// Returns true if the motor has stalled since ST was cleared (ST).
    pub(in crate::mdrive) fn has_stalled(&self) -> bool {
        self.closed.has_stalled()
    }

    /// Writes ST.
    pub(in crate::mdrive) fn set_stalled(&mut self, stalled: bool) {
        self.closed.set_stalled(stalled);
    }

    /// Returns true if the current does not fall to that of HC, because HT is 0 (MDRIVE-19).
    pub(in crate::mdrive) fn never_holds(&self) -> bool {
        self.current.never_holds(&self.settings)
    }
}
