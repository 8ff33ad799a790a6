//! The servo: control of velocity, position and torque, ramps, and the readings of the sensors.
//!
//! While the drive controls the motor, the servo runs every millisecond. A speed loop ([`pi`]) holds velocity and
//! position. Its reference is a [`ramp`], or follows from the remaining distance ([`position`]). Its feedback is the
//! motor's report as the speed sensor reads it ([`sensing`], [`halls`], [`encoder`]). [`watch`] detects faults.

mod encoder;
mod halls;
mod pi;
mod position;
mod ramp;
mod sensing;
mod settings;
#[cfg(test)]
mod tests;
mod watch;

use fixed::types::I40F24;

use self::pi::Pi;
use self::sensing::{Counted, Sensing};
pub(super) use self::settings::{Settings, motor};
use self::watch::{ControlSample, FaultMonitor};
use crate::device::{Context, Duration, Input, Instant, Output, REPORTS_REASONS};
use crate::mdrobot::reasons::Why;
use crate::motor::{AXIS, FULL_DUTY, NEAR, TICK, ramped};

/// Register value of the whole supply as an output, and of `MAX_LOAD` as a torque (p. 12).
pub(super) const OUTPUTS: u16 = 1_023;

/// The speed loop uses the reference this many ms ahead, because the motor follows a ramp 14 to 24 ms late
/// with the factory gains.
const LOOKAHEAD_MS: I40F24 = I40F24::lit("8");
/// Longest time for which a motor may still follow after a ramp has ended.
const MAX_TRAIL: Duration = Duration::millis(200);

/// Order to the motor.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Order {
    /// The terminals are open.
    Free,
    /// The windings are shorted.
    Brake,
    /// Turn at this speed in rpm, positive CCW, with the ramps of `SLOW_START` and `SLOW_DOWN`; at 0 as
    /// `STOP_STATUS` selects.
    Velocity(i32),
    /// Go to a count and hold it, with a limited speed.
    Position {
        /// Target, in counts.
        count: i32,
        /// Greatest speed in rpm, not negative.
        rpm: i32,
    },
    /// Output in 1/1023 of the supply, without speed control.
    Open(i16),
    /// Torque in 1/1023 of `MAX_LOAD`.
    Torque(i16),
}

/// A sensor that changed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Sensor {
    /// Hall sensor 0, 1 or 2: HU, HV, HW.
    Hall(u8),
    /// Channel A of the encoder.
    EncoderA,
    /// Channel B of the encoder.
    EncoderB,
}

/// The drive's control of the motor.
#[derive(Clone, Debug)]
pub(super) struct Servo {
    settings: Settings,
    order: Order,
    /// Time of the next control tick; [`Instant::NEVER`] while the servo does not control the motor.
    next: Instant,
    /// The speed reference on its ramp, in rpm.
    setpoint: I40F24,
    /// Last time at which `setpoint` was not 0.
    setpoint_since: Instant,
    pi: Pi,
    sensing: Sensing,
    /// Requested duty. The current limit may reduce it.
    duty: i32,
    /// Current limit, in mA: 0 while the terminals are open.
    limit_out_ma: u32,
    swapped: bool,
    /// Count of the Hall sensors that is position 0.
    zero: i64,
    target: i32,
    faults: FaultMonitor,
    /// Alarms that are not yet reported.
    alarms: u16,
}

impl Servo {
    /// A servo for a motor at standstill with open terminals.
    pub(super) fn new(settings: Settings) -> Self {
        Self::with(Sensing::new(&settings), settings)
    }

    fn with(sensing: Sensing, settings: Settings) -> Self {
        Self {
            settings,
            order: Order::Free,
            next: Instant::NEVER,
            setpoint: I40F24::ZERO,
            setpoint_since: Instant::ZERO,
            pi: Pi::NEW,
            sensing,
            duty: 0,
            limit_out_ma: 0,
            swapped: false,
            zero: 0,
            target: 0,
            faults: FaultMonitor::NEW,
            alarms: 0,
        }
    }

    /// Handles power-on: puts the state of the terminals. Everything is reset, including the position; only
    /// the motor's feedback stays.
    pub(super) fn power_on(&mut self, at: Instant, settings: Settings, out: &mut dyn Context) {
        *self = Self::with(self.sensing.restarted(&settings), settings);
        out.put(at, Output::Duty { axis: AXIS, duty: self.duty });
        out.put(at, Output::CurrentLimit { axis: AXIS, ma: self.limit_out_ma });
    }

