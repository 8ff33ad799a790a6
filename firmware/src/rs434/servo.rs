//! What the drive does with its motor: ramps, moves, and what its Hall sensors and its current tell.
//!
//! While something moves, the drive looks at the motor every millisecond. The current tells the speed at the
//! last look (what of the voltage is not lost in the winding, the motor makes itself); the speed, added up,
//! tells the place inside a count, which the edges of the Hall sensors set right. From both follow the speed
//! that the motor is to have at the next look, and the duty that brings it there. Speeds are in counts per
//! millisecond, accelerations in those per look: a look is the unit of time.
//!
//! There is no plan with a clock of its own: the speed that is aimed at grows from look to look, never far from
//! that of the motor, and a move is braked by the way that is left. A motor that is held back is so waited for,
//! and nothing winds up meanwhile.
//!
//! What the drive knows of its motor is RATED_SPEED and [`Parameters::NOMINAL`], as if someone had told it.

use fixed::types::I40F24;
use standin_protocol::time::TICKS_PER_SECOND;

use super::AXIS;
use crate::device::{Duration, Instant, Output, Sink};
use crate::motor::Parameters;

/// What a motion goes by (6.5).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Settings {
    /// SPEED, in rpm.
    pub(super) speed: u16,
    /// ACC and DEC, as the registers hold them.
    pub(super) acc: u16,
    pub(super) dec: u16,
    /// RATED_SPEED, in rpm.
    pub(super) rated: u16,
    /// PULSES_PER_REVOLUTION.
    pub(super) pulses: u16,
    /// USE_HALL.
    pub(super) halls: u16,
    /// REF_CURRENT, in mA.
    pub(super) limit_ma: u32,
    /// MODE_COIL: the terminals are closed while the motor stands.
    pub(super) closed: bool,
}

impl Settings {
    /// Counts in a turn.
    fn counts(&self) -> i64 {
        2 * i64::from(self.pulses.max(1)) * i64::from(self.halls.max(1))
    }

    /// Whether sensors tell where the motor is.
    fn sees(&self) -> bool {
        self.halls > 0
    }

    /// Counts in a look.
    fn of_rpm(&self, rpm: u16) -> I40F24 {
        I40F24::from_bits(((i64::from(rpm) * self.counts()) << 24) / (60 * LOOKS_PER_SECOND))
    }

    /// ACC or DEC: 10 is 100 rps², 1,000 is 5,000 rps² (6.5).
    fn of_ramp(&self, ramp: u16) -> I40F24 {
        let over = i64::from(ramp) - 10;
        let rps2_times_990 = 100 * 990 + over * (5_000 - 100);
        let bits = ((rps2_times_990 * self.counts()) << 24) / (990 * LOOKS_PER_SECOND * LOOKS_PER_SECOND);
        I40F24::from_bits(bits.max(1))
    }

    /// What its ramps and speeds are now.
    fn rates(&self) -> Rates {
        Rates { speed: self.of_rpm(self.speed), up: self.of_ramp(self.acc), down: self.of_ramp(self.dec) }
    }
}

const LOOKS_PER_SECOND: i64 = 1_000;
const LOOK: Duration = Duration::millis(1);

/// Bits of ERROR.
mod error {
    pub(super) const HALL: u16 = 1 << 4;
    pub(super) const CURRENT: u16 = 1 << 11;
    pub(super) const BRAKING: u16 = 1 << 12;
}

/// Full duty.
const FULL: i64 = 1 << 16;
/// The most and the least that is not 0 (3).
const MOST_DUTY: i64 = FULL * 98 / 100;
const LEAST_DUTY: i64 = FULL / 100 + 1;

/// Edges that stayed out after which something is wrong with the sensors.
const MISSED: I40F24 = I40F24::lit("4");
/// How far from the middle of its count a move may end.
const NEAR: I40F24 = I40F24::lit("0.25");
/// From an edge to the middle of its count.
const HALF: I40F24 = I40F24::lit("0.5");

/// Speed and ramps, in counts, looks and looks².
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Rates {
    speed: I40F24,
    up: I40F24,
    down: I40F24,
}

