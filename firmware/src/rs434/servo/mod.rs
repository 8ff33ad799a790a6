//! The servo: ramps, moves, and the counts of the Hall sensors.
//!
//! While the motor moves, the servo runs every millisecond ([`TICK`]). From the registers ([`Settings`]) and
//! the remaining distance it computes the speed that the motor must have at the next tick ([`Limits`]). From
//! the motor's reports ([`Feedback`]), as the Hall sensors show them ([`Edges`]), it computes the duty for
//! this speed. Speeds are in counts per tick, accelerations in counts per tick².
//!
//! The servo does not follow a plan in time. The speed reference changes from tick to tick and stays near the
//! motor's speed, and a move is braked according to the remaining distance. So if something holds the motor
//! back, the servo waits, and no error accumulates meanwhile (RS434-13).

mod count;
mod held_back;
mod path;
mod settings;
#[cfg(test)]
mod tests;

use fixed::types::I40F24;

use self::count::Counter;
use self::held_back::HeldBack;
use self::path::{FAR, Limits};
use self::settings::RPM;
pub(super) use self::settings::Settings;
use super::errors::Error;
use super::reasons::Why;
use crate::device::{Context, Input, Instant, Output};
use crate::motor::{AXIS, Edges, FULL_DUTY, Feedback, NEAR, TICK, scaled};

/// The greatest duty, 0.98 of the supply, and the least duty above 0, 0.01 of the supply (section 3).
const MAX_DUTY: i32 = FULL_DUTY / 100 * 98 + FULL_DUTY % 100 * 98 / 100;
const MIN_DUTY: i32 = FULL_DUTY / 100 + 1;

/// Distance in counts that the motor may coast with shorted terminals at the end of a move.
const MAX_COAST: I40F24 = I40F24::lit("0.03125");
/// Speed in rpm below which the shaft counts as standing. Without friction a motor never comes completely to
/// rest.
const STANDSTILL_RPM: I40F24 = I40F24::lit("0.002");
/// A shaft that its load pulls counts as standing below this fraction (1/128) of its full speed.
const PULLED_DIVISOR: i64 = 128;

/// Largest difference between setpoint and motor speed, in ticks of the ramp. Without this limit the setpoint
/// would keep growing while the motor is blocked, and the motor would jump when it is released.
const MAX_LEAD_TICKS: i64 = 4;
/// Number of ticks in which the additional duty for a shaft that does not move grows to the whole supply.
const BREAKAWAY_TICKS: i64 = 64;
/// The Hall wires are checked each time the shaft has turned by this number of counts. If less than
/// 1/`MIN_COUNTED` of them were counted, a wire is broken.
const CHECK_COUNTS: I40F24 = I40F24::lit("16");
const MIN_COUNTED: i64 = 4;

/// Order to the motor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Order {
    /// No motion: the motor is at rest, or is turned from outside.
    None,
    /// Continuous rotation.
    Rotate { forward: bool },
    /// A move to the middle of the count `count`.
    Move { count: i64, rates: Limits },
    /// A stop with a ramp. `rates` are those of the stopped move, if it was a move.
    Stop { rates: Option<Limits> },
    /// A stop with shorted terminals.
    Halt,
}

/// Target of a move.
#[derive(Clone, Copy, Debug)]
struct Goal {
    count: i64,
    /// Direction of the move: 1 forward, −1 backward.
    sign: i64,
}

impl Goal {
    /// Remaining counts at `count`; 0 beyond the target. The motor passes the target because of the
    /// compensation, or if it cannot brake enough.
    fn left(self, count: i64) -> i32 {
        let left = self.count - count;
        if left.signum() == self.sign { left.clamp(i32::MIN.into(), i32::MAX.into()) as i32 } else { 0 }
    }
}