    /// Applies new settings of the registers, all at once.
    pub(super) fn set(&mut self, at: Instant, settings: Settings, out: &mut dyn Context) {
        let before = core::mem::replace(&mut self.settings, settings);
        if settings == before {
            return;
        }
        self.sensing.set(&settings);
        match self.order {
            Order::Brake => self.release(at, true, out),
            Order::Velocity(_) if !self.is_controlling() => {
                // A motor released at speed 0 may have to be held there with the new settings. A coasting
                // motor is controlled again only if `STOP_STATUS` has changed.
                let is_other = settings.stop_status != before.stop_status;
                if is_other || self.goal() != Some(0) {
                    self.start_control(at, out);
                }
            }
            _ if self.is_controlling() => self.terminals(at, self.duty, self.allowed(), out),
            _ => {}
        }
    }

    /// The last order.
    #[cfg(test)]
    pub(super) fn ordered(&self) -> Order {
        self.order
    }

    /// Executes an order. Repeating the same order changes nothing.
    pub(super) fn order(&mut self, at: Instant, order: Order, out: &mut dyn Context) {
        let before = core::mem::replace(&mut self.order, order);
        if order == before {
            return;
        }
        if let Order::Position { count, .. } = order {
            self.target = count;
        }
        match (before, order) {
            (_, Order::Free) => self.release(at, false, out),
            (_, Order::Brake) => self.release(at, true, out),
            (Order::Velocity(_), Order::Velocity(_)) | (Order::Position { .. }, Order::Position { .. })
                if self.is_controlling() => {}
            _ => self.start_control(at, out),
        }
    }

    /// The reason why the motor does not turn as the present order says.
    pub(super) fn stands(&self) -> Option<Why> {
        match self.order {
            _ if !REPORTS_REASONS => None,
            Order::Free | Order::Brake | Order::Velocity(0) | Order::Open(0) | Order::Torque(0) => None,
            _ if self.settings.limit_ma == 0 => Some(Why::NoCurrent),
            Order::Position { rpm: 0, .. } if self.settings.max_rpm == 0 => Some(Why::NoMaxRpm),
            Order::Position { rpm: 0, .. } => Some(Why::NoSpeed),
            Order::Position { .. } if self.settings.pv_gain == 0 => Some(Why::NoGain),
            _ => None,
        }
    }

    /// Time of the next control tick, or of the check of an impossible Hall code.
    pub(super) fn deadline(&self) -> Instant {
        self.next.min(self.sensing.deadline())
    }

