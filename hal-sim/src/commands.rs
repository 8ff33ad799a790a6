//! Actions on a drive by the names of the manuals, for tests, programs and the control API. The drive is on a bench or
//! elsewhere, for instance on a board: a [`Drive`]. Names, values and the sentences of errors are the same for all.
//!
//! ```
//! use drivetwin_firmware::md3::Md3;
//! use drivetwin_sim::bench::Bench;
//! use drivetwin_sim::commands::{self, OnBench, Refusal};
//!
//! let mut bench = Bench::new();
//! let x = bench.add::<Md3>("x");
//! let mut x = OnBench::new(&mut bench, x);
//! commands::fault(&mut x, "over_temperature", true)?;
//! let wrong = commands::fault(&mut x, "over_temprature", true).unwrap_err();
//! assert!(matches!(wrong, Refusal::Unknown(_)));
//! assert_eq!(wrong.to_string(), "there is no fault 'over_temprature'; the nearest is 'over_temperature'");
//! # Ok::<(), Refusal>(())
//! ```

use std::fmt;

use drivetwin_firmware::device::{Axis, Encoder, Fault, Level, Pin, PinSpec, Port, PresetError, Role, Spec};
use drivetwin_protocol::registers::Named;

use crate::bench::{Bench, Busy, DriveId, ENCODER_HZ, Motion, Outlet, PULSE_HZ, PinStimulus, PowerAction};
use crate::config::preset::{self, Number, Preset};
use crate::suggest;
use crate::value::Value;

/// Reason why a command is refused, in one sentence. The drive is then unchanged.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Refusal {
    /// There is no such name; with the nearest one.
    Unknown(String),
    /// The command is not valid for this drive, pin or register, or a value is out of range.
    Invalid(String),
    /// The drive cannot do this in its present state, or where it is.
    Conflict(String),
    /// The drive cannot be reached now.
    Away(String),
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown(sentence)
            | Self::Invalid(sentence)
            | Self::Conflict(sentence)
            | Self::Away(sentence) => f.write_str(sentence),
        }
    }
}

impl std::error::Error for Refusal {}

impl From<Busy> for Refusal {
    fn from(busy: Busy) -> Self {
        Self::Conflict(busy.to_string())
    }
}

fn invalid(sentence: impl Into<String>) -> Refusal {
    Refusal::Invalid(sentence.into())
}

/// A drive that commands act on. Registers, pins, faults and encoders are numbers of its [`Spec`].
pub trait Drive {
    /// Description of its kind.
    fn spec(&self) -> &'static Spec;

    /// Name of the drive.
    fn name(&self) -> &str;

    /// Power, pins, faults and motion at one instant.
    ///
    /// # Errors
    /// The drive cannot be reached.
    fn state(&mut self) -> Result<State, Refusal>;

    /// Value of a register up to four words long, without the side effects of a read.
    ///
    /// # Errors
    /// The drive cannot be reached.
    fn peek(&mut self, row: usize) -> Result<i64, Refusal>;

    /// Value of a register as users see it.
    ///
    /// # Errors
    /// The drive cannot be reached.
    fn value(&mut self, row: usize) -> Result<Value, Refusal>;

    /// Names and values of all registers, in the order of the manual.
    ///
    /// # Errors
    /// The drive cannot be reached.
    fn values(&mut self) -> Result<Vec<(&'static str, Value)>, Refusal> {
        self.spec().rows().map(|(row, of)| Ok((of.name, self.value(row)?))).collect()
    }

    /// Presets a register. `name` is for sentences.
    ///
    /// # Errors
    /// The drive refuses the value, or cannot be reached.
    fn poke(&mut self, row: usize, name: &str, value: i64) -> Result<(), Refusal>;

    /// Drives an input pin from outside.
    ///
    /// # Errors
    /// The drive cannot be reached.
    fn set_pin(&mut self, pin: Pin, stimulus: PinStimulus) -> Result<(), Refusal>;

