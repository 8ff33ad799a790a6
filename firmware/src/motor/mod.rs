//! Simulated motors, and a drive together with its motor.
//!
//! A stepper motor follows the plans of its drive ([`stepper`]). Encoders and switches on a shaft read any
//! kind of motor through [`Plant`].
//!
//! The motor in this file is a brush motor, or a brushless one, which its drive commutates as brushes would.
//! Its winding has a resistance and no inductance. Its speed makes a voltage against the supply, its current
//! makes a torque. Friction of constant size holds or brakes the shaft, and a load pulls at the shaft. If the
//! load turns the shaft faster than the supply would, the motor charges the supply. Not modelled: inductance,
//! iron, cogging, the supply's own resistance, heating of the winding.
//!
//! All numbers are integers. An angle is in 2⁻³² turns, a speed in 2⁻⁵⁶ turns per tick, an acceleration in
//! 2⁻⁶⁴ turns per tick². The motion is a sequence of intervals of constant acceleration (`interval`). Inside
//! an interval every edge of a sensor is at the tick at which the shaft crosses it. `constants` computes the
//! acceleration of an interval.

mod constants;
mod drive_with_motor;
mod edges;
mod feedback;
mod interval;
mod plant;
mod rotation;
mod sensor_track;
pub mod stepper;
#[cfg(test)]
mod tests;

use core::mem::replace;

use self::constants::{Constants, Terminals};
pub use self::drive_with_motor::{DriveWithMotor, MotorDrive};
pub(crate) use self::edges::{Edges, SETTLE, scaled};
pub(crate) use self::feedback::{ControlModel, FULL_DUTY, Feedback, NEAR, TICK, ramped, ratio};
use self::interval::MotionInterval;
pub use self::plant::{Command, Kinematics, Plant, Report, Reports, Sensor};
pub use self::rotation::Rotation;
use self::sensor_track::SensorTrack;
use crate::device::{Axis, Instant, Shaft};

/// The only axis of a motor, and of the drive with this motor.
pub(crate) const AXIS: Axis = Axis(0);

/// Parameters of a brush motor, or of a brushless one, and its load. A value beyond a limit has the effect of
/// the limit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Parameters {
    /// Supply voltage, in mV, 1 to 100,000.
    pub supply_mv: u32,
    /// Speed at the full supply voltage without load and friction, in rpm, 60 to 200,000. The torque constant
    /// follows from it.
    pub no_load_rpm: u32,
    /// Resistance of the winding, in mΩ, 10 to 1,000,000.
    pub resistance_mohm: u32,
    /// Inertia of rotor and load, in g·cm², 1 to 10,000,000.
    pub inertia_gcm2: u32,
    /// Friction torque in µN·m, up to 100,000,000. It acts against any motion, and holds the shaft at rest.
    pub friction_unm: u32,
    /// Load torque in µN·m, up to 100,000,000, positive if against forward motion. It also acts at rest.
    pub load_unm: i32,
    /// Pulses of a Hall sensor per turn, 1 to 1,000. For a brushless motor this is its number of pole pairs.
    pub hall_pulses: u16,
    /// Number of Hall sensors: 2, a quarter of a pulse apart, or 3, a third of a pulse apart (brushless).
    pub hall_sensors: u8,
    /// Cycles of the encoder per turn; 0 without an encoder.
    pub encoder_cycles: u16,
}

impl Parameters {
    /// A motor of some 200 W at 24 V, without load. It is not a real product. We chose its values to suit a
    /// drive for 20 A. At 3,000 rpm at no load they give 76 mN·m per ampere, 48 A at standstill, which the
    /// drive must limit, 0.13 A of friction, and 3.4 ms to reach the speed. That is several ticks of a
    /// control loop with a period of 1 ms.
    pub const NOMINAL: Self = Self {
        supply_mv: 24_000,
        no_load_rpm: 3_000,
        resistance_mohm: 500,
        inertia_gcm2: 400,
        friction_unm: 10_000,
        load_unm: 0,
        hall_pulses: 4,
        hall_sensors: 2,
        encoder_cycles: 0,
    };

    /// The lowest value of each parameter.
    pub const LEAST: Self = Self {
        supply_mv: 1,
        no_load_rpm: 60,
        resistance_mohm: 10,
        inertia_gcm2: 1,
        friction_unm: 0,
        load_unm: -100_000_000,
        hall_pulses: 1,
        hall_sensors: 2,
        encoder_cycles: 0,
    };

    /// The highest value of each parameter.
    pub const MOST: Self = Self {
        supply_mv: 100_000,
        no_load_rpm: 200_000,
        resistance_mohm: 1_000_000,
        inertia_gcm2: 10_000_000,
        friction_unm: 100_000_000,
        load_unm: 100_000_000,
        hall_pulses: 1_000,
        hall_sensors: 3,
        encoder_cycles: u16::MAX,
    };

