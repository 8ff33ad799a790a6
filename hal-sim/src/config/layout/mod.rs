//! The configuration of a bench as plain data: from a bench file, or from the options of a single drive.
//!
//! The code that makes a [`Layout`] checks it: names are unique; indices, pins and registers exist; values
//! are legal. [`Layout::build`] relies on these checks (BENCH-1).

mod build;

use std::path::{Path, PathBuf};

use drivetwin_firmware::device::{Axis, Fault, Framing, Pin, Port, Spec};
use drivetwin_firmware::motor;

pub use self::build::{Added, Built, has_own_motor};
use crate::bench::scenario::Scenario;
use crate::bench::{Closed, Settings};
use crate::catalog;
use crate::config::board_place::{BoardPlace, reasons};
use crate::config::listen::{Listen, Uri};
use crate::config::preset::Preset;
use crate::config::time_mode::TimeMode;
use crate::line::LineMode;
use crate::line::faults::LineFaults;
use crate::suggest;

/// Configuration of a bench, from a [bench file](crate::config::bench_file) or made in code.
///
/// ```
/// use drivetwin_sim::config::bench_file;
///
/// let layout = bench_file::parse(
///     r#"
///     seed = 7
///     [[drive]]
///     kind = "md3"
///     name = "x"
///     set = { Speed = 8000 }
///     "#,
/// )?;
/// let built = layout.build(layout.settings(), Vec::new())?;
/// let (bench, x) = (built.bench, built.drives[0]);
/// let speed = bench.spec(x).find("Speed").unwrap();
/// assert_eq!(bench.peek(x, speed.row), 8_000);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Layout {
    /// Seed of all random choices; default 1.
    pub seed: Option<u64>,
    /// Time mode of a run. A bench in a test uses it only for [`Settings::frame_timeout`].
    pub time: Option<TimeMode>,
    /// Timing of characters on serial lines; default [`LineMode::Timed`].
    pub line: Option<LineMode>,
    /// True if all Modbus lines drop requests that are too early.
    pub strict: bool,
    /// Drives of the bench; other entries refer to them by index.
    pub drives: Vec<DriveLayout>,
    /// Lines that several ports share. Any other serial port has its own line.
    pub buses: Vec<BusLayout>,
    /// Motors that are attached to drives.
    pub motors: Vec<MotorLayout>,
    /// Encoders on motor shafts.
    pub encoders: Vec<EncoderLayout>,
    /// Switches on motor shafts.
    pub switches: Vec<SwitchLayout>,
    /// Wires from output pins to input pins.
    pub wires: Vec<WireLayout>,
    /// Faults that lines have from the start.
    pub faults: Vec<FaultLayout>,
    /// Scenarios that are played from the start. A drive in a scenario is an index in [`drives`](Self::drives).
    pub scenarios: Vec<Scenario>,
}

impl Layout {
    /// Returns true if a drive has a serial port for Modbus.
    #[must_use]
    pub fn has_modbus_line(&self) -> bool {
        self.drives.iter().filter(|drive| drive.board.is_none()).any(|drive| {
            let ports = catalog::make(drive.kind).map_or(&[][..], |device| device.spec().ports);
            ports.iter().any(|port| port.framing == Framing::Silence)
        })
    }

    /// Settings of the bench. A field that is `None` has its value from [`Settings::default`].
    #[must_use]
    pub fn settings(&self) -> Settings {
        let default = Settings::default();
        Settings {
            seed: self.seed.unwrap_or(default.seed),
            line: self.line.unwrap_or(default.line),
            frame_timeout: self.time.map_or(default.frame_timeout, TimeMode::frame_timeout),
            ..default
        }
    }

    /// Returns true if a drive is on a board.
    #[must_use]
    pub fn has_boards(&self) -> bool {
        self.drives.iter().any(|drive| drive.board.is_some())
    }

