//! Motors of their own, and what is on their shafts: encoders and switches.

use standin_firmware::device::{Axis, Pin};
use standin_firmware::motor::{self, stepper};

use super::{Bench, Seat};

/// A motor on the bench.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Motor(u32);

/// What a motor is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Fitting {
    /// It follows the plans and steps of its drive.
    Stepper(stepper::Parameters),
    /// It is turned by the duty of a drive that was seated [`apart`](super::Setup::apart).
    Brush(motor::Parameters),
}

/// Where a switch is closed: above one position of the shaft and below another, in turns from where it began.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Closed {
    /// Above that.
    pub above_rev: Option<f64>,
    /// And below that.
    pub below_rev: Option<f64>,
}

/// What a shaft does.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Turn {
    /// Turns from where it began.
    pub revolutions: f64,
    /// Turns per minute, signed.
    pub rpm: f64,
    /// Whether it cannot follow its drive.
    pub stalled: bool,
    /// What it draws, in mA.
    pub ma: i32,
}

/// Motors.
impl Bench {
    /// Has an axis turn a motor from now on. A drive has one motor an axis.
    ///
    /// # Errors
    /// One sentence: why not.
    pub fn fit(&mut self, _name: &str, _drive: Seat, _axis: Axis, _is: Fitting) -> Result<Motor, String> {
        Err("there are no motors yet".to_owned())
    }

    /// The motor that a drive has parted from when it was seated [`apart`](super::Setup::apart).
    #[must_use]
    pub fn parted(&self, _drive: Seat) -> Option<motor::Parameters> {
        None
    }

    /// Puts an encoder of `cycles_per_rev` cycles a turn on a motor's shaft, and wires its channels A and B and its
    /// index, which is high in the first quarter of a cycle of every turn.
    pub fn encode(&mut self, _motor: Motor, _cycles_per_rev: u32, _to: [Option<(Seat, Pin)>; 3]) {}

    /// Puts a switch beside a motor's shaft that pulls a pin to ground while it is closed.
    pub fn switch(&mut self, _motor: Motor, _closed: Closed, _to: (Seat, Pin)) {}

    /// All motors, in the order in which they were fitted.
    pub fn motors(&self) -> impl ExactSizeIterator<Item = Motor> + use<> {
        (0..0).map(Motor)
    }

    /// The name of a motor.
    #[must_use]
    pub fn motor_name(&self, _motor: Motor) -> &str {
        ""
    }

    /// What turns a motor.
    #[must_use]
    pub fn turned_by(&self, _motor: Motor) -> (Seat, Axis) {
        (Seat(0), Axis(0))
    }

    /// What a motor's shaft does now.
    #[must_use]
    pub fn turn(&self, _motor: Motor) -> Turn {
        Turn::default()
    }
}