    fn pulses(&self) -> u16 {
        self.hall_pulses.clamp(Self::LEAST.hall_pulses, Self::MOST.hall_pulses)
    }

    fn sensors(&self) -> u8 {
        self.hall_sensors.clamp(Self::LEAST.hall_sensors, Self::MOST.hall_sensors)
    }

    /// Returns true for a brushless motor, that is, one with three Hall sensors.
    #[must_use]
    pub fn is_brushless(&self) -> bool {
        self.sensors() == 3
    }

    /// State of the shaft of a motor with these parameters that turns as `rotation` says.
    #[must_use]
    pub fn shaft(&self, rotation: Rotation, duty: i32, ma: i32) -> Shaft {
        let halls = SensorTrack::halls(self);
        let speed = halls.counts_per_second(rotation.speed);
        Shaft { position: halls.count(rotation.angle) as i32, speed, duty, ma }
    }

    /// Speed at the full supply voltage without load and friction, in rpm, within its limits.
    fn full_rpm(&self) -> u32 {
        self.no_load_rpm.clamp(Self::LEAST.no_load_rpm, Self::MOST.no_load_rpm)
    }
}

/// The largest number of Hall sensors of a motor.
pub const HALLS: usize = 3;

/// A brush motor, or a brushless one. It ignores commands other than [`Command::CurrentLimit`] and
/// [`Command::Duty`].
#[derive(Clone, Debug)]
pub struct Motor {
    parameters: Parameters,
    constants: Constants,
    /// Current limit in mA; 0 while the terminals are open.
    limit_ma: u32,
    /// Duty in 1/65536 of the supply voltage.
    duty: i32,
    blocked: bool,
    interval: MotionInterval,
    halls: SensorTrack,
    encoder: SensorTrack,
    /// Time of the next edge of a sensor.
    edge: Instant,
    /// Time of the next edge or of the end of the interval, whichever is earlier.
    due: Instant,
    ma: i32,
    /// The last report of the rotation, and its time.
    reported: Option<(Instant, Rotation)>,
}

impl Motor {
    /// A motor at standstill with open terminals. Its shaft is in the middle between two edges of the Hall
    /// sensors.
    #[must_use]
    pub fn new(parameters: Parameters) -> Self {
        let halls = SensorTrack::halls(&parameters);
        let angle = halls.middle();
        let encoder = SensorTrack::encoder(parameters.encoder_cycles).moved_to(angle);
        Self {
            parameters,
            constants: Constants::of(&parameters),
            limit_ma: 0,
            duty: 0,
            blocked: false,
            interval: MotionInterval::at_rest(Instant::ZERO, angle),
            halls,
            encoder,
            edge: Instant::NEVER,
            due: Instant::NEVER,
            ma: 0,
            reported: None,
        }
    }

    /// Parameters of the motor.
    #[must_use]
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Changes the parameters. The count of the Hall sensors and the speed of the shaft do not change.
    pub fn set_parameters(&mut self, at: Instant, parameters: Parameters, out: &mut dyn Reports) {
        if parameters == self.parameters {
            return;
        }
        let mut now = self.interval.at(at);
        let (halls, before) = (|of: &Parameters| (of.hall_pulses, of.hall_sensors), &self.parameters);
        if halls(&parameters) != halls(before) {
            self.halls = SensorTrack::halls(&parameters).at_count_of(self.halls);
            now.angle = self.halls.middle();
        }
        if parameters.hall_sensors != before.hall_sensors {
            self.halls.report(at, None, out);
        }
        if parameters.encoder_cycles != self.parameters.encoder_cycles {
            self.encoder = SensorTrack::encoder(parameters.encoder_cycles).moved_to(now.angle);
        }
        (self.parameters, self.constants) = (parameters, Constants::of(&parameters));
        self.interval = now;
        out.report(at, Report::Motor(&self.parameters));
        self.update(at, out);
    }

    /// Starts the next interval at `at`, with the state of the present one.
    fn update(&mut self, at: Instant, out: &mut dyn Reports) {
        let ma = self.next_interval(at, self.terminals());
        if ma != self.ma {
            self.ma = ma;
            out.report(at, Report::MotorCurrent(ma));
        }
        let rotation = self.interval.rotation();
        if !self.is_reported(at, rotation) {
            self.reported = Some((at, rotation));
            out.report(at, Report::Rotation(rotation));
        }
    }

