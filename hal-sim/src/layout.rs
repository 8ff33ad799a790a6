//! What is on a bench, as plain data: what a bench file says, or the options of a single drive.
//!
//! Everything in a [`Layout`] is checked: names are there once, pins and registers exist, values are legal.

use std::path::PathBuf;

use standin_firmware::device::{Axis, Fault, Pin, Port};
use standin_firmware::motor;

use crate::bench::Closed;
use crate::bus::LineMode;
use crate::faults::LineFaults;
use crate::listen::Uri;
use crate::pace::Pace;
use crate::preset::Preset;

/// What is on a bench.
#[derive(Clone, Debug, Default)]
pub struct Layout {
    /// Seed of every random choice.
    pub seed: Option<u64>,
    /// How time runs.
    pub time: Option<Pace>,
    /// How long characters take.
    pub line: Option<LineMode>,
    /// Its drives.
    pub drives: Vec<Drive>,
    /// Lines that drives share. A serial port that is on none has one of its own.
    pub buses: Vec<Bus>,
    /// Motors.
    pub motors: Vec<Motor>,
    /// Encoders on their shafts.
    pub encoders: Vec<Encoder>,
    /// Switches beside them.
    pub switches: Vec<Switch>,
    /// Wires from pin to pin.
    pub wires: Vec<Wire>,
    /// What disturbs lines from the beginning.
    pub faults: Vec<Disturbed>,
}

/// A pin of a drive: place in [`Layout::drives`].
pub type At = (usize, Pin);

/// A drive.
#[derive(Clone, Debug)]
pub struct Drive {
    /// Its name.
    pub name: String,
    /// What it is.
    pub kind: &'static str,
    /// Where its own lines are reached.
    pub listen: Vec<(Port, Uri)>,
    /// Where its memory is kept.
    pub nv: Option<PathBuf>,
    /// Registers that are preset, its address among them.
    pub presets: Vec<Preset>,
    /// A user program of an RS drive, as text.
    pub program: Option<PathBuf>,
    /// No start-up delay.
    pub fast_boot: bool,
    /// Causes of faults that are there from the beginning.
    pub faults: Vec<Fault>,
}

/// A line that drives share.
#[derive(Clone, Debug)]
pub struct Bus {
    /// Its name.
    pub name: String,
    /// Where it is reached.
    pub listen: Vec<Uri>,
    /// Who is on it: places in [`Layout::drives`], and ports.
    pub drives: Vec<(usize, Port)>,
    /// Whether characters that overlap spoil each other.
    pub collisions: bool,
}

/// A motor.
#[derive(Clone, Debug)]
pub struct Motor {
    /// Its name.
    pub name: String,
    /// What turns it: place in [`Layout::drives`].
    pub drive: usize,
    /// By which axis.
    pub axis: Axis,
    /// What it is.
    pub is: MotorKind,
}

/// What a motor is.
#[derive(Clone, Debug)]
pub enum MotorKind {
    /// It follows the steps of its drive.
    Stepper(motor::stepper::Parameters),
    /// What is not said is as the drive's registers describe it.
    Brush(BrushKeys),
}

/// What is said of a brush motor; see [`motor::Parameters`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
#[expect(missing_docs, reason = "the fields are those of `motor::Parameters`")]
pub struct BrushKeys {
    pub supply_mv: Option<u32>,
    pub no_load_rpm: Option<u32>,
    pub resistance_mohm: Option<u32>,
    pub inertia_gcm2: Option<u32>,
    pub friction_unm: Option<u32>,
    pub load_unm: Option<i32>,
    pub hall_pulses: Option<u16>,
}

/// An encoder on the shaft of a motor.
#[derive(Clone, Debug)]
pub struct Encoder {
    /// Place in [`Layout::motors`].
    pub motor: usize,
    /// Cycles of A in a turn.
    pub cycles_per_rev: u32,
    /// Where A goes.
    pub a: Option<At>,
    /// Where B goes.
    pub b: Option<At>,
    /// Where the index goes.
    pub index: Option<At>,
}

/// A switch that the shaft of a motor closes.
#[derive(Clone, Debug)]
pub struct Switch {
    /// Place in [`Layout::motors`].
    pub motor: usize,
    /// Where it is closed.
    pub closed: Closed,
    /// The pin that it pulls to ground.
    pub to: At,
}

/// A wire.
#[derive(Clone, Debug)]
pub struct Wire {
    /// An output.
    pub from: At,
    /// An input.
    pub to: At,
}

/// What disturbs a line.
#[derive(Clone, Debug)]
pub struct Disturbed {
    /// Its name, as [`Bench::find_bus`](crate::bench::Bench::find_bus) finds it.
    pub bus: String,
    /// How.
    pub faults: LineFaults,
}
