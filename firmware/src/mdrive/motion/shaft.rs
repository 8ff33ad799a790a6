//! The shaft: the motor that turns it, its plan and its current; the encoder on it; the counters C1 and C2.

use fixed::types::{I24F8, I48F16};

use super::Settings;
use super::encoder::{Channel, Encoder};
use super::response::Response;
use super::scale::Scale;
use crate::device::{Axis, Context, Duration, Instant, Output, Plan};
use crate::motor::stepper::{StepperMotor, StepperParameters};
use crate::motor::{Command, Plant};

const AXIS: Axis = Axis(0);

/// Peak current at 100 %, in mA. The manual gives no figure ("as motor is appropriately sized", MC 5-28), so
/// the motor's rated current is used.
const PEAK_MA: u32 = StepperParameters::NOMINAL.rated_ma;

/// Largest difference between position and shaft that comes from rounding only, in steps.
const ROUNDING: u32 = 1;
/// Interval of checks while the rotor is too slow or its load turns it.
const CHECK_PERIOD: Duration = Duration::millis(1);

/// The shaft with its motor, encoder and counters.
#[derive(Clone, Debug)]
pub(in crate::mdrive) struct Shaft {
    motor: StepperMotor,
    plan: Plan,
    /// Present current, in mA; `None` if it was not set since power-on.
    ma: Option<u32>,
    /// Current with which the shaft follows the plan: the present one, or the last one while inertia turns
    /// the shaft.
    pull_ma: Option<u32>,
    response: Response,
    encoder: Encoder,
    /// Offset of C1 to the position of the plan, and of C2 to the count of the encoder.
    c1: i32,
    c2: i32,
    /// Value at which C1 stays while a Hybrid's circuitry turns the motor.
    held_c1: Option<i32>,
    /// Lag of the rotor, in steps, at which a Hybrid reports a lag of 0.
    lag_origin: i32,
    /// True if the user's units are counts (EE).
    is_closed: bool,
    scale: Scale,
    steps_per_rev: i64,
    /// True if the plan, C1 or C2 has changed.
    changed: bool,
}

impl Shaft {
    /// Creates a shaft at rest at position 0 and angle 0, without current. The settings give the number of lines
    /// of the built-in encoder.
    pub(super) fn new(settings: &Settings) -> Self {
        let mut motor = StepperMotor::new(StepperParameters::NOMINAL);
        motor.set_microsteps(Instant::ZERO, settings.microsteps);
        Self {
            motor,
            plan: Plan::at_rest(Instant::ZERO, 0),
            ma: None,
            pull_ma: None,
            response: Response::FULL,
            encoder: Encoder::new(settings.lines),
            c1: 0,
            c2: 0,
            held_c1: None,
            lag_origin: 0,
            is_closed: settings.closed,
            scale: settings.scale(),
            steps_per_rev: settings.steps_per_rev(),
            changed: false,
        }
    }

    /// Handles power-on: position and counters are 0, wherever the shaft is.
    pub(super) fn power_on(&mut self, at: Instant, settings: &Settings, out: &mut dyn Context) {
        self.set(at, settings, out);
        self.plan = Plan::at_rest(at, 0);
        self.response.update(at, &self.plan);
        self.lead(at, out);
        (self.ma, self.pull_ma) = (None, None);
        (self.c1, self.held_c1, self.c2) = (0, None, self.count(at).wrapping_neg());
        self.clear_lag(at);
    }

    /// Applies new settings.
    pub(super) fn set(&mut self, at: Instant, settings: &Settings, out: &mut dyn Context) {
        (self.is_closed, self.scale) = (settings.closed, settings.scale());
        self.steps_per_rev = settings.steps_per_rev();
        self.motor.set_microsteps(at, settings.microsteps);
        self.motor.load(at, settings.machine);
        self.motor.keep_field(at, settings.keeps_field);
        if self.response.set_max_speed(settings.response) {
            self.respond(at, out);
        }
    }