    /// Checks that all drives are emulated, as those of a bench on virtual time are.
    ///
    /// # Errors
    /// One sentence: a drive is on a board.
    pub fn check_emulated(&self) -> Result<(), String> {
        match self.drives.iter().find(|drive| drive.board.is_some()) {
            Some(drive) => Err(format!(
                "'{}' is on a board, which only a run attaches; use drivetwin run, or drivetwin.run in Python",
                drive.name
            )),
            None => Ok(()),
        }
    }

    /// Checks that the bench can have its time mode.
    ///
    /// # Errors
    /// One sentence: the bench has a board, and its time is not real.
    pub fn check_time(&self) -> Result<(), String> {
        match (self.time, self.drives.iter().find(|drive| drive.board.is_some())) {
            (Some(time), Some(drive)) if time != TimeMode::Times(1) => Err(format!(
                "time cannot be '{time}', because '{}' is on a board: {}",
                drive.name,
                reasons::NO_TIME
            )),
            _ => Ok(()),
        }
    }

    /// Prefixes relative paths with `folder`: paths in a bench file are relative to its folder (BENCH-2).
    pub fn relative_to(&mut self, folder: &Path) {
        for drive in &mut self.drives {
            for path in [&mut drive.nv, &mut drive.program].into_iter().flatten() {
                *path = folder.join(&path);
            }
            let Some(BoardLayout { place, bus }) = &mut drive.board else { continue };
            if let BoardPlace::Port(path) = place {
                *path = folder.join(&path);
            }
            if let Some(Uri::Serial(path)) = bus {
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

/// A pin of a drive: index in [`Layout::drives`], and pin.
pub type At = (usize, Pin);

/// A drive of a [`Layout`]: table `[[drive]]` of a bench file.
#[derive(Clone, Debug)]
pub struct DriveLayout {
    /// Name of the drive: one word without dots, unique on the bench.
    pub name: String,
    /// Kind of the drive, as in [`catalog`], for instance `md3`. Empty if the drive is on a board, and the file does not
    /// say what the board is.
    pub kind: &'static str,
    /// Listening addresses of its ports.
    pub listen: Vec<(Port, Uri)>,
    /// File of its non-volatile memory.
    pub nv: Option<PathBuf>,
    /// Registers to preset, including the bus address.
    pub presets: Vec<Preset>,
    /// File of a user program of an RS drive, as text.
    pub program: Option<PathBuf>,
    /// True to skip the start-up delay.
    pub fast_boot: bool,
    /// Faults whose causes are present from the start.
    pub faults: Vec<Fault>,
    /// The board that the drive is on; `None` if the drive is emulated here.
    pub board: Option<BoardLayout>,
}

/// A board at this computer, whose drive is one of the bench.
#[derive(Clone, Debug, Default)]
pub struct BoardLayout {
    /// Place of the board.
    pub place: BoardPlace,
    /// Address of the drive's bus for masters; `None` if the place of the board says it.
    pub bus: Option<Uri>,
}

/// A line that several ports share: table `[[bus]]` of a bench file.
#[derive(Clone, Debug)]
pub struct BusLayout {
    /// Name of the line.
    pub name: String,
    /// Listening addresses of the line.
    pub listen: Vec<Uri>,
    /// Ports on the line: index in [`Layout::drives`], and port.
    pub drives: Vec<(usize, Port)>,
    /// True if characters that overlap corrupt each other.
    pub collisions: bool,
    /// True if requests that are too early are dropped.
    pub strict: bool,
}

/// A motor on an axis of a drive: table `[[motor]]` of a bench file.
#[derive(Clone, Debug)]
pub struct MotorLayout {
    /// Name of the motor.
    pub name: String,
    /// Drive that turns the motor: index in [`Layout::drives`].
    pub drive: usize,
    /// Axis of the drive.
    pub axis: Axis,
    /// Kind and parameters of the motor.
    pub is: MotorKind,
}

/// Kind of a motor, with its parameters or keys.
#[derive(Clone, Debug)]
pub enum MotorKind {
    /// A stepper motor, which follows the steps of its drive.
    Stepper(motor::stepper::StepperParameters),
    /// A brush or brushless motor. A missing key has the value that the drive's registers describe after the
    /// first power-on, with its memory and presets. Later changes of registers do not change the motor.
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

/// An encoder on the shaft of a motor: table `[[encoder]]` of a bench file.
#[derive(Clone, Debug)]
pub struct EncoderLayout {
    /// Motor: index in [`Layout::motors`].
    pub motor: usize,
    /// Cycles per revolution, within [`CYCLES_PER_REV`](crate::bench::CYCLES_PER_REV).
    pub cycles_per_rev: u32,
    /// Input pin that channel A is wired to.
    pub a: Option<At>,
    /// Input pin that channel B is wired to.
    pub b: Option<At>,
    /// Input pin that the index is wired to.
    pub index: Option<At>,
}

/// A switch that the shaft of a motor closes: table `[[switch]]` of a bench file.
#[derive(Clone, Debug)]
pub struct SwitchLayout {
    /// Motor: index in [`Layout::motors`].
    pub motor: usize,
    /// Range of the shaft in which the switch is closed.
    pub closed: Closed,
    /// The pin that the switch pulls to ground.
    pub to: At,
}

/// A wire from an output pin to an input pin: table `[[wire]]` of a bench file.
#[derive(Clone, Debug)]
pub struct WireLayout {
    /// Output pin that drives the wire.
    pub from: At,
    /// Input pin at the other end.
    pub to: At,
}

/// Faults of a line or TCP port from the start: table `[[fault]]` of a bench file.
#[derive(Clone, Debug)]
pub struct FaultLayout {
    /// Name of the line or port, as [`Bench::find_outlet`](crate::bench::Bench::find_outlet) finds it.
    pub bus: String,
    /// Faults of the line or port, checked by [`LineFaults::check_for`]. A drive in a rule is an index in
    /// [`Layout::drives`].
    pub faults: LineFaults,
}

/// Finds the port of a drive for a listening address, and checks that the port can have this kind of address.
///
/// # Errors
/// One sentence that says what is wrong: there is no such port, or the port cannot have this kind of address.
pub fn address(spec: &Spec, listen: &Listen) -> Result<(Port, Uri), String> {
    let Listen { port: name, uri } = listen;
    let mut ports = (0..).map(Port).zip(spec.ports);
    let found = ports.find(|(_, port)| name.as_deref().is_none_or(|name| port.name == name));
    let (port, of) = found.ok_or_else(|| {
        let name = name.as_deref().unwrap_or_default();
        suggest::unknown(&format!("port of {}", spec.kind), name, spec.ports.iter().map(|port| port.name))
    })?;
    match (of.line, uri) {
        (None, Uri::Pty(_)) => {
            Err(format!("{} of {} is a TCP port and cannot have a pty; use tcp:", of.name, spec.kind))
        }
        (None, Uri::Rfc2217(_) | Uri::Serial(_) | Uri::Stdio) => {
            Err(format!("{} of {} is a TCP port; use tcp:", of.name, spec.kind))
        }
        _ => Ok((port, uri.clone())),
    }
}

/// Error message for a TCP port where a serial line is required.
#[must_use]
pub fn no_line(name: &str) -> String {
    format!("{name} is a TCP port, not a serial line")
}

/// Returns true if two paths, both relative to the same folder, are equal apart from `./`.
pub(crate) fn same_path(a: &Path, b: &Path) -> bool {
    // A leading `./` has no effect in a path after a folder.
    Path::new("/").join(a) == Path::new("/").join(b)
}

/// Returns true if two listening addresses cannot be used at the same time.
#[must_use]
pub fn clash(a: &Uri, b: &Uri) -> bool {
    match (a, b) {
        (Uri::Pty(Some(a)), Uri::Pty(Some(b))) | (Uri::Serial(a), Uri::Serial(b)) => same_path(a, b),
        (Uri::Tcp(a), Uri::Tcp(b)) | (Uri::Rfc2217(a), Uri::Rfc2217(b)) => a == b && !a.ends_with(":0"),
        (Uri::Stdio, Uri::Stdio) => true,
        _ => false,
    }
}