    /// Sends a train of pulses into an input pin: `hz` of them per second, each for the part `duty` of its period.
    ///
    /// # Errors
    /// A train or an encoder drives the pin already, or the drive cannot be reached.
    fn pulse(&mut self, pin: Pin, count: u32, hz: f64, duty: f64) -> Result<(), Refusal>;

    /// Turns an encoder by `counts` edges, `hz` of them per second.
    ///
    /// # Errors
    /// The encoder turns already, a train drives one of its pins, or the drive cannot be reached.
    fn turn(&mut self, encoder: Encoder, counts: i32, hz: f64) -> Result<(), Refusal>;

    /// Sets or clears the cause of a fault.
    ///
    /// # Errors
    /// The drive cannot be reached.
    fn set_fault(&mut self, fault: Fault, on: bool) -> Result<(), Refusal>;

    /// Switches the power.
    ///
    /// # Errors
    /// The drive cannot be reached.
    fn power(&mut self, action: PowerAction) -> Result<(), Refusal>;

    /// Content of the non-volatile memory: [`Spec::memory`] bytes.
    ///
    /// # Errors
    /// The drive cannot be reached.
    fn memory(&mut self) -> Result<Vec<u8>, Refusal>;

    /// Replaces the content of the non-volatile memory, which the drive reads at its next power-on.
    ///
    /// # Errors
    /// The drive has power, the memory cannot be written, or the drive cannot be reached.
    fn set_memory(&mut self, bytes: &[u8]) -> Result<(), Refusal>;
}

/// State of a drive at one instant.
#[derive(Clone, Debug)]
pub struct State {
    /// True while the drive has power.
    pub powered: bool,
    /// Levels of its pins, in the order of [`Spec::pins`].
    pub levels: Vec<Level>,
    /// True for each fault whose cause is present, in the order of [`Spec::faults`].
    pub faults: Vec<bool>,
    /// Motion of its first axis; `None` if it has none.
    pub motion: Option<Motion>,
}

impl State {
    /// Level of a pin.
    #[must_use]
    pub fn level(&self, pin: Pin) -> Level {
        self.levels.get(usize::from(pin.0)).copied().unwrap_or(Level::Float)
    }
}

/// The present state of a drive of a bench.
#[must_use]
pub fn state(bench: &Bench, id: DriveId) -> State {
    let spec = bench.spec(id);
    State {
        powered: bench.powered(id),
        levels: (0..).map(Pin).zip(spec.pins).map(|(pin, _)| bench.level(id, pin)).collect(),
        faults: (0..).map(Fault).zip(spec.faults).map(|(fault, _)| bench.faulty(id, fault)).collect(),
        motion: spec.axes.first().map(|_| bench.motion(id, Axis(0))),
    }
}

/// The present values of all registers of a drive of a bench, by the names of the manual.
#[must_use]
pub fn values(bench: &Bench, id: DriveId) -> Vec<(&'static str, Value)> {
    bench.spec(id).rows().map(|(row, of)| (of.name, bench.value(id, row))).collect()
}

/// A drive on a bench.
pub struct OnBench<'a> {
    bench: &'a mut Bench,
    id: DriveId,
}

impl<'a> OnBench<'a> {
    /// A drive of a bench.
    pub fn new(bench: &'a mut Bench, id: DriveId) -> Self {
        Self { bench, id }
    }
}