    /// Executes a control tick and the check of a Hall code if they are due. Returns true if one of them was.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        let is_due = self.deadline() <= at;
        self.sensing.timeout(at);
        if at >= self.next {
            self.tick(at, out);
        }
        is_due
    }

    /// Starts to control the motor, from its present speed.
    fn start_control(&mut self, at: Instant, out: &mut dyn Context) {
        let duty = if self.is_controlling() && self.limit_out_ma > 0 {
            self.applied_duty(at)
        } else {
            self.sensing.back_emf(at)
        };
        let duty = duty.clamp(-pi::FULL, pi::FULL);
        self.pi.begin(duty);
        self.sensing.begin(at);
        (self.setpoint, self.faults) = (self.reading(at), FaultMonitor::NEW);
        self.next = at + TICK;
        if let Some(shorted) = self.is_over(at) {
            return self.release(at, shorted, out);
        }
        self.terminals(at, duty.round().to_num(), self.limit(), out);
    }

    /// Stops controlling the motor and opens or shorts its terminals.
    fn release(&mut self, at: Instant, shorted: bool, out: &mut dyn Context) {
        if self.reading(at).round() == 0 {
            self.sensing.set_standstill();
        }
        (self.next, self.setpoint, self.faults) = (Instant::NEVER, I40F24::ZERO, FaultMonitor::NEW);
        self.terminals(at, 0, if shorted { self.limit() } else { 0 }, out);
    }

    /// Sets the terminals if duty or current limit have changed.
    fn terminals(&mut self, at: Instant, duty: i32, limit_out_ma: u32, out: &mut dyn Context) {
        if (duty, limit_out_ma) == (self.duty, self.limit_out_ma) {
            return;
        }
        let before = core::mem::replace(&mut self.limit_out_ma, limit_out_ma);
        if duty != self.duty {
            self.duty = duty;
            self.put_duty(at, out);
        }
        if limit_out_ma != before {
            out.put(at, Output::CurrentLimit { axis: AXIS, ma: limit_out_ma });
        }
    }

    fn put_duty(&self, at: Instant, out: &mut dyn Context) {
        out.put(at, Output::Duty { axis: AXIS, duty: if self.swapped { -self.duty } else { self.duty } });
    }

    /// Returns true if the servo controls the motor.
    fn is_controlling(&self) -> bool {
        self.next != Instant::NEVER
    }

    fn limit(&self) -> u32 {
        self.settings.limit_ma
    }

    /// Sets the terminals as the order requires.
    fn tick(&mut self, at: Instant, out: &mut dyn Context) {
        self.next = at + TICK;
        let (setpoint, wanted) = match self.order {
            Order::Free | Order::Brake => return self.release(at, self.order == Order::Brake, out),
            Order::Velocity(_) => {
                let goal = I40F24::from_num(self.goal().unwrap_or(0));
                let rate = |slow| ramp::rate(slow, self.settings.max_rpm);
                let (up, down) = (rate(self.settings.slow_start), rate(self.settings.slow_down));
                let setpoint = ramped(self.setpoint, goal, up, down);
                let slope = ramped(setpoint, goal, up, down) - setpoint;
                let ahead = setpoint.saturating_add(slope.saturating_mul(LOOKAHEAD_MS));
                (setpoint, ahead.max(setpoint.min(goal)).min(setpoint.max(goal)))
            }
            Order::Position { rpm, .. } => {
                let setpoint =
                    position::speed_to_target(self.distance(), rpm, at, &self.sensing, &self.settings);
                (setpoint, setpoint)
            }
            Order::Open(output) => {
                let duty = of_output(output);
                self.terminals(at, duty.round().to_num(), self.limit(), out);
                return self.check_faults(at, duty, None);
            }
            Order::Torque(torque) => {
                // The duty is the whole supply, and the current limit sets the torque.
                self.terminals(at, i32::from(torque.signum()) * FULL_DUTY, self.allowed(), out);
                return self.check_faults(at, self.applied_duty(at), None);
            }
        };
        self.setpoint = setpoint;
        if setpoint != 0 {
            self.setpoint_since = at;
        }
        if let Some(shorted) = self.is_over(at) {
            return self.release(at, shorted, out);
        }
        let (wanted, emf) = (self.sensing.duty_of(wanted), self.sensing.back_emf(at));
        let Settings { p_gain, i_gain, .. } = self.settings;
        let motor = self.sensing.motor();
        let headroom = motor.duty(motor.speed_drop(self.limit().into()));
        let (output, duty) = self.pi.step(wanted - emf, emf, headroom, motor.gain, p_gain, i_gain);
        self.terminals(at, duty.round().to_num(), self.limit(), out);
        self.check_faults(at, output, Some((wanted, emf)));
    }

    /// Returns how to release the motor, if the speed reference stays 0 and the motor is to be released: true
    /// with shorted terminals, false with open terminals (MDROBOT-17).
    fn is_over(&self, at: Instant) -> Option<bool> {
        if self.goal() != Some(0) {
            return None;
        }
        match self.settings.stop_status {
            1 => None,
            3 => Some(false),
            _ if self.setpoint != 0 || self.trails(at) => None,
            status => Some(status == 2),
        }
    }

    /// Returns true if the motor has not yet reached standstill after a ramp to 0.
    fn trails(&self, at: Instant) -> bool {
        self.settings.slow_down > 0
            && at.since(self.setpoint_since) < MAX_TRAIL
            && self.reading(at).round() != 0
    }

    /// The speed in rpm at which the ramp ends; `None` without speed control.
    fn goal(&self) -> Option<i32> {
        let most = i32::from(self.settings.max_rpm);
        if let Order::Velocity(rpm) = self.order { Some(rpm.clamp(-most, most)) } else { None }
    }

    /// Current limit while the servo controls the motor, in mA: `MAX_LOAD`, or a part of it in torque
    /// control.
    fn allowed(&self) -> u32 {
        let Order::Torque(torque) = self.order else { return self.limit() };
        let part =
            u64::from(torque.unsigned_abs().min(OUTPUTS)) * u64::from(self.limit()) / u64::from(OUTPUTS);
        u32::try_from(part).unwrap_or(u32::MAX)
    }

    /// Checks for faults.
    fn check_faults(&mut self, at: Instant, wanted: I40F24, speeds: Option<(I40F24, I40F24)>) {
        let sample = ControlSample {
            ma: self.current(),
            limit_ma: self.limit(),
            wanted,
            speeds,
            rpm: self.rpm(at),
            hall: self.sensing.last_hall_edge(),
        };
        self.alarms |= self.faults.update(at, sample);
    }

    /// Handles a level of a sensor.
    pub(super) fn edge(&mut self, at: Instant, sensor: Sensor, high: bool) {
        let counted = self.sensing.edge(at, sensor, high);
        self.watch_encoder(at, counted);
    }

    /// Breaks or repairs the wire of a Hall sensor, and the wires of the encoder.
    pub(super) fn cut(&mut self, at: Instant, halls: bool, encoder: bool) {
        let counted = self.sensing.cut(at, halls, encoder);
        self.watch_encoder(at, counted);
    }

    /// Compares the edges of the Hall sensors and the encoder.
    fn watch_encoder(&mut self, at: Instant, counted: Option<Counted>) {
        match counted {
            Some(Counted::Encoder) => self.faults.encoder_edge(),
            Some(Counted::Halls) if self.settings.enc_ppr > 0 && self.is_controlling() => {
                let (count, turn) = (self.sensing.count(), self.sensing.turn());
                self.alarms |= self.faults.hall_edge(at, count, turn, self.settings.encoder_counts().into());
            }
            _ => {}
        }
    }

    /// Handles a report of the motor.
    #[inline]
    pub(super) fn report(&mut self, at: Instant, input: &Input<'_>) {
        self.sensing.report(at, input);
    }

    /// Swaps two wires of the motor, which reverses the direction of the duty, or restores them.
    pub(super) fn swap(&mut self, at: Instant, swapped: bool, out: &mut dyn Context) {
        if swapped != self.swapped {
            self.swapped = swapped;
            self.put_duty(at, out);
        }
    }

    /// Levels of channels A and B of the encoder, even while its wires are broken.
    pub(super) fn encoder_levels(&self) -> [bool; 2] {
        self.sensing.encoder_levels()
    }

    /// Speed in rpm that the speed sensor reads, also between two edges.
    fn reading(&self, at: Instant) -> I40F24 {
        self.sensing.reading(at)
    }

    /// Speed in rpm from the edges of the speed sensor alone, positive CCW, not limited.
    pub(super) fn rpm(&self, at: Instant) -> i32 {
        self.sensing.rpm(at)
    }

    /// Current in mA. Its sign refers to the direction of the output.
    pub(super) fn current(&self) -> i32 {
        let ma = self.sensing.ma();
        if self.swapped { ma.saturating_neg() } else { ma }
    }

    /// The output in 1/1023 of the supply, reduced by the current limit.
    pub(super) fn output(&self, at: Instant) -> i16 {
        (self.applied_duty(at) * i64::from(OUTPUTS) / i64::from(FULL_DUTY)).round().to_num()
    }

    /// The output as a duty, reduced by the current limit.
    fn applied_duty(&self, at: Instant) -> I40F24 {
        let sign = if self.swapped { -1 } else { 1 };
        I40F24::from_num(sign * self.sensing.applied(at, sign * self.duty, self.limit_out_ma))
    }

    /// Returns the alarms that have occurred since the last call, as bits of
    /// [`Alarm`](crate::mdrobot::alarm::Alarm).
    pub(super) fn alarms(&mut self) -> u16 {
        core::mem::take(&mut self.alarms)
    }

    /// Returns true if the Hall sensors have had an impossible code for too long.
    pub(super) fn halls_are_broken(&self) -> bool {
        self.sensing.halls_are_broken()
    }

    /// Distance to the target in counts.
    fn distance(&self) -> i64 {
        self.distance_to(self.target)
    }

    /// Distance from the motor's position to `position`, in counts.
    pub(super) fn distance_to(&self, position: i32) -> i64 {
        self.zero + i64::from(position) - self.sensing.count()
    }

    /// Position in counts of the Hall sensors, positive CCW, limited to the range of positions.
    pub(super) fn position(&self) -> i32 {
        position::of_counts(self.sensing.count() - self.zero)
    }

    /// Sets the present position to 0. The target of position control is shifted by the same amount.
    pub(super) fn clear_position(&mut self) {
        self.target = position::of_counts(self.distance());
        self.zero = self.sensing.count();
        if let Order::Position { count, .. } = &mut self.order {
            *count = self.target;
        }
    }

    /// Present or last target of position control, in counts. Clearing the position shifts it.
    pub(super) fn target(&self) -> i32 {
        self.target
    }

    /// Position error in counts; `None` if the order is not a position.
    pub(super) fn error(&self) -> Option<i64> {
        matches!(self.order, Order::Position { .. }).then(|| self.distance())
    }
}

/// The duty of an output in 1/1023 of the supply (MDROBOT-28).
fn of_output(output: i16) -> I40F24 {
    let output = i64::from(output).clamp(-i64::from(OUTPUTS), OUTPUTS.into());
    I40F24::from_num(output * i64::from(FULL_DUTY)) / i64::from(OUTPUTS)
}
