//! Simulated motors, and a drive together with its motor.
//!
//! A stepper motor follows the plans of its drive ([`stepper`]). Encoders and switches on a shaft read any
//! kind of motor through [`Rotor`].
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
mod rotation;
mod rotor;
mod sensor_track;
pub mod stepper;
#[cfg(test)]
mod tests;

use self::constants::{Constants, Terminals};
pub use self::drive_with_motor::{DriveWithMotor, MotorDrive};
pub(crate) use self::edges::{Edges, SETTLE, scaled};
pub(crate) use self::feedback::{ControlModel, FULL_DUTY, Feedback, NEAR, TICK, ratio};
use self::interval::MotionInterval;
pub use self::rotation::Rotation;
pub use self::rotor::{Kinematics, Rotor};
use self::sensor_track::SensorTrack;
use crate::device::{
    Axis, AxisSpec, Boot, Context, Device, Fault, Input, Instant, Level, Output, Pin, PinSpec, PresetError,
    Role, Shaft, Spec,
};

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

    /// The pins of the motor's Hall sensors.
    fn hall_pins(&self) -> &'static [Pin] {
        HALL_PINS.get(..self.sensors().into()).unwrap_or(HALL_PINS)
    }

    /// Speed at the full supply voltage without load and friction, in rpm, within its limits.
    fn full_rpm(&self) -> u32 {
        self.no_load_rpm.clamp(Self::LEAST.no_load_rpm, Self::MOST.no_load_rpm)
    }
}

/// Hall sensor A. While the motor turns forward, A is ahead of B: by a quarter of a pulse with two sensors,
/// by a third with three.
pub const HALL_A: Pin = Pin(0);
/// Hall sensor B. With three sensors it is a third of a pulse ahead of C.
pub const HALL_B: Pin = Pin(1);
/// Channel A of the encoder.
pub const ENCODER_A: Pin = Pin(2);
/// Channel B of the encoder, a quarter of a cycle behind A while the motor turns forward.
pub const ENCODER_B: Pin = Pin(3);
/// The encoder's index: high for a quarter of a cycle in each turn, while A and B are low.
pub const ENCODER_I: Pin = Pin(4);
/// Hall sensor C, of a motor with three sensors.
pub const HALL_C: Pin = Pin(5);

/// Pins of the Hall sensors, A first. A motor with two sensors uses A and B.
pub const HALL_PINS: &[Pin] = &[HALL_A, HALL_B, HALL_C];
const ENCODER_PINS: &[Pin] = &[ENCODER_A, ENCODER_B, ENCODER_I];

/// Fault of a blocked shaft.
pub const STALL: Fault = Fault(0);

const fn sensor(name: &'static str) -> PinSpec {
    PinSpec::new(name, Role::Output, Level::High)
}

static MOTOR: Spec = Spec {
    kind: "motor",
    product: "Motor with Hall sensors",
    pins: &[sensor("HALL_A"), sensor("HALL_B"), sensor("A"), sensor("B"), sensor("I"), sensor("HALL_C")],
    axes: &[AxisSpec { name: "motor", step_dir: None }],
    faults: &["stall"],
    ..Spec::EMPTY
};

/// A brush motor, or a brushless one. Its inputs are [`Input::CurrentLimit`] and [`Input::Duty`]. The axis in
/// these inputs is ignored.
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

    /// Rotation of the shaft at `at`, which is not after the next deadline.
    #[must_use]
    pub fn rotation_at(&self, at: Instant) -> Rotation {
        self.interval.at(at).rotation()
    }

    /// Changes the parameters. The count of the Hall sensors and the speed of the shaft do not change.
    pub fn set_parameters(&mut self, at: Instant, parameters: Parameters, out: &mut dyn Context) {
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
            self.halls.put_levels(at, None, parameters.hall_pins(), out);
        }
        if parameters.encoder_cycles != self.parameters.encoder_cycles {
            self.encoder = SensorTrack::encoder(parameters.encoder_cycles).moved_to(now.angle);
        }
        (self.parameters, self.constants) = (parameters, Constants::of(&parameters));
        self.interval = now;
        out.put(at, Output::Motor { axis: AXIS, parameters: &self.parameters });
        self.update(at, out);
    }

    /// Starts the next interval at `at`, with the state of the present one.
    fn update(&mut self, at: Instant, out: &mut dyn Context) {
        let ma = self.next_interval(at, self.terminals());
        if ma != self.ma {
            self.ma = ma;
            out.put(at, Output::MotorCurrent { axis: AXIS, ma });
        }
        let rotation = self.interval.rotation();
        if !self.is_reported(at, rotation) {
            self.reported = Some((at, rotation));
            out.put(at, Output::Rotation { axis: AXIS, rotation });
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

impl Rotor for Motor {
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
}

impl Device for Motor {
    fn spec(&self) -> &'static Spec {
        &MOTOR
    }

    /// Switches the power of the sensors on. The motion of the shaft continues.
    fn power_on(&mut self, at: Instant, _boot: Boot, out: &mut dyn Context) {
        self.coast(at);
        self.blocked = false;
        self.halls.put_levels(at, None, self.parameters.hall_pins(), out);
        self.encoder.put_levels(at, None, ENCODER_PINS, out);
        self.reported = None;
        out.put(at, Output::Motor { axis: AXIS, parameters: &self.parameters });
        out.put(at, Output::MotorCurrent { axis: AXIS, ma: self.ma });
        self.update(at, out);
    }

    fn input(&mut self, at: Instant, input: Input<'_>, out: &mut dyn Context) {
        let setting = match input {
            Input::CurrentLimit { ma, .. } => (ma, self.duty, self.blocked),
            Input::Duty { duty, .. } => (self.limit_ma, duty, self.blocked),
            Input::Fault { fault: STALL, on } => (self.limit_ma, self.duty, on),
            _ => return,
        };
        if setting != (self.limit_ma, self.duty, self.blocked) {
            (self.limit_ma, self.duty, self.blocked) = setting;
            self.update(at, out);
        }
    }

    fn deadline(&self) -> Instant {
        self.due
    }

    fn timeout(&mut self, at: Instant, out: &mut dyn Context) {
        if at >= self.edge {
            let angle = self.interval.at(at).angle;
            let hall_pins = self.parameters.hall_pins();
            for (track, pins) in [(&mut self.halls, hall_pins), (&mut self.encoder, ENCODER_PINS)] {
                let before = *track;
                track.step_towards(angle);
                track.put_levels(at, Some(before), pins, out);
            }
            self.find_edge(at);
        }
        if at >= self.interval.end() {
            self.update(at, out);
        }
    }

    fn peek(&self, _at: Instant, _row: usize) -> i64 {
        0
    }

    fn poke(
        &mut self,
        _at: Instant,
        _row: usize,
        _value: i64,
        _out: &mut dyn Context,
    ) -> Result<(), PresetError> {
        Err(PresetError::NoSuchRegister)
    }

    fn shaft(&self, at: Instant, _axis: Axis) -> Option<Shaft> {
        if at > self.interval.end() {
            let mut later = self.clone();
            later.coast(at);
            return later.shaft(at, AXIS);
        }
        let now = self.interval.at(at);
        Some(Shaft {
            position: self.halls.count(now.angle) as i32,
            speed: self.halls.counts_per_second(now.speed),
            duty: if self.limit_ma > 0 { self.duty } else { 0 },
            ma: self.ma,
        })
    }
}