impl Drive for OnBench<'_> {
    fn spec(&self) -> &'static Spec {
        self.bench.spec(self.id)
    }

    fn name(&self) -> &str {
        self.bench.name(self.id)
    }

    fn state(&mut self) -> Result<State, Refusal> {
        Ok(state(self.bench, self.id))
    }

    fn peek(&mut self, row: usize) -> Result<i64, Refusal> {
        Ok(self.bench.peek(self.id, row))
    }

    fn value(&mut self, row: usize) -> Result<Value, Refusal> {
        Ok(self.bench.value(self.id, row))
    }

    fn poke(&mut self, row: usize, name: &str, value: i64) -> Result<(), Refusal> {
        let poked = self.bench.poke(self.id, row, value);
        poked.map_err(|refused| not_preset(self.spec(), row, name, refused))
    }

    fn set_pin(&mut self, pin: Pin, stimulus: PinStimulus) -> Result<(), Refusal> {
        self.bench.set_pin(self.id, pin, stimulus);
        Ok(())
    }

    fn pulse(&mut self, pin: Pin, count: u32, hz: f64, duty: f64) -> Result<(), Refusal> {
        Ok(self.bench.pulse_width(self.id, pin, count, hz, duty)?)
    }

    fn turn(&mut self, encoder: Encoder, counts: i32, hz: f64) -> Result<(), Refusal> {
        Ok(self.bench.encoder(self.id, encoder, counts, hz)?)
    }

    fn set_fault(&mut self, fault: Fault, on: bool) -> Result<(), Refusal> {
        self.bench.fault(self.id, fault, on);
        Ok(())
    }

    fn power(&mut self, action: PowerAction) -> Result<(), Refusal> {
        self.bench.power(self.id, action);
        Ok(())
    }

    fn memory(&mut self) -> Result<Vec<u8>, Refusal> {
        Ok(self.bench.memory(self.id).to_vec())
    }

    fn set_memory(&mut self, _bytes: &[u8]) -> Result<(), Refusal> {
        Err(Refusal::Conflict(format!(
            "{} is emulated here, so its memory cannot be replaced; begin it with a memory by --nv FILE, or nv in a bench file",
            self.name()
        )))
    }
}

/// The refusal of a preset of a row, called `name` in the sentence.
#[must_use]
pub fn not_preset(spec: &Spec, row: usize, name: &str, refused: PresetError) -> Refusal {
    invalid(preset::refusal(spec, row, name, refused))
}

/// The refusal of a change that needs power.
fn no_power(drive: &dyn Drive) -> Refusal {
    Refusal::Conflict(format!("{} has no power", drive.name()))
}

/// The drive with that name.
///
/// # Errors
/// There is no such drive.
pub fn drive(bench: &Bench, name: &str) -> Result<DriveId, Refusal> {
    let names = || bench.drives().map(|id| bench.name(id));
    bench.find_drive(name).ok_or_else(|| Refusal::Unknown(suggest::unknown("drive", name, names())))
}

/// The line or TCP port with that name.
///
/// # Errors
/// There is no such line or port.
pub fn outlet(bench: &Bench, name: &str) -> Result<Outlet, Refusal> {
    bench.find_outlet(name).ok_or_else(|| {
        let names: Vec<String> =
            bench.outlets().into_iter().map(|outlet| bench.outlet_name(outlet)).collect();
        Refusal::Unknown(suggest::unknown("bus", name, names.iter().map(String::as_str)))
    })
}

/// The port of a drive with that name.
///
/// # Errors
/// There is no such port.
pub fn port(spec: &Spec, name: &str) -> Result<Port, Refusal> {
    let found = (0..).map(Port).zip(spec.ports).find(|(_, port)| port.name == name);
    let names = spec.ports.iter().map(|port| port.name);
    found.map(|(port, _)| port).ok_or_else(|| Refusal::Unknown(suggest::unknown("port", name, names)))
}

/// The register with that name.
///
/// # Errors
/// There is no such register.
pub fn register(spec: &Spec, name: &str) -> Result<Named, Refusal> {
    let names = spec.rows().map(|(_, row)| row.name);
    spec.find(name).ok_or_else(|| Refusal::Unknown(suggest::unknown("register", name, names)))
}

/// A pin with that name.
///
/// # Errors
/// There is no such pin.
pub fn pin(spec: &'static Spec, name: &str) -> Result<(Pin, &'static PinSpec), Refusal> {
    let found = spec.pin(name).and_then(|pin| Some((pin, spec.pins.get(usize::from(pin.0))?)));
    let names = spec.pin_names().map(|(name, _)| name);
    found.ok_or_else(|| Refusal::Unknown(suggest::unknown("pin", name, names)))
}

/// A pin with that name that can be driven from outside.
///
/// # Errors
/// There is no such pin, or it is an output.
pub fn input(spec: &'static Spec, name: &str) -> Result<(Pin, &'static PinSpec), Refusal> {
    match pin(spec, name)? {
        (_, PinSpec { role: Role::Output | Role::Led, .. }) => Err(invalid(format!("{name} is an output"))),
        found => Ok(found),
    }
}

