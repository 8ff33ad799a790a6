//! What the drive does with its motor: ramps, moves, and what its Hall sensors and its current tell.
//!
//! While something moves, the drive looks at the motor every millisecond. What it sees ([`Seen`]) and what it knows
//! of its motor ([`Model`]) tell its speed and place now; from the registers ([`Settings`]) and the way to go follows
//! the speed that the motor is to have at the next look ([`Rates`]), and the duty that brings it there. Speeds are
//! in counts per millisecond, accelerations in those per look: a look is the unit of time.
//!
//! There is no plan with a clock of its own: the speed that is aimed at grows from look to look, never far from
//! that of the motor, and a move is braked by the way that is left. A motor that is held back is so waited for,
//! and nothing winds up meanwhile.

mod count;
mod fit;
mod model;
mod path;
mod response;
mod seen;
mod settings;
#[cfg(test)]
mod tests;

use fixed::types::I40F24;

use self::count::{Counter, Driven};
use self::model::{LEAST_DUTY, MARGIN_MA, MOST_DUTY, Model};
use self::path::{FAR, Rates};
use self::seen::{Drives, Seen, scaled};
pub(super) use self::settings::Settings;
use super::errors::error;
use crate::device::{Duration, Instant, Output, Sink};
use crate::motor::AXIS;

const LOOKS_PER_SECOND: i64 = 1_000;
const LOOK: Duration = Duration::millis(1);

/// From an edge to the middle of its count.
const HALF: I40F24 = I40F24::lit("0.5");
/// How far from the middle of its count a move may end: nearer, the least duty would push it to and fro; farther,
/// a little mistake in the place would be another count.
const NEAR: I40F24 = I40F24::lit("0.25");

/// How many looks of its ramp the speed that is aimed at may be away from the motor's. Without a bound it would run
/// away from a motor that is held, which then jumps when it is let go; within one look the motor, which is
/// always a little behind, would never come to the ramp.
const AHEAD: i64 = 4;
/// The part of its limit that is left to a current that has reached it. At the limit it does not tell the speed; a
/// little below it does.
const SPARED: i64 = 8;

/// What it was told to do.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Order {
    /// Nothing: it stands, or is turned by others.
    None,
    /// Turn on and on.
    Rotate { forward: bool },
    /// To the middle of that count.
    Move { count: i64, rates: Rates },
    /// To standstill; how it slows down if it was a move.
    Stop { rates: Option<Rates> },
    /// To standstill with shorted terminals.
    Halt,
}

/// Where a move has nothing left.
#[derive(Clone, Copy, Debug)]
struct Goal {
    count: i64,
    /// Which way it goes there: 1 forward, −1 backward.
    sign: i64,
}

impl Goal {
    /// Counts that are left at `count`: none beyond it, by the compensation or for want of brakes.
    fn left(self, count: i64) -> i32 {
        let left = self.count - count;
        if left.signum() == self.sign { left.clamp(i32::MIN.into(), i32::MAX.into()) as i32 } else { 0 }
    }
}

/// The drive's half of the motor.
#[derive(Clone, Debug)]
pub(super) struct Servo {
    settings: Settings,
    model: Model,
    order: Order,
    next: Instant,
    /// The speed that is aimed at.
    pace: I40F24,
    /// 1 forward, −1 backward: what moves, or did.
    facing: i8,
    duty: i32,
    /// What the terminals may carry, in mA: 0 while they are open.
    carries: u32,
    /// What the motor draws, in mA.
    ma: i32,
    seen: Seen,
    /// It should stand, and is shorted for a look to see whether it does.
    waits: bool,
    counter: Counter,
    /// Of the present move, or of one that was stopped on its way.
    goal: Option<Goal>,
    /// Of the last move.
    left: i32,
    errors: u16,
}

impl Servo {
    /// A motor that stands, its terminals as MODE_COIL says.
    pub(super) fn new(settings: Settings) -> Self {
        Self {
            settings,
            model: Model::of(&settings),
            order: Order::None,
            next: Instant::NEVER,
            pace: I40F24::ZERO,
            facing: 0,
            duty: 0,
            carries: if settings.closed { settings.limit_ma } else { 0 },
            ma: 0,
            seen: Seen::AT_REST,
            waits: false,
            counter: Counter::NEW,
            goal: None,
            left: 0,
            errors: 0,
        }
    }