/// Control of the motor by the drive.
#[derive(Clone, Debug)]
pub(super) struct Servo {
    settings: Settings,
    feedback: Feedback,
    order: Order,
    next: Instant,
    /// The speed reference.
    setpoint: I40F24,
    /// Direction of the present or the last motion: 1 forward, −1 backward.
    direction: i8,
    duty: i32,
    /// Duty that the motor has not got yet, because a duty between 0 and the least duty is impossible. The
    /// next ticks add it.
    owed: I40F24,
    /// Additional speed reference for a shaft that does not move although load and friction are compensated.
    breakaway: I40F24,
    /// Current limit at the terminals, in mA; 0 while the terminals are open.
    limit_ma: u32,
    held_back: HeldBack,
    counter: Counter,
    edges: Edges,
    /// Reference for the check of the Hall wires: angle of the shaft in 2⁻³² turns, and the count at this
    /// angle.
    compared: Option<(i64, i64)>,
    /// Target of the present move, or of a move that was stopped on its way.
    goal: Option<Goal>,
    /// Remaining counts of the last move.
    left: i32,
    errors: u16,
}

impl Servo {
    /// A motor at standstill. Its terminals are as MODE_COIL selects.
    pub(super) fn new(at: Instant, settings: Settings) -> Self {
        Self {
            settings,
            feedback: Feedback::new(&settings.motor()),
            order: Order::None,
            next: Instant::NEVER,
            setpoint: I40F24::ZERO,
            direction: 0,
            duty: 0,
            owed: I40F24::ZERO,
            breakaway: I40F24::ZERO,
            limit_ma: if settings.closed { settings.limit_ma } else { 0 },
            held_back: HeldBack::NONE,
            counter: Counter::new(at),
            edges: Edges::new(settings.counts() as i32),
            compared: None,
            goal: None,
            left: 0,
            errors: 0,
        }
    }

    /// Resets the servo at power-on or at a restart, and puts the state of the terminals. The motor's
    /// feedback is kept.
    pub(super) fn power_on(&mut self, at: Instant, settings: Settings, out: &mut dyn Context) {
        let feedback = self.feedback;
        *self = Self::new(at, settings);
        if feedback.is_reported() {
            self.feedback = feedback;
        }
        out.put(at, Output::Duty { axis: AXIS, duty: self.duty });
        out.put(at, Output::CurrentLimit { axis: AXIS, ma: self.limit_ma });
    }

    /// Applies new register values. A move keeps the speed and the ramps with which it began. All other
    /// settings take effect at once: those of continuous rotation, the sensors, the current limit, and the
    /// terminals of a motor at rest. Returns true if anything has changed (RS434-15).
    pub(super) fn set(&mut self, at: Instant, settings: Settings, out: &mut dyn Context) -> bool {
        if settings == self.settings {
            return false;
        }
        let speed = self.speed_at(at);
        let before = core::mem::replace(&mut self.settings, settings);
        if !self.feedback.is_reported() {
            self.feedback = Feedback::new(&settings.motor());
        }
        let (to, from) = (settings.counts(), before.counts());
        if to != from || settings.halls != before.halls {
            // The drive's internal motor changes too, and is then at another angle.
            self.edges = Edges::new(to as i32);
            self.compared = None;
        }
        if settings.halls != before.halls {
            // Open loop continues with the present speed, and so does a newly started closed loop.
            self.setpoint = if before.has_sensors() { scaled(speed, to, from) } else { self.speed_at(at) };
        } else if to != from {
            self.setpoint = scaled(self.setpoint, to, from);
        }
        if to != from
            && let Order::Move { rates, .. } | Order::Stop { rates: Some(rates) } = &mut self.order
        {
            *rates = rates.rescaled(to, from);
        }
        self.terminals(at, out);
        true
    }

    /// Starts continuous rotation. A motor that turns the other way is first brought to standstill.
    pub(super) fn rotate(&mut self, at: Instant, forward: bool, out: &mut dyn Context) {
        self.goal = None;
        self.start(at, Order::Rotate { forward }, if forward { 1 } else { -1 }, out);
    }

