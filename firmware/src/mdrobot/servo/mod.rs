//! The servo: control of velocity, position and torque, ramps, and the readings of the sensors.
//!
//! While the drive controls the motor, the servo runs every millisecond ([`control`]). A speed loop ([`pi`])
//! holds velocity and position. Its reference is a [`ramp`], or follows from the remaining distance
//! ([`position`]). Its feedback is the motor's report ([`Feedback`]), as the speed sensor reads it
//! ([`Edges`], [`halls`], [`encoder`]). [`watch`] detects faults.

mod control;
mod encoder;
mod halls;
mod pi;
mod position;
mod ramp;
mod sensing;
#[cfg(test)]
mod tests;
mod watch;

use fixed::types::I40F24;

use self::encoder::Encoder;
use self::halls::Halls;
use self::pi::Pi;
use self::watch::FaultMonitor;
use crate::device::{Context, Instant, Output, REPORTS_REASONS, Rotation};
use crate::mdrobot::drive::MOTOR;
use crate::mdrobot::reasons::Why;
use crate::motor::{AXIS, ControlModel, Edges, FULL_DUTY, Feedback, NEAR, Parameters, TICK};

/// Register value of the whole supply as an output, and of `MAX_LOAD` as a torque (p. 12).
pub(super) const OUTPUTS: u16 = 1_023;

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

/// Settings from the registers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Settings {
    /// `MAX_RPM`, limited to its range.
    pub(super) max_rpm: u16,
    /// `MAX_LOAD`, limited to its range, in mA.
    pub(super) limit_ma: u32,
    /// `PV_GAIN`, in rpm for each count.
    pub(super) pv_gain: u16,
    /// P_GAIN.
    pub(super) p_gain: u16,
    /// I_GAIN.
    pub(super) i_gain: u16,
    /// SLOW_START, 0 to 1,023.
    pub(super) slow_start: u16,
    /// SLOW_DOWN, 0 to 1,023.
    pub(super) slow_down: u16,
    /// STOP_STATUS, 0 to 3.
    pub(super) stop_status: u16,
    /// Poles of the motor, from `HALL_TYPE`.
    pub(super) poles: u16,
    /// ENC_PPR; 0 without an encoder.
    pub(super) enc_ppr: u16,
}

impl Settings {
    /// Settings of a new drive.
    #[cfg(test)]
    pub(super) const FACTORY: Self = Self {
        max_rpm: 3_000,
        limit_ma: 20_000,
        pv_gain: 20,
        p_gain: 6_000,
        i_gain: 6_000,
        slow_start: 0,
        slow_down: 0,
        stop_status: 0,
        poles: 4,
        enc_ppr: 0,
    };

    /// Counts of the Hall sensors in a turn: the edges of three sensors for each pair of poles.
    fn counts(&self) -> i64 {
        3 * i64::from(self.poles.max(1))
    }

    /// Counts of the encoder in a turn (MDROBOT-29).
    fn encoder_counts(&self) -> i64 {
        4 * i64::from(self.enc_ppr)
    }

    /// Counts of the speed sensor, in a turn.
    fn turn(&self) -> i64 {
        if self.enc_ppr > 0 { self.encoder_counts() } else { self.counts() }
    }
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
    feedback: Feedback,
    /// Requested duty. The current limit may reduce it.
    duty: i32,
    /// Current limit, in mA: 0 while the terminals are open.
    limit_out_ma: u32,
    swapped: bool,
    halls: Halls,
    encoder: Encoder,
    /// Edges of the Hall sensors.
    hall_edges: Edges,
    /// Edges of the encoder.
    encoder_edges: Edges,
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
        Self {
            settings,
            order: Order::Free,
            next: Instant::NEVER,
            setpoint: I40F24::ZERO,
            setpoint_since: Instant::ZERO,
            pi: Pi::NEW,
            feedback: Feedback::new(&MOTOR),
            duty: 0,
            limit_out_ma: 0,
            swapped: false,
            halls: Halls::NEW,
            encoder: Encoder::NEW,
            hall_edges: Edges::NONE,
            encoder_edges: Edges::NONE,
            zero: 0,
            target: 0,
            faults: FaultMonitor::NEW,
            alarms: 0,
        }
    }

    /// Handles power-on: puts the state of the terminals. Everything is reset, including the position; only
    /// the motor's feedback stays.
    pub(super) fn power_on(&mut self, at: Instant, settings: Settings, out: &mut dyn Context) {
        let feedback = self.feedback;
        *self = Self { feedback, ..Self::new(settings) };
        out.put(at, Output::Duty { axis: AXIS, duty: self.duty });
        out.put(at, Output::CurrentLimit { axis: AXIS, ma: self.limit_out_ma });
    }

    /// Applies new settings of the registers, all at once.
    pub(super) fn set(&mut self, at: Instant, settings: Settings, out: &mut dyn Context) {
        let before = core::mem::replace(&mut self.settings, settings);
        if settings == before {
            return;
        }
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
        self.next.min(self.halls.deadline())
    }

    /// Executes a control tick and the check of a Hall code if they are due. Returns true if one of them was.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        let is_due = self.deadline() <= at;
        self.halls.check_code(at);
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
            self.back_emf(at)
        };
        let duty = duty.clamp(-pi::FULL, pi::FULL);
        self.pi.begin(duty);
        self.hall_edges.begin(at, self.settings.counts(), &self.feedback);
        self.encoder_edges.begin(at, self.settings.encoder_counts(), &self.feedback);
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
            self.hall_edges.set_standstill();
            self.encoder_edges.set_standstill();
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
}
