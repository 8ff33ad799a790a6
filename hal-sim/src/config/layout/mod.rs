//! The configuration of a bench as plain data: from a bench file, or from the options of a single drive.
//!
//! What makes a [`Layout`] checks it: names are there once, places are those of something, pins and registers exist,
//! values are legal. One function makes the [bench](Layout::build) of it, and relies on that (BENCH-1).

mod build;

use std::path::{Path, PathBuf};

use drivetwin_firmware::device::{Axis, Fault, Pin, Port, Spec};
use drivetwin_firmware::motor;

pub use self::build::Built;
use crate::bench::{Closed, Settings};
use crate::config::listen::{Listen, Uri};
use crate::config::preset::Preset;
use crate::config::time_mode::TimeMode;
use crate::line::LineMode;
use crate::line::faults::LineFaults;
use crate::suggest;

/// Configuration of a bench.
#[derive(Clone, Debug, Default)]
pub struct Layout {
    /// Seed of every random choice.
    pub seed: Option<u64>,
    /// Time mode.
    pub time: Option<TimeMode>,
    /// Time that characters take.
    pub line: Option<LineMode>,
    /// Drives.
    pub drives: Vec<DriveLayout>,
    /// Lines that drives share. A serial port that is on none has one of its own.
    pub buses: Vec<BusLayout>,
    /// Motors.
    pub motors: Vec<MotorLayout>,
    /// Encoders on their shafts.
    pub encoders: Vec<EncoderLayout>,
    /// Switches beside them.
    pub switches: Vec<SwitchLayout>,
    /// Wires from pin to pin.
    pub wires: Vec<WireLayout>,
    /// Faults of lines from the beginning.
    pub faults: Vec<Disturbed>,
}

impl Layout {
    /// The settings of its bench: what is not said is as [`Settings::default`] has it.
    #[must_use]
    pub fn settings(&self) -> Settings {
        let default = Settings::default();
        Settings {
            seed: self.seed.unwrap_or(default.seed),
            line: self.line.unwrap_or(default.line),
            patience: self.time.map_or(default.patience, TimeMode::patience),
            ..default
        }
    }

    /// Takes its paths, which a bench file has relative to its folder, as relative to `folder` (BENCH-2).
    pub fn relative_to(&mut self, folder: &Path) {
        for drive in &mut self.drives {
            for path in [&mut drive.nv, &mut drive.program].into_iter().flatten() {
                *path = folder.join(&path);
            }
        }
        let own = self.drives.iter_mut().flat_map(|drive| &mut drive.listen).map(|(_, uri)| uri);
        for uri in own.chain(self.buses.iter_mut().flat_map(|bus| &mut bus.listen)) {
            if let Uri::Pty(Some(path)) | Uri::Serial(path) = uri {
                *path = folder.join(&path);
            }
        }
    }
}

/// A pin of a drive: place in [`Layout::drives`].
pub type At = (usize, Pin);

/// A drive.
#[derive(Clone, Debug)]
pub struct DriveLayout {
    /// Name of the drive.
    pub name: String,
    /// Kind of the drive.
    pub kind: &'static str,
    /// Listening places of its own ports.
    pub listen: Vec<(Port, Uri)>,
    /// File of its non-volatile memory.
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
pub struct BusLayout {
    /// Name of the line.
    pub name: String,
    /// Listening places of the line.
    pub listen: Vec<Uri>,
    /// Drives on it: places in [`Layout::drives`], and ports.
    pub drives: Vec<(usize, Port)>,
    /// True if characters that overlap corrupt each other.
    pub collisions: bool,
}

/// A motor.
#[derive(Clone, Debug)]
pub struct MotorLayout {
    /// Name of the motor.
    pub name: String,
    /// Drive that turns it: place in [`Layout::drives`].
    pub drive: usize,
    /// By which axis.
    pub axis: Axis,
    /// Kind of motor.
    pub is: MotorKind,
}

/// Kind of a motor.
#[derive(Clone, Debug)]
pub enum MotorKind {
    /// A stepper motor, which follows the steps of its drive.
    Stepper(motor::stepper::StepperParameters),
    /// A motor with brushes, or a brushless one. A key that is not given is as the drive's registers describe the motor
    /// when the drive has been powered on for the first time, with its memory and presets. From then on it is a motor
    /// of its own and follows no register.
    Brush(BrushKeys),
}

/// Keys of a brush motor, or of a brushless one; see [`motor::Parameters`].
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
pub struct EncoderLayout {
    /// Place in [`Layout::motors`].
    pub motor: usize,
    /// Cycles of A in a turn.
    pub cycles_per_rev: u32,
    /// Pin of A.
    pub a: Option<At>,
    /// Pin of B.
    pub b: Option<At>,
    /// Pin of the index.
    pub index: Option<At>,
}

/// A switch that the shaft of a motor closes.
#[derive(Clone, Debug)]
pub struct SwitchLayout {
    /// Place in [`Layout::motors`].
    pub motor: usize,
    /// Range in which it is closed.
    pub closed: Closed,
    /// The pin that it pulls to ground.
    pub to: At,
}

/// A wire.
#[derive(Clone, Debug)]
pub struct WireLayout {
    /// An output.
    pub from: At,
    /// An input.
    pub to: At,
}

/// Faults of a line.
#[derive(Clone, Debug)]
pub struct Disturbed {
    /// Name of the line, as [`Bench::find_bus`](crate::bench::Bench::find_bus) finds it.
    pub bus: String,
    /// Faults.
    pub faults: LineFaults,
}

/// Which port of a drive is meant, and that it can be reached so.
///
/// # Errors
/// One sentence: there is no such port, or it is reached otherwise.
pub fn reached(spec: &Spec, listen: &Listen) -> Result<(Port, Uri), String> {
    let Listen { port: name, uri } = listen;
    let mut ports = (0..).map(Port).zip(spec.ports);
    let found = ports.find(|(_, port)| name.as_deref().is_none_or(|name| port.name == name));
    let (port, of) = found.ok_or_else(|| {
        let name = name.as_deref().unwrap_or_default();
        suggest::unknown(&format!("port of {}", spec.kind), name, spec.ports.iter().map(|port| port.name))
    })?;
    match (of.line, uri) {
        (None, Uri::Pty(_)) => Err(format!("{} of {} is a TCP port and has no pty", of.name, spec.kind)),
        (None, Uri::Serial(_) | Uri::Stdio) => {
            Err(format!("{} of {} is a TCP port and is reached by tcp: alone", of.name, spec.kind))
        }
        _ => Ok((port, uri.clone())),
    }
}

/// A sentence about a TCP port where a line is wanted.
#[must_use]
pub fn no_line(name: &str) -> String {
    format!("{name} is a TCP port and no line")
}

/// Returns whether two paths in one folder are the same, as far as their text shows.
pub(crate) fn same_path(a: &Path, b: &Path) -> bool {
    // Joined to any folder, `./a` is `a`.
    Path::new("/").join(a) == Path::new("/").join(b)
}

/// Returns whether two listening places exclude each other.
#[must_use]
pub fn clash(a: &Uri, b: &Uri) -> bool {
    match (a, b) {
        (Uri::Pty(Some(a)), Uri::Pty(Some(b))) | (Uri::Serial(a), Uri::Serial(b)) => same_path(a, b),
        (Uri::Tcp(a), Uri::Tcp(b)) => a == b && !a.ends_with(":0"),
        (Uri::Stdio, Uri::Stdio) => true,
        _ => false,
    }
}