    /// Starts a move by `counts` from the present position, with two Hall sensors. The move stops
    /// `compensation` counts further in the direction of the motion, but never behind its start. The
    /// remaining distance is counted to `counts` itself. If no distance is left there is no motion, and no
    /// remaining distance (RS434-17).
    ///
    /// # Errors
    /// No distance is left.
    pub(super) fn go(
        &mut self,
        at: Instant,
        counts: i32,
        compensation: i16,
        out: &mut dyn Context,
    ) -> Result<(), Why> {
        let sign = i64::from(counts.signum());
        let distance = i64::from(counts) + sign * i64::from(compensation);
        if distance.signum() != sign || sign == 0 {
            (self.goal, self.left) = (None, 0);
            return Err(Why::Compensated);
        }
        let here = self.counter.count();
        let (count, rates) = (here + distance, self.settings.rates());
        (self.goal, self.left) = (Some(Goal { count: here + i64::from(counts), sign }), counts);
        let speed = self.speed_at(at);
        if self.is_moving() && rates.is_too_fast(self.distance_to(at, count), speed, self.max_deceleration())
        {
            self.errors |= Error::Braking as u16;
        }
        self.start(at, Order::Move { count, rates }, sign as i8, out);
        Ok(())
    }

    /// Stops with DEC. A move stops with the DEC with which it began.
    pub(super) fn stop(&mut self) {
        match self.order {
            Order::Rotate { .. } => self.order = Order::Stop { rates: None },
            Order::Move { rates, .. } => self.order = Order::Stop { rates: Some(rates) },
            Order::None | Order::Stop { .. } | Order::Halt => {}
        }
    }

    /// Stops with the present DEC, also a move.
    pub(super) fn brake(&mut self) {
        self.stop();
        if let Order::Stop { rates } = &mut self.order {
            *rates = None;
        }
    }

    /// Stops without a ramp.
    pub(super) fn halt(&mut self, at: Instant, out: &mut dyn Context) {
        if !self.is_moving() {
            return;
        }
        (self.order, self.next) = (Order::Halt, at + TICK);
        self.apply(at, 0, out);
    }

    /// Starts an order. If the motor is at rest, also runs the first tick.
    fn start(&mut self, at: Instant, order: Order, direction: i8, out: &mut dyn Context) {
        let moved = self.is_moving();
        self.order = order;
        if moved {
            return;
        }
        self.direction = direction;
        self.edges.begin(at, &self.feedback);
        self.compare_from(at);
        (self.setpoint, self.owed, self.breakaway) = (I40F24::ZERO, I40F24::ZERO, I40F24::ZERO);
        self.held_back = HeldBack::NONE;
        self.next = at;
        self.terminals(at, out);
        self.tick(at, out);
    }

    /// Handles a change of Hall sensor A (`a`) or B.
    pub(super) fn edge(&mut self, at: Instant, a: bool, high: bool) {
        match self.counter.edge(at, a, high, self.settings.halls, self.direction > 0) {
            Ok(Some(forward)) => {
                if self.settings.halls == 1 {
                    // The count of a single sensor follows the commanded direction, so it can go up and down.
                    // But each edge shows that the wire is whole.
                    self.compare_from(at);
                }
                // A single sensor shows no direction, so swapped wires cannot give it a wrong one.
                let really = self.feedback.rpm(at).filter(|_| self.settings.halls == 1).map(|rpm| rpm >= 0);
                self.edges.edge(at, really.unwrap_or(forward), &self.feedback);
                if let Some(goal) = self.goal {
                    self.left = goal.left(self.counter.count());
                }
            }
            Ok(None) => {}
            Err(_) => self.errors |= Error::Hall as u16,
        }
    }

    /// Takes the present angle and count as the reference of the check of the Hall wires.
    fn compare_from(&mut self, at: Instant) {
        self.compared = self.feedback.angle(at).map(|angle| (angle, self.counter.count()));
    }

    /// Handles a report of the motor.
    #[inline]
    pub(super) fn report(&mut self, at: Instant, input: &Input<'_>) {
        self.feedback.report(at, input);
        if let Input::Rotation { rotation, .. } = input {
            self.compared.get_or_insert((rotation.angle, self.counter.count()));
        }
    }