/// What the drive knows of its motor, in counts and looks.
#[derive(Clone, Copy, Debug)]
struct Model {
    /// Speed at full duty.
    full: I40F24,
    /// The part of the way to its final speed that a motor makes in a look.
    gain: I40F24,
    /// 1/gain.
    inverse: I40F24,
    /// How slow is standing: with shorted terminals no more than an eighth of a count is to come, and the least
    /// duty turns it faster.
    slow: I40F24,
}

impl Model {
    fn of(settings: &Settings) -> Self {
        let full = settings.of_rpm(settings.rated);
        let motor = Parameters { no_load_rpm: settings.rated.into(), ..Parameters::NOMINAL };
        // 1 − e⁻ˣ as (x + x²/2)/(1 + x + x²/2), x = look / time constant.
        let (h, t) = (LOOK.ticks(), motor.time_constant().ticks().clamp(1, 1 << 22));
        let (part, whole) = (h * (2 * t + h), 2 * t * t + 2 * t * h + h * h);
        let gain = I40F24::from_bits(((part << 12) / (whole >> 12).max(1)).cast_signed());
        Self {
            full,
            gain,
            inverse: I40F24::from_bits((((whole << 12) / part.max(1)) << 12).cast_signed()),
            slow: (full / 128).min(gain / 8),
        }
    }

    /// The speed whose voltage so much current loses in the winding.
    fn lost(&self, ma: i64) -> I40F24 {
        const RESISTANCE: i64 = Parameters::NOMINAL.resistance_mohm as i64;
        const SUPPLY: i64 = Parameters::NOMINAL.supply_mv as i64 * 1_000;
        I40F24::from_bits(self.full.to_bits() * ma * RESISTANCE / SUPPLY)
    }

    fn of_duty(&self, duty: i32) -> I40F24 {
        I40F24::from_bits((self.full.to_bits() * i64::from(duty)) >> 16)
    }

    /// The nearest duty that there is.
    fn duty(&self, speed: I40F24) -> i32 {
        let (size, full) = (speed.abs().to_bits() << 16, self.full.to_bits());
        let size = (size + full / 2).checked_div(full).unwrap_or(0).min(MOST_DUTY);
        let size = if size < LEAST_DUTY / 2 { 0 } else { size.max(LEAST_DUTY) };
        (size * speed.to_bits().signum()) as i32
    }
}

/// What it was told to do.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Order {
    /// Nothing: it stands, or is turned by others.
    None,
    /// Turn on and on.
    Rotate { forward: bool },
    /// To the middle of that count.
    Move { count: i32, rates: Rates },
    /// To standstill; how it slows down if it was a move.
    Stop { rates: Option<Rates> },
    /// To standstill with shorted terminals.
    Halt,
}

/// What the looks tell of the motor.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// The last look.
    at: Instant,
    /// How fast it was supposed to be then.
    speed: I40F24,
    /// The current just after it, in mA.
    ma: i32,
    /// What load and friction take of the speed that the voltage would give.
    load: I40F24,
    /// Friction held it at the last look.
    held: bool,
    /// Part of a count beyond the edge behind it, and when it was there.
    place: I40F24,
    since: Instant,
    /// How much of a mistake in `speed` is in `place`.
    doubt: I40F24,
    /// Counts that it should have made without an edge.
    missed: I40F24,
}

/// The last edge of a Hall sensor.
#[derive(Clone, Copy, Debug)]
struct Edge {
    at: Instant,
    forward: bool,
    /// Since the one before, if that was in the same direction.
    period: Option<Duration>,
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
    /// The limit of the current held the motor back at the last look.
    limited: bool,
    /// 1 forward, −1 backward: what moves, or did.
    facing: i8,
    duty: i32,
    /// What the terminals may carry.
    open_ma: u32,
    ma: i32,
    seen: Seen,
    /// Sensors A and B, as far as they are known.
    halls: [Option<bool>; 2],
    /// Of the present motion.
    last: Option<Edge>,
    count: i32,
    /// Where CURRENT_POSITION is 0.
    zero: i32,
    /// The count at which a move has nothing left.
    goal: Option<i32>,
    left: i32,
    errors: u16,
}