/// A level from outside.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Contact {
    /// The pin is pulled low.
    Low,
    /// The pin is driven high.
    High,
    /// The pin is not driven.
    Open,
}

/// Level, voltage or current at an input pin: exactly one of the three.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct InputLevel {
    /// A level.
    pub level: Option<Contact>,
    /// A voltage, on an analogue input.
    pub volts: Option<f64>,
    /// A current in mA, on an analogue input that can measure one.
    pub milliamps: Option<f64>,
}

/// Greatest voltage in V and current in mA at a pin, both signs.
const GREATEST: std::ops::RangeInclusive<f64> = -1_000.0..=1_000.0;

/// Drives an input pin from outside.
///
/// # Errors
/// There is no such input, it takes no such level, or the value is out of range.
pub fn drive_pin(drive: &mut dyn Drive, name: &str, wanted: InputLevel) -> Result<(), Refusal> {
    let (pin, spec) = input(drive.spec(), name)?;
    drive.set_pin(pin, stimulus(spec, wanted)?)
}

/// Converts a level to a stimulus of an input pin.
fn stimulus(pin: &PinSpec, wanted: InputLevel) -> Result<PinStimulus, Refusal> {
    let levels = pin.role != Role::Analogue;
    let voltages = matches!(pin.role, Role::Analogue | Role::AnalogueOrDigital);
    let shunt_ohm = pin.shunt_ohm;
    match wanted {
        InputLevel { level: Some(Contact::Open), volts: None, milliamps: None } => Ok(PinStimulus::Open),
        InputLevel { level: Some(level), volts: None, milliamps: None } if levels => Ok(match level {
            Contact::Low => PinStimulus::Low,
            Contact::High => PinStimulus::High,
            Contact::Open => PinStimulus::Open,
        }),
        InputLevel { level: None, volts: Some(volts), milliamps: None } if voltages => {
            if !GREATEST.contains(&volts) {
                return Err(invalid("volts are -1000 to 1000"));
            }
            Ok(PinStimulus::Millivolts((volts * 1_000.0).round() as i32))
        }
        InputLevel { level: None, volts: None, milliamps: Some(milliamps) } if shunt_ohm > 0 => {
            if !GREATEST.contains(&milliamps) {
                return Err(invalid("milliamps are -1000 to 1000"));
            }
            // The drive receives the voltage across its shunt.
            Ok(PinStimulus::Millivolts((milliamps * f64::from(shunt_ohm)).round() as i32))
        }
        InputLevel { level: None, volts: None, milliamps: Some(_) } => {
            Err(invalid("this pin takes no current; send a level or volts"))
        }
        InputLevel { level: None, volts: None, milliamps: None } => Err(invalid(format!(
            "the body has no level; it takes one of {}",
            match (levels, voltages) {
                (true, true) => {
                    "{\"level\":\"low\"}, {\"level\":\"high\"}, {\"level\":\"open\"} and {\"volts\":2.5}"
                }
                (true, false) => "{\"level\":\"low\"}, {\"level\":\"high\"} and {\"level\":\"open\"}",
                (false, _) if shunt_ohm > 0 => "{\"volts\":2.5}, {\"milliamps\":12} and {\"level\":\"open\"}",
                (false, _) => "{\"volts\":2.5} and {\"level\":\"open\"}",
            }
        ))),
        _ if levels && voltages => {
            Err(invalid("this input takes a level (low, high or open) or volts, one of them"))
        }
        _ if shunt_ohm > 0 => {
            Err(invalid("this input takes volts, milliamps, or the level open, one of them"))
        }
        _ if voltages => Err(invalid("an analogue input takes volts, or the level open")),
        _ => Err(invalid("a digital input takes a level: low, high or open")),
    }
}