    /// Time of the next tick.
    pub(super) fn deadline(&self) -> Instant {
        self.next
    }

    /// Runs the next tick if it is due.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if at >= self.next {
            self.tick(at, out);
        }
    }

    fn tick(&mut self, at: Instant, out: &mut dyn Context) {
        self.next = at + TICK;
        if self.order == Order::Halt {
            self.brake_short(at, out);
        } else if self.settings.has_sensors() {
            self.closed_loop(at, out);
        } else {
            self.open_loop(at, out);
        }
        if self.held_back.update(at, self.limited_direction(), self.feedback.rpm(at)) {
            self.errors |= Error::CurrentLimit as u16;
        }
    }

    /// Direction of the torque of a current at its limit; 0 below the limit.
    fn limited_direction(&self) -> i32 {
        if self.feedback.is_limited(self.limit_ma) { self.feedback.ma.signum() } else { 0 }
    }

    /// Brakes with shorted terminals, until the motor is at rest or as slow as its load permits (RS434-20).
    fn brake_short(&mut self, at: Instant, out: &mut dyn Context) {
        self.setpoint = self.speed_at(at);
        let rpm = self.feedback.rpm(at).unwrap_or(self.shaft_rpm(self.setpoint));
        let motor = &self.feedback.motor;
        let pulled = motor.torque(0).abs();
        let slow = if pulled == 0 { STANDSTILL_RPM } else { pulled + motor.rpm(FULL_DUTY) / PULLED_DIVISOR };
        if rpm.abs() <= slow {
            self.finish(at, out);
        }
    }

    /// A tick without sensors: the duty follows the ramp, and the speed depends on the load.
    fn open_loop(&mut self, at: Instant, out: &mut dyn Context) {
        let (target, rates) = self.target(at, I40F24::ZERO);
        self.setpoint = rates.ramped(self.setpoint, target);
        if self.setpoint == 0 && target == 0 {
            return self.finish(at, out);
        }
        self.update_direction();
        let full = self.settings.of_rpm(self.settings.rated);
        let duty = (self.setpoint * i64::from(FULL_DUTY)).checked_div(full).unwrap_or(I40F24::ZERO);
        let duty = match possible(duty) {
            // The motor must turn, even if the requested speed is below that of the least duty.
            0 if self.setpoint == target => MIN_DUTY * i32::from(self.direction),
            duty => duty,
        };
        self.apply(at, duty, out);
    }

    /// A tick with sensors.
    fn closed_loop(&mut self, at: Instant, out: &mut dyn Context) {
        if self.is_miswired(at) {
            self.errors |= Error::Hall as u16;
        }
        let speed = self.speed_at(at);
        if self.has_arrived(at, speed) {
            return self.finish(at, out);
        }
        if self.coasts_to_target(at, speed) {
            self.setpoint = I40F24::ZERO;
            return self.apply(at, 0, out);
        }
        let (target, rates) = self.target(at, speed);
        // The setpoint waits if the motor is held back.
        let band = rates.up.max(rates.down) * MAX_LEAD_TICKS;
        let setpoint = self.setpoint.min(speed + band).max(speed - band);
        self.setpoint = rates.ramped(setpoint, target);
        self.update_direction();
        let motor = &self.feedback.motor;
        let full = motor.rpm(FULL_DUTY);
        let is_stuck = speed == 0 && self.setpoint != 0 && self.duty != 0;
        self.breakaway =
            if is_stuck { (self.breakaway + full / BREAKAWAY_TICKS).min(2 * full) } else { I40F24::ZERO };
        let breakaway = motor.duty(self.breakaway * i64::from(self.direction));
        // At the end of a stop the left-out duty is dropped, because shorted terminals end the motion.
        let ends = self.setpoint == 0 && target == 0 && motor.holds();
        let owed = if ends { I40F24::ZERO } else { self.owed };
        let wanted =
            motor.duty_to_reach(self.shaft_rpm(speed), self.shaft_rpm(self.setpoint)) + breakaway + owed;
        let wanted = if ends && wanted.signum() == speed.signum() { I40F24::ZERO } else { wanted };
        // The direction of a single sensor is assumed to be the commanded one. A duty against it could
        // reverse the shaft unnoticed.
        let against = wanted.signum() * i64::from(self.direction) < 0;
        let wanted = if self.settings.halls == 1 && against { I40F24::ZERO } else { wanted };
        let duty = possible(wanted);
        self.owed = if duty.abs() <= MIN_DUTY { wanted - I40F24::from_num(duty) } else { I40F24::ZERO };
        self.apply(at, duty, out);
    }

    /// Returns true if the edges of the Hall sensors do not match the rotation of the shaft: a wire is
    /// broken, or the wires are swapped.
    fn is_miswired(&mut self, at: Instant) -> bool {
        let count = self.counter.count();
        if self.edges.per_turn() < 0 {
            return true;
        }
        let (Some((from, counted)), Some(angle)) = (self.compared, self.feedback.angle(at)) else {
            return false;
        };
        let turned = self.edges.counts_from(from, at, &self.feedback).abs();
        if turned <= CHECK_COUNTS {
            return false;
        }
        self.compared = Some((angle, count));
        let made = I40F24::from_num((count - counted).clamp(-FAR, FAR)).abs();
        made * MIN_COUNTED < turned
    }

    /// Greatest decrease of speed per tick by the current limit, with the effects of load and friction.
    fn max_deceleration(&self) -> I40F24 {
        let rpm =
            self.feedback.motor.max_deceleration(self.settings.limit_ma, MAX_DUTY, self.direction.into());
        scaled(self.edges.of_sensor(rpm), self.edges.turn(), RPM).max(I40F24::DELTA)
    }

    /// Speed as the Hall sensors show it.
    fn speed_at(&self, at: Instant) -> I40F24 {
        let speed = scaled(self.edges.reading(at, &self.feedback), self.edges.turn(), RPM);
        if self.settings.halls == 1 { speed.abs() * i64::from(self.direction) } else { speed }
    }

    /// Speed of the shaft in rpm, for a speed that the Hall sensors show.
    fn shaft_rpm(&self, speed: I40F24) -> I40F24 {
        self.edges.of_shaft(scaled(speed, RPM, self.edges.turn()))
    }

    /// The target speed, and the ramps to reach it.
    fn target(&self, at: Instant, speed: I40F24) -> (I40F24, Limits) {
        let rates = self.settings.rates();
        match self.order {
            Order::Rotate { forward: true } => (rates.speed, rates),
            Order::Rotate { forward: false } => (-rates.speed, rates),
            Order::Move { count, rates } => {
                rates.towards_target(self.distance_to(at, count), speed, self.max_deceleration())
            }
            Order::Stop { rates: stopped } => (I40F24::ZERO, stopped.unwrap_or(rates)),
            Order::None | Order::Halt => (I40F24::ZERO, rates),
        }
    }

    /// Distance from the shaft to the middle of the count `count`, limited to [`FAR`].
    fn distance_to(&self, at: Instant, count: i64) -> I40F24 {
        self.edges.distance(count - self.counter.count(), FAR, at, &self.feedback)
    }

    /// Returns true if a move is so slow and so near its end that it ends on its count with shorted
    /// terminals.
    fn coasts_to_target(&self, at: Instant, speed: I40F24) -> bool {
        let Order::Move { count, .. } = self.order else { return false };
        let motor = &self.feedback.motor;
        let slides = speed.abs().saturating_mul(motor.slowness);
        motor.holds() && slides <= MAX_COAST && self.distance_to(at, count).abs() <= NEAR
    }

    /// Returns true if the order is complete at this speed.
    fn has_arrived(&self, at: Instant, speed: I40F24) -> bool {
        let motor = &self.feedback.motor;
        let slow = if motor.holds() { STANDSTILL_RPM } else { motor.rpm(FULL_DUTY) / PULLED_DIVISOR };
        let stands = self.shaft_rpm(speed).abs() <= slow;
        match self.order {
            Order::Move { count, .. } => stands && self.distance_to(at, count).abs() <= NEAR,
            Order::Stop { .. } => stands && self.setpoint == 0,
            Order::None | Order::Rotate { .. } | Order::Halt => false,
        }
    }

    /// Ends the motion at standstill.
    fn finish(&mut self, at: Instant, out: &mut dyn Context) {
        if matches!(self.order, Order::Move { .. }) {
            (self.goal, self.left) = (None, 0);
        }
        (self.order, self.next, self.setpoint) = (Order::None, Instant::NEVER, I40F24::ZERO);
        self.edges.set_standstill();
        self.apply(at, 0, out);
        self.terminals(at, out);
    }

    fn is_moving(&self) -> bool {
        self.order != Order::None
    }

    /// Sets the direction to that of the setpoint, unless the setpoint is 0.
    fn update_direction(&mut self) {
        if self.setpoint != 0 {
            self.direction = if self.setpoint > 0 { 1 } else { -1 };
        }
    }

    fn apply(&mut self, at: Instant, duty: i32, out: &mut dyn Context) {
        if duty != self.duty {
            self.duty = duty;
            out.put(at, Output::Duty { axis: AXIS, duty });
        }
    }

    /// Opens or closes the terminals, depending on the motion and on MODE_COIL.
    fn terminals(&mut self, at: Instant, out: &mut dyn Context) {
        let closed = self.is_moving() || self.settings.closed;
        let ma = if closed { self.settings.limit_ma } else { 0 };
        if ma != self.limit_ma {
            self.limit_ma = ma;
            out.put(at, Output::CurrentLimit { axis: AXIS, ma });
        }
    }

    /// Returns true while a move, or the stop of one, keeps the speed and the ramps with which it began.
    pub(super) fn keeps_rates(&self) -> bool {
        matches!(self.order, Order::Move { .. } | Order::Stop { rates: Some(_) })
    }

    /// Direction of motion: 0 none, 1 forward, −1 backward. Braking counts as motion.
    pub(super) fn direction(&self) -> i8 {
        if self.is_moving() { self.direction } else { 0 }
    }

    /// Counted edges, forward minus backward; wraps.
    pub(super) fn position(&self) -> i32 {
        self.counter.position()
    }

    /// Executes CLR_POSITION: makes the position 0 at the present count. The end of a move in progress stays
    /// the same.
    pub(super) fn clear_position(&mut self) {
        self.counter.clear_position();
    }

    /// Remaining counts of the last move, also of a stopped one; 0 after a completed move.
    pub(super) fn left(&self) -> i32 {
        self.left
    }

    /// SPEED_VALID in rpm: the measured speed, or without sensors the speed that the duty should give.
    pub(super) fn speed(&self, at: Instant) -> u16 {
        if self.settings.has_sensors() {
            self.edges.rpm(at).unsigned_abs().min(u16::MAX.into()) as u16
        } else {
            let rpm = i64::from(self.duty.abs()) * i64::from(self.settings.rated);
            ((rpm + i64::from(FULL_DUTY) / 2) >> 16) as u16
        }
    }

    /// CURRENT_VALID in mA, rounded: the current from the supply, which is the motor's current times the
    /// duty; 0 while the current flows back.
    pub(super) fn current(&self, at: Instant) -> u16 {
        let duty = self.feedback.applied(at, self.duty, self.limit_ma);
        let given = (i64::from(self.feedback.ma) * i64::from(duty) + (1 << 15)) >> 16;
        given.clamp(0, u16::MAX.into()) as u16
    }

    /// Bits of ERROR set since the last call of this function.
    pub(super) fn errors(&mut self) -> u16 {
        core::mem::take(&mut self.errors)
    }
}

/// The nearest possible duty (section 3).
fn possible(duty: I40F24) -> i32 {
    let size = duty.abs().min(MAX_DUTY.into()).round().to_num::<i32>();
    let size = if size < MIN_DUTY / 2 { 0 } else { size.max(MIN_DUTY) };
    if duty < 0 { -size } else { size }
}
