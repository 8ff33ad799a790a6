//! The contract between a drive and what it turns.

use super::{Parameters, Rotation};
use crate::device::{Instant, Plan, Shaft};

/// A command of a drive to its plant.
#[derive(Clone, Copy, PartialEq, Debug)]
#[non_exhaustive]
pub enum Command<'a> {
    /// [`Output::CurrentLimit`](crate::device::Output::CurrentLimit): peak current in mA; 0 opens the terminals.
    CurrentLimit(u32),
    /// [`Output::Duty`](crate::device::Output::Duty): duty in 1/65536 of the supply voltage, signed; 0 shorts the terminals.
    Duty(i32),
    /// [`Output::Plan`](crate::device::Output::Plan): plan of a stepper motor, in steps of the drive.
    Plan(&'a Plan),
    /// [`Output::Step`](crate::device::Output::Step): number of steps without a ramp, signed.
    Step(i32),
    /// Number of steps of the drive per full step of the motor
    /// ([`Device::microsteps`](crate::device::Device::microsteps)).
    Microsteps(u16),
}

/// A sensor of a motor that its drive reads.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Sensor {
    /// Hall sensor, counted from 0. While the motor turns forward, sensor 0 is ahead of 1: by a quarter of a pulse with
    /// two sensors, by a third with three; and 1 ahead of 2.
    Hall(u8),
    /// Channel A of the encoder.
    EncoderA,
    /// Channel B of the encoder, a quarter of a cycle behind A while the motor turns forward.
    EncoderB,
    /// Index of the encoder: high for a quarter of a cycle in each turn, while A and B are low.
    Index,
}

/// A report of a plant to its drive. The drive receives it as an input: a level as
/// [`Input::Edge`](crate::device::Input::Edge), the others as the input of the same name.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Report<'a> {
    /// Level of a sensor, true if high. All levels are reported at power-on, later those that change.
    Level(Sensor, bool),
    /// Current in mA, with the sign of the duty.
    MotorCurrent(i32),
    /// Parameters: at power-on and when they change.
    Motor(&'a Parameters),
    /// Rotation of the shaft from the time of the report on.
    Rotation(Rotation),
}

/// Receiver of the reports of a plant.
pub trait Reports {
    /// Receives a report. `at` is the time of the call of the plant.
    fn report(&mut self, at: Instant, report: Report<'_>);
}

/// A receiver for a plant whose reports nobody reads.
impl Reports for () {
    fn report(&mut self, _at: Instant, _report: Report<'_>) {}
}

/// The mechanical load of an axis: a motor with its shaft. Drives command it; encoders, switches and displays read its
/// shaft.
///
/// A plant obeys the same rule of time as a [`Device`](crate::device::Device): it is called with ascending times, and at
/// each of its deadlines. Angles are in 2⁻³² turns and wrap. Times passed to the functions that read the shaft are not
/// before the last call, and are before [`until`](Self::until). In this time the shaft does not reverse.
pub trait Plant: Send {
    /// Switches the power of drive and sensors on. The motion of the shaft continues.
    fn power_on(&mut self, at: Instant, out: &mut dyn Reports);

    /// Handles a command of the drive.
    fn command(&mut self, at: Instant, command: Command<'_>, out: &mut dyn Reports);

    /// Blocks the shaft, or releases it.
    fn set_blocked(&mut self, at: Instant, blocked: bool, out: &mut dyn Reports);

    /// Time of the next deadline; [`Instant::NEVER`] if only a command can change anything.
    fn deadline(&self) -> Instant;

    /// Handles the deadline. If `at` is not the deadline, nothing happens.
    fn timeout(&mut self, at: Instant, out: &mut dyn Reports);

    /// Reports parameters, rotation and current again, for a drive that is switched on.
    fn repeat_reports(&self, _at: Instant, _out: &mut dyn Reports) {}

    /// Time until which the present motion lasts without a command. This is one of the deadlines.
    fn until(&self) -> Instant;

    /// Angle of the shaft.
    fn angle_at(&self, at: Instant) -> i64;

    /// Returns true if the shaft is at `angle` or forward of it.
    fn is_at_least(&self, at: Instant, angle: i64) -> bool {
        self.angle_at(at).wrapping_sub(angle) >= 0
    }

    /// The present motion.
    fn kinematics(&self) -> Kinematics;

    /// Returns true if the shaft cannot follow the commands.
    fn stalled(&self) -> bool;

    /// Current in mA, with the sign of a duty.
    fn draws_ma(&self) -> i32;

    /// State of a shaft whose Hall sensors the drive reads; `None` of a stepper motor.
    fn shaft(&self, _at: Instant) -> Option<Shaft> {
        None
    }
}

/// Motion of a shaft from an instant on, for computations where an error of a tick does not matter.
///
/// After *d* ticks the shaft has turned by `d·(2·half_speed + half_acceleration·d)` parts; `turn` parts are
/// one turn.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Kinematics {
    /// Start of this motion.
    pub since: Instant,
    /// Angle at the start, in 2⁻³² turns.
    pub angle: i64,
    /// Half of the speed, in parts of a turn per tick, signed.
    pub half_speed: i64,
    /// Half of the acceleration, in parts of a turn per tick².
    pub half_acceleration: i64,
    /// Number of parts of a turn.
    pub turn: i128,
}