/// Sends a train of pulses into an input pin: `hz` of them per second ([`PULSE_HZ`]), each for the part `duty` of
/// its period (above 0, below 1).
///
/// # Errors
/// There is no such input, a value is out of range, or a train or an encoder drives the pin already.
pub fn pulse_pin(drive: &mut dyn Drive, name: &str, count: u32, hz: f64, duty: f64) -> Result<(), Refusal> {
    let (pin, spec) = input(drive.spec(), name)?;
    if count == 0 || !PULSE_HZ.contains(&hz) {
        let (least, most) = (PULSE_HZ.start(), PULSE_HZ.end());
        return Err(invalid(format!("a train has at least 1 pulse, and {least} to {most} of them a second")));
    }
    if !(duty > 0.0 && duty < 1.0) {
        return Err(invalid("the duty of a pulse is between 0 and 1"));
    }
    if spec.role == Role::Analogue {
        return Err(invalid("an analogue input takes no pulses"));
    }
    drive.pulse(pin, count, hz, duty)
}

/// Turns the encoder at the inputs A and B of a drive by `counts` edges, `hz` of them per second ([`ENCODER_HZ`]);
/// backwards if `counts` is negative.
///
/// # Errors
/// The drive has no encoder input, a value is out of range, or the encoder turns already.
pub fn encoder(drive: &mut dyn Drive, counts: i64, hz: f64) -> Result<(), Refusal> {
    if drive.spec().encoders.is_empty() {
        return Err(invalid(format!("{} has no encoder input", drive.name())));
    }
    let counts = i32::try_from(counts).ok().filter(|counts| *counts != 0);
    let counts = counts.filter(|_| ENCODER_HZ.contains(&hz)).ok_or_else(|| {
        let (least, most) = (ENCODER_HZ.start(), ENCODER_HZ.end());
        invalid(format!(
            "an encoder makes 1 to 2147483647 edges, or -1 to -2147483648 the other way, and {least} to {most} of them a second"
        ))
    })?;
    drive.turn(Encoder(0), counts, hz)
}

/// New value of a register.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum NewValue {
    /// A number, or words.
    Number(Number),
    /// Text as typed by a user: a number, words, or text of the register.
    Typed(String),
}

/// Presets a register, past the bus.
///
/// # Errors
/// There is no such register, it or the drive does not take the value, or the drive has no power.
pub fn preset(drive: &mut dyn Drive, register: &str, value: &NewValue) -> Result<(), Refusal> {
    let spec = drive.spec();
    let presets = match value {
        NewValue::Number(number) => Preset::new(spec, register, number).map(|preset| vec![preset]),
        NewValue::Typed(text) => Preset::typed(spec, register, text),
    };
    let is_known = spec.find(register).is_some();
    let presets = presets.map_err(if is_known { Refusal::Invalid } else { Refusal::Unknown })?;
    if !drive.state()?.powered {
        return Err(no_power(drive));
    }
    for preset in presets {
        let old = if preset.is_half() { drive.peek(preset.row)? } else { 0 };
        drive.poke(preset.row, register, preset.onto(spec, old))?;
    }
    Ok(())
}

/// Sets or clears the cause of a fault.
///
/// # Errors
/// The drive has no such fault.
pub fn fault(drive: &mut dyn Drive, name: &str, on: bool) -> Result<(), Refusal> {
    let faults = drive.spec().faults;
    let found = (0..).map(Fault).zip(faults).find(|(_, known)| **known == name);
    let (fault, _) =
        found.ok_or_else(|| Refusal::Unknown(suggest::unknown("fault", name, faults.iter().copied())))?;
    drive.set_fault(fault, on)
}

/// Replaces the content of the non-volatile memory, which must have all its bytes.
///
/// # Errors
/// The number of bytes is wrong, the drive has power, or its memory cannot be replaced.
pub fn set_memory(drive: &mut dyn Drive, bytes: &[u8]) -> Result<(), Refusal> {
    let size = usize::from(drive.spec().memory);
    if bytes.len() != size {
        return Err(invalid(format!(
            "the memory of {} has {size} bytes, not {}",
            drive.spec().kind,
            bytes.len()
        )));
    }
    drive.set_memory(bytes)
}