impl Servo {
    /// A motor that stands, its terminals as MODE_COIL says. Power has come, or comes again.
    pub(super) fn new(at: Instant, settings: Settings, out: &mut dyn Sink) -> Self {
        let model = Model::of(&settings);
        let seen = Seen {
            at,
            speed: I40F24::ZERO,
            ma: 0,
            load: I40F24::ZERO,
            held: false,
            place: HALF,
            since: at,
            doubt: I40F24::ZERO,
            missed: I40F24::ZERO,
        };
        let mut servo = Self {
            settings,
            model,
            order: Order::None,
            next: Instant::NEVER,
            pace: I40F24::ZERO,
            limited: false,
            facing: 0,
            duty: 0,
            open_ma: 0,
            ma: 0,
            seen,
            halls: [None; 2],
            last: None,
            count: 0,
            zero: 0,
            goal: None,
            left: 0,
            errors: 0,
        };
        out.put(at, Output::Duty { axis: AXIS, duty: 0 });
        out.put(at, Output::Current { axis: AXIS, ma: 0 });
        servo.terminals(at, out);
        servo
    }

    /// Registers have been written. Continuous rotation follows at once, a move keeps what it began with; the
    /// terminals of a motor that stands, the Hall sensors and the limit of the current follow at once, too.
    pub(super) fn set(&mut self, at: Instant, settings: Settings, out: &mut dyn Sink) {
        if settings == self.settings {
            return;
        }
        let before = core::mem::replace(&mut self.settings, settings);
        self.model = Model::of(&settings);
        if before.counts() != settings.counts() {
            let scaled = |speed: I40F24| {
                I40F24::from_bits(speed.to_bits() * settings.counts() / before.counts().max(1))
            };
            (self.pace, self.seen.speed) = (scaled(self.pace), scaled(self.seen.speed));
            (self.seen.load, self.seen.place) = (scaled(self.seen.load), HALF);
            self.last = None;
        }
        self.terminals(at, out);
    }

    /// Continuous rotation, or the other way by way of standstill.
    pub(super) fn rotate(&mut self, at: Instant, forward: bool, out: &mut dyn Sink) {
        self.goal = None;
        self.begin(at, Order::Rotate { forward }, if forward { 1 } else { -1 }, out);
    }

    /// So many counts on from where it is, with two Hall sensors. Where it stops lies `compensation` counts further
    /// along the motion; what is left counts down to the `counts` themselves. None to go is no motion.
    pub(super) fn go(&mut self, at: Instant, counts: i32, compensation: i16, out: &mut dyn Sink) {
        if counts == 0 {
            return;
        }
        let goal = self.count.wrapping_add(counts);
        let count = goal.wrapping_add(i32::from(compensation) * counts.signum());
        let rates = self.settings.rates();
        (self.goal, self.left) = (Some(goal), counts);
        let way = I40F24::saturating_from_num(count.wrapping_sub(self.count)).abs();
        let speed = self.pace;
        if self.is_moving() && speed * speed > rates.down * way.min(FAR) * 2 {
            self.errors |= error::BRAKING;
        }
        self.begin(at, Order::Move { count, rates }, counts.signum() as i8, out);
    }

    /// To standstill with DEC.
    pub(super) fn stop(&mut self, _at: Instant, _out: &mut dyn Sink) {
        match self.order {
            Order::Rotate { .. } => self.order = Order::Stop { rates: None },
            Order::Move { rates, .. } => self.order = Order::Stop { rates: Some(rates) },
            Order::None | Order::Stop { .. } | Order::Halt => {}
        }
    }

    /// To standstill without a ramp.
    pub(super) fn halt(&mut self, at: Instant, out: &mut dyn Sink) {
        if !self.is_moving() {
            return;
        }
        (self.order, self.next, self.seen.at) = (Order::Halt, at + LOOK, at);
        self.apply(at, 0, out);
    }