    /// Disconnects the remote encoder.
    pub(in crate::mdrive) fn unplug(&mut self, at: Instant) {
        for channel in [Channel::A, Channel::B, Channel::Index] {
            self.set_channel(at, channel, None);
        }
    }

    /// Sets the level of a remote encoder's pin; `None` if nothing drives the pin any more.
    pub(super) fn set_channel(&mut self, at: Instant, channel: Channel, level: Option<bool>) {
        self.encoder.channel(at, &self.motor, channel, level);
    }

    /// Adds edges that a remote encoder has made. Its channels A and B have these levels now.
    pub(super) fn take_edges(&mut self, at: Instant, edges: i32, channels: [bool; 2]) {
        self.encoder.take_edges(at, &self.motor, edges, channels);
    }

    /// Blocks the shaft, or releases it.
    pub(super) fn set_blocked(&mut self, at: Instant, blocked: bool) {
        self.motor.set_blocked(at, blocked, &mut ());
    }

    /// Makes the motor follow `plan` from `at` on.
    pub(super) fn set_plan(&mut self, at: Instant, plan: Plan, out: &mut dyn Context) {
        self.plan = plan;
        self.response.update(at, &self.plan);
        self.lead(at, out);
        self.changed = true;
    }

    /// Makes steps without a ramp, from standstill.
    pub(super) fn step(&mut self, at: Instant, steps: i32, out: &mut dyn Context) {
        self.plan = Plan::at_rest(at, self.position(at).wrapping_add(steps));
        self.motor.command(at, Command::Step(steps), &mut ());
        out.put(at, Output::Step { axis: AXIS, steps });
        self.changed = true;
    }

    /// Sets the current, in %; `None` opens the bridge. If `turns_on`, inertia turns the shaft: without
    /// current it continues along its plan.
    pub(super) fn energize(
        &mut self,
        at: Instant,
        percent: Option<u8>,
        turns_on: bool,
        out: &mut dyn Context,
    ) {
        let ma = u32::from(percent.unwrap_or(0)) * PEAK_MA / 100;
        let is_pulled = ma != 0 || !turns_on;
        if is_pulled && self.pull_ma.replace(ma) != Some(ma) {
            self.motor.command(at, Command::CurrentLimit(ma), &mut ());
        }
        if self.ma.replace(ma) != Some(ma) {
            out.put(at, Output::CurrentLimit { axis: AXIS, ma });
        }
    }

    /// Lets a shaft that is free again continue from its present position.
    pub(super) fn resynchronise(&mut self, at: Instant) {
        self.motor.resynchronise(at);
    }

    fn respond(&mut self, at: Instant, out: &mut dyn Context) {
        if self.response.update(at, &self.plan) {
            self.lead(at, out);
        }
    }

    /// Makes the motor follow the plan, as far as its maximum speed allows.
    fn lead(&mut self, at: Instant, out: &mut dyn Context) {
        let plan = self.response.of(at, &self.plan);
        self.motor.command(at, Command::Plan(&plan), &mut ());
        out.put(at, Output::Plan { axis: AXIS, plan: &plan });
    }

    /// Time at which the shaft changes its motion: the plan does so, or becomes too fast for the shaft.
    pub(super) fn deadline(&self) -> Instant {
        self.motor.deadline().min(self.response.deadline())
    }