    /// Returns true if the last report is still right, up to the end of the present interval.
    fn is_reported(&self, at: Instant, rotation: Rotation) -> bool {
        let Some((since, reported)) = self.reported else { return false };
        let end = self.interval.end();
        if rotation.speed == 0 && rotation.acceleration == 0 {
            return reported.speed == 0 && reported.acceleration == 0 && reported.angle == rotation.angle;
        }
        end.since(since) <= MotionInterval::LONGEST
            && reported.after(at.since(since)).is_like(rotation)
            && reported.after(end.since(since)).is_like(self.interval.at(end).rotation())
    }

    fn terminals(&self) -> Terminals {
        match self.limit_ma {
            0 => Terminals::Open,
            limit_ma => Terminals::Driven { duty: self.duty, limit_ma },
        }
    }

    /// Starts the next interval as [`Self::update`] does, with the terminals connected as `terminals`.
    /// Returns the current.
    fn next_interval(&mut self, at: Instant, terminals: Terminals) -> i32 {
        let now = self.interval.at(at);
        let now = if self.blocked { MotionInterval::at_rest(at, now.angle) } else { now };
        let (interval, ma) = self.constants.next(now, terminals, self.blocked);
        self.interval = interval;
        self.find_edge(at);
        ma
    }

    /// Computes the time of the next edge in the present interval.
    fn find_edge(&mut self, at: Instant) {
        self.edge = self.halls.next_edge(&self.interval, at).min(self.encoder.next_edge(&self.interval, at));
        self.due = self.edge.min(self.interval.end());
    }

    /// Advances a motor without power from its last state to `at`. No edges are reported, because the sensors
    /// have no power.
    fn coast(&mut self, at: Instant) {
        (self.limit_ma, self.duty, self.ma) = (0, 0, 0);
        self.next_interval(self.interval.since(), Terminals::Dead);
        let stands = self.interval.stop_time();
        if stands < at {
            self.interval = self.interval.extrapolated_to(stands);
            self.next_interval(stands, Terminals::Dead);
        }
        // From here on friction holds the shaft or the load turns it. Neither changes any more.
        self.interval = self.interval.extrapolated_to(at);
        self.next_interval(at, Terminals::Dead);
        let angle = self.interval.angle;
        self.halls = self.halls.moved_to(angle);
        self.encoder = self.encoder.moved_to(angle);
    }
}

impl Plant for Motor {
    fn power_on(&mut self, at: Instant, out: &mut dyn Reports) {
        self.coast(at);
        self.blocked = false;
        self.halls.report(at, None, out);
        self.encoder.report(at, None, out);
        self.reported = None;
        out.report(at, Report::Motor(&self.parameters));
        out.report(at, Report::MotorCurrent(self.ma));
        self.update(at, out);
    }

    fn command(&mut self, at: Instant, command: Command<'_>, out: &mut dyn Reports) {
        let changed = match command {
            Command::CurrentLimit(ma) => replace(&mut self.limit_ma, ma) != ma,
            Command::Duty(duty) => replace(&mut self.duty, duty) != duty,
            _ => false,
        };
        if changed {
            self.update(at, out);
        }
    }

    fn set_blocked(&mut self, at: Instant, blocked: bool, out: &mut dyn Reports) {
        if replace(&mut self.blocked, blocked) != blocked {
            self.update(at, out);
        }
    }

    fn deadline(&self) -> Instant {
        self.due
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Reports) {
        if at >= self.edge {
            let angle = self.interval.at(at).angle;
            for track in [&mut self.halls, &mut self.encoder] {
                let before = *track;
                track.step_towards(angle);
                track.report(at, Some(before), out);
            }
            self.find_edge(at);
        }
        if at >= self.interval.end() {
            self.update(at, out);
        }
    }

    fn repeat_reports(&self, at: Instant, out: &mut dyn Reports) {
        out.report(at, Report::Motor(&self.parameters));
        out.report(at, Report::Rotation(self.interval.at(at).rotation()));
        out.report(at, Report::MotorCurrent(self.ma));
    }

    fn until(&self) -> Instant {
        self.interval.end()
    }

    fn angle_at(&self, at: Instant) -> i64 {
        self.interval.angle_at(at)
    }

    fn kinematics(&self) -> Kinematics {
        self.interval.kinematics()
    }

    fn stalled(&self) -> bool {
        self.blocked
    }

    fn draws_ma(&self) -> i32 {
        self.ma
    }

    fn shaft(&self, at: Instant) -> Option<Shaft> {
        if at > self.interval.end() {
            let mut later = self.clone();
            later.coast(at);
            return later.shaft(at);
        }
        let duty = if self.limit_ma > 0 { self.duty } else { 0 };
        Some(self.parameters.shaft(self.interval.at(at).rotation(), duty, self.ma))
    }
}