    /// Begins what was ordered, with a look at once if nothing has moved so far.
    fn begin(&mut self, at: Instant, order: Order, facing: i8, out: &mut dyn Sink) {
        let moved = self.is_moving();
        self.order = order;
        if moved {
            return;
        }
        self.facing = facing;
        let place = self.seen.place;
        self.seen = Seen {
            at,
            since: at,
            place,
            speed: I40F24::ZERO,
            load: I40F24::ZERO,
            held: false,
            doubt: I40F24::ZERO,
            missed: I40F24::ZERO,
            ma: self.ma,
        };
        (self.pace, self.next) = (I40F24::ZERO, at);
        self.terminals(at, out);
        self.look(at, out);
    }

    /// A Hall sensor changed: A, or else B.
    pub(super) fn edge(&mut self, at: Instant, a: bool, high: bool, _out: &mut dyn Sink) {
        let [known_a, known_b] = self.halls;
        let (known, other) = if a { (known_a, known_b) } else { (known_b, known_a) };
        self.halls = if a { [Some(high), known_b] } else { [known_a, Some(high)] };
        if known == Some(high) {
            self.errors |= error::HALL;
            return;
        }
        // The first that is heard of a sensor is what it shows when power comes, unless the motor is driven.
        if known.is_none() && !self.is_moving() {
            return;
        }
        let forward = match (self.settings.halls, other) {
            (0, _) => return,
            (1, _) if !a => return,
            (2.., Some(other)) => (high == other) != a,
            _ => self.facing > 0,
        };
        self.count = self.count.wrapping_add(if forward { 1 } else { -1 });
        let before = self.last.filter(|last| last.forward == forward);
        self.last = Some(Edge { at, forward, period: before.map(|before| at.since(before.at)) });
        self.seen.place = if forward { I40F24::ZERO } else { I40F24::ONE };
        (self.seen.since, self.seen.doubt, self.seen.missed) = (at, I40F24::ZERO, I40F24::ZERO);
        if let Some(goal) = self.goal {
            let left = goal.wrapping_sub(self.count);
            // Beyond it, by the compensation or for want of brakes, nothing is left.
            self.left = if left.signum() == i32::from(self.facing) { left } else { 0 };
        }
    }