    /// Power has come, or comes again: tells the motor what it has.
    pub(super) fn power_on(&self, at: Instant, out: &mut dyn Sink) {
        out.put(at, Output::Duty { axis: AXIS, duty: self.duty });
        out.put(at, Output::Current { axis: AXIS, ma: self.carries });
    }

    /// Registers have been written. A move keeps the speed and the ramps that it began with; all else follows at
    /// once: continuous rotation, the motor that is expected, its sensors, the limit of its current, and the
    /// terminals of one that stands. Whether they are others than before.
    pub(super) fn set(&mut self, at: Instant, settings: Settings, out: &mut dyn Sink) -> bool {
        if settings == self.settings {
            return false;
        }
        let before = core::mem::replace(&mut self.settings, settings);
        if self.model.told(&settings, &before) {
            self.seen.forget();
        }
        let (to, from) = (settings.counts(), before.counts());
        if to != from {
            self.pace = scaled(self.pace, to, from);
            if let Order::Move { rates, .. } | Order::Stop { rates: Some(rates) } = &mut self.order {
                *rates = rates.rescaled(to, from);
            }
            self.seen.rescale(to, from);
            self.counter.forget_speed();
        }
        self.terminals(at, out);
        true
    }

    /// Continuous rotation, or the other way by way of standstill.
    pub(super) fn rotate(&mut self, at: Instant, forward: bool, out: &mut dyn Sink) {
        self.goal = None;
        self.begin(at, Order::Rotate { forward }, if forward { 1 } else { -1 }, out);
    }

    /// So many counts on from where it is, with two Hall sensors. Where it stops lies `compensation` counts further
    /// along the motion, but never behind its beginning; what is left counts down to the `counts` themselves.
    /// Where there is no way to go there is no motion, and nothing left.
    pub(super) fn go(&mut self, at: Instant, counts: i32, compensation: i16, out: &mut dyn Sink) {
        let sign = i64::from(counts.signum());
        let way = i64::from(counts) + sign * i64::from(compensation);
        if way.signum() != sign || sign == 0 {
            (self.goal, self.left) = (None, 0);
            return;
        }
        let here = self.counter.count();
        let (count, rates) = (here + way, self.settings.rates());
        (self.goal, self.left) = (Some(Goal { count: here + i64::from(counts), sign }), counts);
        if self.is_moving() && rates.is_too_fast(self.way_to(count), self.seen.speed, self.brakes()) {
            self.errors |= error::BRAKING;
        }
        self.begin(at, Order::Move { count, rates }, sign as i8, out);
    }

    /// To standstill with DEC; what was a move, with the DEC that it began with.
    pub(super) fn stop(&mut self) {
        match self.order {
            Order::Rotate { .. } => self.order = Order::Stop { rates: None },
            Order::Move { rates, .. } => self.order = Order::Stop { rates: Some(rates) },
            Order::None | Order::Stop { .. } | Order::Halt => {}
        }
    }

    /// To standstill with DEC as it is now, whatever a move began with.
    pub(super) fn brake(&mut self) {
        self.stop();
        if let Order::Stop { rates } = &mut self.order {
            *rates = None;
        }
    }

    /// To standstill without a ramp.
    pub(super) fn halt(&mut self, at: Instant, out: &mut dyn Sink) {
        if !self.is_moving() {
            return;
        }
        (self.order, self.next) = (Order::Halt, at + LOOK);
        self.apply(at, 0, out);
        self.seen.looked(at, self.ma);
    }

    /// Begins what was ordered, with a look at once if nothing has moved so far.
    fn begin(&mut self, at: Instant, order: Order, facing: i8, out: &mut dyn Sink) {
        let moved = self.is_moving();
        self.order = order;
        if moved {
            return;
        }
        self.facing = facing;
        self.seen.begin(at, self.ma);
        (self.pace, self.next) = (I40F24::ZERO, at);
        self.terminals(at, out);
        self.look(at, out);
    }

    /// A Hall sensor changed: A, or else B.
    pub(super) fn edge(&mut self, at: Instant, a: bool, high: bool) {
        let driven = Driven { now: self.is_moving(), forward: self.facing > 0 };
        match self.counter.edge(at, a, high, self.settings.halls, driven) {
            Ok(Some(forward)) => {
                self.seen.edge(at, forward);
                if let Some(goal) = self.goal {
                    self.left = goal.left(self.counter.count());
                }
            }
            Ok(None) => {}
            Err(_) => self.errors |= error::HALL,
        }
    }