    /// Handles the deadline. Returns false if it is not due.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        let is_due = self.deadline() <= at;
        if self.response.deadline() <= at {
            self.respond(at, out);
        }
        if is_due {
            self.motor.timeout(at, &mut ());
        }
        is_due
    }

    /// Present plan. Its position is C1 without C1's preset.
    pub(in crate::mdrive) fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Position of the plan, in steps.
    pub(super) fn position(&self, at: Instant) -> i32 {
        self.plan.position_at(at)
    }

    /// Returns true if the plan moves in this direction, now or later.
    pub(super) fn moves(&self, at: Instant, back: bool) -> bool {
        let mut end = self.plan.start();
        self.plan.segments().iter().any(|segment| {
            end += Duration::from_ticks(segment.ticks);
            end > at && segment.ticks > 0 && segment.reverse == back
        })
    }

    /// Speed of the plan, in steps/s, truncated to 1/256.
    pub(in crate::mdrive) fn speed(&self, at: Instant) -> I24F8 {
        let speed = self.plan.speed_at(at);
        let size = I24F8::saturating_from_num(speed.abs());
        if speed < 0 { -size } else { size }
    }

    /// Count of the encoder, which differs from C2 by C2's presets.
    pub(super) fn count(&self, at: Instant) -> i32 {
        self.encoder.count(at, &self.motor)
    }

    /// Returns true if a remote encoder counts, not the built-in one.
    pub(super) fn has_remote_encoder(&self) -> bool {
        self.encoder.is_remote()
    }

    /// Returns true if the encoder is on its index (I6).
    pub(in crate::mdrive) fn is_on_index(&self, at: Instant) -> bool {
        self.encoder.is_on_index(at, &self.motor)
    }

    /// Next time at which the built-in encoder reaches or leaves its index; never if the motion of the shaft
    /// changes first.
    pub(super) fn index_changes(&self, at: Instant) -> Instant {
        self.encoder.index_changes(at, &self.motor, self.deadline())
    }

    /// C1: steps that the motor has made.
    pub(in crate::mdrive) fn steps(&self, at: Instant) -> i32 {
        self.held_c1.unwrap_or_else(|| self.position(at).wrapping_add(self.c1))
    }

    /// Sets C1.
    pub(in crate::mdrive) fn set_steps(&mut self, at: Instant, steps: i32) {
        let more = steps.wrapping_sub(self.steps(at));
        self.lag_origin = self.lag_origin.wrapping_add(more);
        match &mut self.held_c1 {
            Some(held) => *held = steps,
            None => self.c1 = self.c1.wrapping_add(more),
        }
        self.changed = true;
    }

    /// Stops counting in C1 (MC 5-9).
    pub(super) fn hold_c1(&mut self, at: Instant) {
        self.held_c1 = Some(self.steps(at));
    }

    /// Counts in C1 again, from the value at which it was held.
    pub(super) fn release_c1(&mut self, at: Instant) {
        if let Some(held) = self.held_c1.take() {
            self.c1 = held.wrapping_sub(self.position(at));
        }
    }

    /// C2: counts of the encoder.
    pub(in crate::mdrive) fn counts(&self, at: Instant) -> i32 {
        self.count(at).wrapping_add(self.c2)
    }

    /// Sets C2.
    pub(in crate::mdrive) fn set_counts(&mut self, at: Instant, counts: i32) {
        self.c2 = counts.wrapping_sub(self.count(at));
        self.changed = true;
    }

    /// P: C1, or C2 with EE = 1.
    pub(in crate::mdrive) fn displayed_position(&self, at: Instant) -> i32 {
        if self.is_closed { self.counts(at) } else { self.steps(at) }
    }

    /// Converts a speed to the user's unit, rounded.
    pub(super) fn displayed_speed(&self, speed: I48F16) -> i32 {
        self.scale.speed_in_counts(speed)
    }

    /// Converts a distance from P to steps; `None` if it has more than 32 bits.
    pub(super) fn steps_of(&self, at: Instant, distance: i32) -> Option<i32> {
        let here = i64::from(self.displayed_position(at));
        let steps = self.scale.first_step(here + i64::from(distance)) - self.scale.first_step(here);
        i32::try_from(steps).ok()
    }

    /// Returns true if the user's units are counts (EE).
    pub(in crate::mdrive) fn is_closed(&self) -> bool {
        self.is_closed
    }

    /// Returns true if the plan, C1 or C2 has changed since the last call. Earlier predictions of
    /// [`Self::reaches_steps`] are invalid then.
    pub(in crate::mdrive) fn has_changed(&mut self) -> bool {
        core::mem::take(&mut self.changed)
    }

    /// Next time after `at` at which P is `position`; [`Instant::NEVER`] if there is none. With EE = 1 the
    /// result is valid only until the shaft changes its motion.
    pub(in crate::mdrive) fn reaches(&self, at: Instant, position: i32) -> Instant {
        if self.is_closed {
            self.reaches_count(at, position.wrapping_sub(self.c2))
        } else {
            self.reaches_steps(at, position)
        }
    }

    /// Next time after `at` at which C1 is `steps`, if the plan does not change; [`Instant::NEVER`] if there
    /// is none.
    pub(in crate::mdrive) fn reaches_steps(&self, at: Instant, steps: i32) -> Instant {
        if self.held_c1.is_some() {
            return Instant::NEVER;
        }
        self.plan.time_of(at, steps.wrapping_sub(self.c1))
    }

    /// Next time at which [`Self::count`] gives `count`; never if the motion of the shaft changes first, or if a
    /// remote encoder counts.
    pub(super) fn reaches_count(&self, at: Instant, count: i32) -> Instant {
        self.encoder.reaches(at, &self.motor, self.deadline(), count)
    }

    /// Returns true if the motor can turn the rotor from rest in this direction.
    pub(in crate::mdrive) fn can_turn(&self, forward: bool) -> bool {
        self.motor.can_turn(forward)
    }

    /// Returns true if the shaft follows the plan, as far as its maximum speed allows.
    pub(in crate::mdrive) fn follows(&self) -> bool {
        self.pull_ma != Some(0) && !self.motor.stalled()
    }

    /// Returns true if the shaft is at the plan's position, not on its way there.
    pub(super) fn is_in_step(&self, at: Instant) -> bool {
        self.motor.is_in_step(at)
    }

    /// Returns true if the shaft is at rest at the plan's position.
    pub(in crate::mdrive) fn stands(&self) -> bool {
        self.follows() && !self.turns()
    }

    /// Returns true if the load turns the shaft.
    pub(super) fn slides(&self) -> bool {
        !self.follows() && self.turns()
    }

    fn turns(&self) -> bool {
        let kinematics = self.motor.kinematics();
        kinematics.half_speed != 0 || kinematics.half_acceleration != 0
    }

    /// Returns true if the plan is too fast for the rotor, so that the rotor lags more and more.
    pub(in crate::mdrive) fn is_too_fast(&self) -> bool {
        self.response.is_too_fast()
    }

    /// Steps by which the rotor is behind the steps made, counted from the last [`Self::clear_lag`].
    pub(in crate::mdrive) fn lag(&self, at: Instant) -> i32 {
        let lag = self.raw_lag(at).wrapping_sub(self.lag_origin);
        if lag.unsigned_abs() <= ROUNDING { 0 } else { lag }
    }

    /// Makes the present lag count as 0.
    pub(in crate::mdrive) fn clear_lag(&mut self, at: Instant) {
        self.lag_origin = self.raw_lag(at);
    }

    /// Time at which a rotor at rest will lag by this many steps; [`Instant::NEVER`] if the plan does not
    /// lead there. If the rotor is too slow or its load turns it, this is the time of the next check.
    pub(in crate::mdrive) fn lag_time(&self, at: Instant, steps: i32) -> Instant {
        if self.follows() {
            return if self.is_too_fast() { at + CHECK_PERIOD } else { Instant::NEVER };
        }
        if self.slides() {
            return at + CHECK_PERIOD;
        }
        let way = steps.wrapping_sub(self.lag(at));
        self.plan.time_of(at, self.position(at).wrapping_add(way))
    }

    fn raw_lag(&self, at: Instant) -> i32 {
        let turned = (i128::from(self.motor.angle_at(at)) * i128::from(self.steps_per_rev)) >> 32;
        self.steps(at).wrapping_sub(turned as i32)
    }
}