    /// The motor draws so many mA.
    pub(super) fn draws(&mut self, at: Instant, ma: i32) {
        /// There and back on the wires.
        const SOON: Duration = Duration::from_ticks(2);
        self.ma = ma;
        if at.since(self.seen.at) <= SOON {
            self.seen.ma = ma;
        }
        if !self.settings.sees() && self.is_moving() && ma.unsigned_abs() >= self.settings.limit_ma {
            self.errors |= error::CURRENT;
        }
    }

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
            self.observe(at);
            self.pace = self.seen.speed;
            (self.seen.at, self.seen.ma) = (at, self.ma);
            if self.pace.abs() <= self.model.slow {
                self.rest(at, out);
            }
            return;
        }
        if self.settings.sees() { self.regulate(at, out) } else { self.steer(at, out) }
    }

    /// Without sensors: the duty follows the ramp, and the motor turns as its load lets it.
    fn steer(&mut self, at: Instant, out: &mut dyn Sink) {
        let (target, rates) = self.target(I40F24::ZERO, I40F24::MAX);
        self.pace = ramped(self.pace, target, rates);
        if self.pace == 0 && target == 0 {
            return self.rest(at, out);
        }
        self.face();
        self.apply(at, self.model.duty(self.pace), out);
        self.seen.at = at;
    }

    /// With sensors.
    fn regulate(&mut self, at: Instant, out: &mut dyn Sink) {
        self.observe(at);
        let limit = self.model.lost(i64::from(self.settings.limit_ma) - MARGIN_MA);
        let speed = self.seen.speed;
        if self.has_arrived() {
            return self.rest(at, out);
        }
        // What is held back is waited for.
        let (target, rates) = self.target(speed, self.brakes(limit));
        let band = rates.up.max(rates.down) * 4 + self.model.slow;
        let pace = within(self.pace, speed - band, speed + band);
        self.pace = ramped(pace, target, rates);
        self.face();

        let push = self.seen.load + (self.pace - speed) * self.model.inverse;
        // A current at the limit tells nothing of the speed; a little less does.
        let fair = if self.limited { limit - limit / 8 } else { limit };
        let duty = self.model.duty(speed + within(push, -fair, fair));
        if push.abs() > fair && i64::from(duty.abs()) < MOST_DUTY {
            self.errors |= error::CURRENT;
        }
        self.apply(at, duty, out);
        (self.seen.at, self.seen.ma) = (at, self.ma);
    }

    /// What has happened since the last look, and how fast the motor is now.
    fn observe(&mut self, at: Instant) {
        let Self { model, seen, .. } = self;
        let limit_ma = i64::from(self.settings.limit_ma);
        let limit = model.lost(limit_ma);
        let voltage = model.of_duty(self.duty);
        let ma = i64::from(seen.ma);
        self.limited = ma.abs() >= limit_ma;
        let then = if self.limited {
            let bound = voltage - model.lost(ma);
            if ma > 0 { seen.speed.min(bound) } else { seen.speed.max(bound) }
        } else {
            voltage - model.lost(ma)
        };
        let mistake = then - seen.speed;
        // What should have moved and stands is held by friction, however little is missing.
        let least = model.lost(MARGIN_MA);
        let stands = !self.limited && then.abs() <= least;
        seen.held = stands && (seen.held || seen.speed.abs() > least);
        if seen.held {
            seen.load = voltage;
        } else if !self.limited {
            seen.load -= mistake * model.inverse / 2;
        }
        let push = within(voltage - then, -limit, limit);
        let change = if seen.held { -then } else { (push - seen.load) * model.gain };
        let part = looks(at.since(seen.since).min(LOOK));
        let way = part * (then + change - change * part / 2);
        let place = seen.place + mistake * seen.doubt + way;
        seen.place = place.clamp(I40F24::ZERO, I40F24::ONE);
        if !self.limited {
            seen.missed += (place - seen.place).abs();
        }
        if seen.missed > MISSED && self.settings.sees() {
            self.errors |= error::HALL;
            seen.missed = I40F24::ZERO;
        }
        (seen.speed, seen.since, seen.doubt) = (then + change, at, part / 2);
    }

    /// By how much at most the motor can slow down in a look.
    fn brakes(&self, limit: I40F24) -> I40F24 {
        let helps = self.seen.load * i64::from(self.facing);
        let most = (limit + helps) * self.model.gain;
        (most - most / 4).max(I40F24::DELTA)
    }

    /// The speed to go for, and the ramps to it. A way to go is braked by `brakes` at most.
    fn target(&self, speed: I40F24, brakes: I40F24) -> (I40F24, Rates) {
        let rates = self.settings.rates();
        match self.order {
            Order::Rotate { forward: true } => (rates.speed, rates),
            Order::Rotate { forward: false } => (-rates.speed, rates),
            Order::Move { count, rates } => {
                let way = self.way_to(count);
                let back = way < 0;
                let (way, speed) = if back { (-way, -speed) } else { (way, speed) };
                let most = braked(way - speed / 2, rates.down.min(brakes)).min(rates.speed);
                // What brakes a move is the way that is left, and the ramp only what has gone too far.
                let rates = Rates { down: rates.down * 2, ..rates };
                (if back { -most } else { most }, rates)
            }
            Order::Stop { rates: stopped } => (I40F24::ZERO, stopped.unwrap_or(rates)),
            Order::None | Order::Halt => (I40F24::ZERO, rates),
        }
    }

    /// From where it is to the middle of that count.
    fn way_to(&self, count: i32) -> I40F24 {
        I40F24::from_num(count.wrapping_sub(self.count)) + HALF - self.seen.place
    }

    /// Whether what was ordered is done.
    fn has_arrived(&self) -> bool {
        let stands = self.seen.speed.abs() <= self.model.slow;
        match self.order {
            Order::Move { count, .. } => stands && self.way_to(count).abs() <= NEAR,
            Order::Stop { .. } => stands && self.pace == 0,
            Order::None | Order::Rotate { .. } | Order::Halt => false,
        }
    }

    /// It stands.
    fn rest(&mut self, at: Instant, out: &mut dyn Sink) {
        if matches!(self.order, Order::Move { .. }) {
            self.left = 0;
        }
        (self.order, self.next, self.pace) = (Order::None, Instant::NEVER, I40F24::ZERO);
        (self.goal, self.last) = (None, None);
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
        if ma != self.open_ma {
            self.open_ma = ma;
            out.put(at, Output::Current { axis: AXIS, ma });
        }
    }

    /// What moves: 0 nothing, 1 forward, −1 backward. Braking is moving.
    pub(super) fn direction(&self) -> i8 {
        if self.is_moving() { self.facing } else { 0 }
    }

    /// Edges counted, forward less backward.
    pub(super) fn position(&self) -> i32 {
        self.count.wrapping_sub(self.zero)
    }

    /// CLR_POSITION: it is 0 here. A move that runs ends where it would have.
    pub(super) fn clear_position(&mut self) {
        self.zero = self.count;
    }

    /// Counts that are left of the last move, also of one that was stopped; 0 of one that has arrived.
    pub(super) fn left(&self) -> i32 {
        self.left
    }

    /// SPEED_VALID, in rpm.
    pub(super) fn speed(&self, at: Instant) -> u16 {
        if !self.settings.sees() {
            let rpm = (i64::from(self.duty.abs()) * i64::from(self.settings.rated) + FULL / 2) >> 16;
            return rpm as u16;
        }
        let Some(Edge { at: last, period: Some(period), .. }) = self.last else { return 0 };
        let turn = period.max(at.since(last)) * self.settings.counts().cast_unsigned();
        let half = turn.ticks() / 2;
        let rpm = (60 * TICKS_PER_SECOND + half).checked_div(turn.ticks()).unwrap_or(0);
        rpm.min(u16::MAX.into()) as u16
    }

    /// CURRENT_VALID, in mA.
    pub(super) fn current(&self) -> u16 {
        self.ma.unsigned_abs().min(u16::MAX.into()) as u16
    }

    /// Bits of ERROR that have come up since it was asked last: 4 no Hall edges where there should be some, 11
    /// the limit of the current holds the motor back, 12 less way left than it takes to stop.
    pub(super) fn errors(&mut self) -> u16 {
        core::mem::take(&mut self.errors)
    }
}