    /// The motor draws so many mA.
    pub(super) fn draws(&mut self, at: Instant, ma: i32) {
        self.ma = ma;
        self.seen.draws(at, ma);
        if !self.settings.sees() && self.is_moving() && ma.unsigned_abs() >= self.settings.limit_ma {
            self.errors |= error::CURRENT_LIMIT;
        }
    }

    /// When it wants to look at the motor.
    pub(super) fn deadline(&self) -> Instant {
        self.next
    }

    /// It is due: the next look at the motor.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Sink) {
        if at >= self.next {
            self.look(at, out);
        }
    }

    fn look(&mut self, at: Instant, out: &mut dyn Sink) {
        self.next = at + LOOK;
        if self.order == Order::Halt {
            self.brake_short(at, out);
        } else if self.settings.sees() {
            self.regulate(at, out);
        } else {
            self.steer(at, out);
        }
    }

    /// With shorted terminals.
    fn brake_short(&mut self, at: Instant, out: &mut dyn Sink) {
        self.observe(at);
        self.pace = self.seen.speed;
        self.seen.looked(at, self.ma);
        if self.pace.abs() <= self.model.slow() {
            self.rest(at, out);
        }
    }

    /// Without sensors: the duty follows the ramp, and the motor turns as its load lets it.
    fn steer(&mut self, at: Instant, out: &mut dyn Sink) {
        let (target, rates) = self.target();
        self.pace = rates.ramped(self.pace, target);
        if self.pace == 0 && target == 0 {
            return self.rest(at, out);
        }
        self.face();
        let duty = match self.model.duty(self.pace) {
            // However slow it is to be, it is to turn.
            0 if self.pace == target => LEAST_DUTY as i32 * i32::from(self.facing),
            duty => duty,
        };
        self.apply(at, duty, out);
        self.seen.looked(at, self.ma);
    }

    /// With sensors.
    fn regulate(&mut self, at: Instant, out: &mut dyn Sink) {
        if self.seen.fades(at, self.ma) {
            return self.leave(at, out);
        }
        self.observe(at);
        let told = self.seen.told;
        let waited = core::mem::take(&mut self.waits);
        if self.has_arrived(if waited { told } else { self.seen.speed }) {
            // How soon another motor slows down is known too little: a look more, shorted, shows whether it stands.
            self.waits = self.model.another && told.abs() > self.model.slow();
            return if self.waits { self.leave(at, out) } else { self.rest(at, out) };
        }
        let speed = self.seen.speed;
        // What is held back is waited for.
        let (target, rates) = self.target();
        let band = rates.up.max(rates.down) * AHEAD + self.model.slow();
        let pace = self.pace.min(speed + band).max(speed - band);
        self.pace = rates.ramped(pace, target);
        self.face();

        let push = self.seen.load + (self.pace - speed) * self.model.inverse;
        let limit = self.limit();
        let fair = if self.seen.limited { limit - limit / SPARED } else { limit };
        let duty = self.model.duty(speed + push.min(fair).max(-fair));
        if push.abs() > fair && i64::from(duty.abs()) < MOST_DUTY {
            self.errors |= error::CURRENT_LIMIT;
        }
        self.apply(at, duty, out);
        self.seen.looked(at, self.ma);
    }

    /// Shorts it for a look.
    fn leave(&mut self, at: Instant, out: &mut dyn Sink) {
        self.pace = I40F24::ZERO;
        self.apply(at, 0, out);
        self.seen.looked(at, self.ma);
    }

    fn observe(&mut self, at: Instant) {
        let drives = Drives { duty: self.duty, limit_ma: self.settings.limit_ma };
        let stayed_out = self.seen.observe(at, &mut self.model, drives);
        if stayed_out && self.settings.sees() {
            self.errors |= error::HALL;
        }
    }

    /// What the limit of the current is as a speed: as much as it loses in the winding.
    fn limit(&self) -> I40F24 {
        self.model.lost(i64::from(self.settings.limit_ma) - MARGIN_MA)
    }

    /// By how much at most the current can slow the motor down in a look, with what load and friction do.
    fn brakes(&self) -> I40F24 {
        let helps = self.seen.load * i64::from(self.facing);
        ((self.limit() + helps) * self.model.gain).max(I40F24::DELTA)
    }

    /// The speed to go for, and the ramps to it.
    fn target(&self) -> (I40F24, Rates) {
        let rates = self.settings.rates();
        match self.order {
            Order::Rotate { forward: true } => (rates.speed, rates),
            Order::Rotate { forward: false } => (-rates.speed, rates),
            Order::Move { count, rates } => rates.towards(self.way_to(count), self.seen.speed, self.brakes()),
            Order::Stop { rates: stopped } => (I40F24::ZERO, stopped.unwrap_or(rates)),
            Order::None | Order::Halt => (I40F24::ZERO, rates),
        }
    }

    /// From where it is to the middle of that count; what is far is far.
    fn way_to(&self, count: i64) -> I40F24 {
        let counts = (count - self.counter.count()).clamp(-FAR, FAR);
        I40F24::from_num(counts) + HALF - self.seen.place
    }

    /// Whether what was ordered is done, at that speed.
    fn has_arrived(&self, speed: I40F24) -> bool {
        // At its limit the current does not tell.
        let stands = !self.seen.limited && speed.abs() <= self.model.slow();
        match self.order {
            Order::Move { count, .. } => stands && self.way_to(count).abs() <= NEAR,
            Order::Stop { .. } => stands && self.pace == 0,
            Order::None | Order::Rotate { .. } | Order::Halt => false,
        }
    }

    /// It stands.
    fn rest(&mut self, at: Instant, out: &mut dyn Sink) {
        if matches!(self.order, Order::Move { .. }) {
            (self.goal, self.left) = (None, 0);
        }
        (self.order, self.next, self.pace) = (Order::None, Instant::NEVER, I40F24::ZERO);
        self.counter.forget_speed();
        self.apply(at, 0, out);
        self.terminals(at, out);
    }

    fn is_moving(&self) -> bool {
        self.order != Order::None
    }

    /// What moves is what the pace says, if it says anything.
    fn face(&mut self) {
        if self.pace != 0 {
            self.facing = if self.pace > 0 { 1 } else { -1 };
        }
    }

    fn apply(&mut self, at: Instant, duty: i32, out: &mut dyn Sink) {
        if duty != self.duty {
            self.duty = duty;
            out.put(at, Output::Duty { axis: AXIS, duty });
        }
    }

    /// Opens or closes the terminals, as it moves and as MODE_COIL says.
    fn terminals(&mut self, at: Instant, out: &mut dyn Sink) {
        let closed = self.is_moving() || self.settings.closed;
        let ma = if closed { self.settings.limit_ma } else { 0 };
        if ma != self.carries {
            self.carries = ma;
            out.put(at, Output::Current { axis: AXIS, ma });
        }
    }

    /// What moves: 0 nothing, 1 forward, −1 backward. Braking is moving.
    pub(super) fn direction(&self) -> i8 {
        if self.is_moving() { self.facing } else { 0 }
    }

    /// Edges counted, forward less backward; wraps.
    pub(super) fn position(&self) -> i32 {
        self.counter.position()
    }

    /// CLR_POSITION: it is 0 here. A move that runs ends where it would have.
    pub(super) fn clear_position(&mut self) {
        self.counter.clear_position();
    }

    /// Counts that are left of the last move, also of one that was stopped; 0 of one that has arrived.
    pub(super) fn left(&self) -> i32 {
        self.left
    }

    /// SPEED_VALID, in rpm: measured, or without sensors the one that the duty would give.
    pub(super) fn speed(&self, at: Instant) -> u16 {
        if self.settings.sees() {
            self.counter.rpm(at, self.settings.counts())
        } else {
            self.model.rpm(self.duty)
        }
    }

    /// CURRENT_VALID, in mA, rounded: what the supply gives, which is the motor's current during the part of the
    /// time that is the duty; 0 when the current flows back.
    pub(super) fn current(&self) -> u16 {
        let given = (i64::from(self.ma) * i64::from(self.duty) + (1 << 15)) >> 16;
        given.clamp(0, u16::MAX.into()) as u16
    }

    /// Bits of ERROR that have come up since it was asked last.
    pub(super) fn errors(&mut self) -> u16 {
        core::mem::take(&mut self.errors)
    }
}