/// So much may be rounding: less by it is not at the limit, and more is not standing.
const MARGIN_MA: i64 = 4;

/// `clamp`, but for limits of which nobody can prove the order.
fn within(value: I40F24, least: I40F24, most: I40F24) -> I40F24 {
    value.min(most).max(least)
}

/// From so many counts on no motor is as fast that it would have to brake.
const FAR: I40F24 = I40F24::lit("65536");

/// In looks.
fn looks(span: Duration) -> I40F24 {
    I40F24::from_bits(((span.ticks() << 24) / LOOK.ticks()).cast_signed())
}

/// The speed at the next look: on from `pace` towards `target`.
fn ramped(pace: I40F24, target: I40F24, rates: Rates) -> I40F24 {
    let (from, to, sign) = if pace < 0 { (-pace, -target, -1) } else { (pace, target, 1) };
    let next = if to >= from {
        to.min(from + rates.up)
    } else {
        // Through 0 not before the next look.
        if from > 0 { to.max(from - rates.down).max(I40F24::ZERO) } else { to.max(-rates.up) }
    };
    next * i64::from(sign)
}

/// The speed at the next look from which the `way` left then just suffices to stop: with v/2 until then
/// v/2 + v²/2·down is the way.
fn braked(way: I40F24, down: I40F24) -> I40F24 {
    let way = way.clamp(I40F24::ZERO, FAR).to_bits().cast_unsigned();
    let down = down.to_bits().cast_unsigned();
    let root = (2 * down * way + down * down / 4).isqrt();
    I40F24::from_bits(root.saturating_sub(down / 2).cast_signed())
}

#[cfg(test)]
mod tests;
