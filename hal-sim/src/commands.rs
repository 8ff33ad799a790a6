//! Actions on a bench by the names of the manuals, for tests, programs and the control API.
//!
//! ```
//! use drivetwin_firmware::md3::Md3;
//! use drivetwin_sim::bench::Bench;
//! use drivetwin_sim::commands::{self, Refusal};
//!
//! let mut bench = Bench::new();
//! let x = bench.add::<Md3>("x");
//! commands::fault(&mut bench, x, "over_temperature", true)?;
//! let wrong = commands::fault(&mut bench, x, "over_temprature", true).unwrap_err();
//! assert!(matches!(wrong, Refusal::Unknown(_)));
//! assert_eq!(wrong.to_string(), "there is no fault 'over_temprature'; the nearest is 'over_temperature'");
//! # Ok::<(), Refusal>(())
//! ```

use std::fmt;

use drivetwin_firmware::device::{Encoder, Fault, Pin, PinSpec, Port, Role, Spec};
use drivetwin_protocol::registers::Named;

use crate::bench::{Bench, DriveId, ENCODER_HZ, Outlet, PULSE_HZ, PinStimulus};
use crate::config::preset::{self, Number, Preset};
use crate::suggest;

/// Reason why a command is refused, in one sentence. The bench is then unchanged.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Refusal {
    /// There is no such name; with the nearest one.
    Unknown(String),
    /// The command is not valid for this drive, pin or register, or a value is out of range.
    Invalid(String),
    /// The present state of the bench does not allow the command.
    Conflict(String),
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown(sentence) | Self::Invalid(sentence) | Self::Conflict(sentence) => {
                f.write_str(sentence)
            }
        }
    }
}

impl std::error::Error for Refusal {}

fn invalid(sentence: impl Into<String>) -> Refusal {
    Refusal::Invalid(sentence.into())
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
pub fn drive_pin(bench: &mut Bench, drive: DriveId, name: &str, wanted: InputLevel) -> Result<(), Refusal> {
    let (pin, spec) = input(bench.spec(drive), name)?;
    let stimulus = stimulus(spec, wanted)?;
    bench.set_pin(drive, pin, stimulus);
    Ok(())
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
pub fn pulse_pin(
    bench: &mut Bench,
    drive: DriveId,
    name: &str,
    count: u32,
    hz: f64,
    duty: f64,
) -> Result<(), Refusal> {
    let (pin, spec) = input(bench.spec(drive), name)?;
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
    let begun = bench.pulse_width(drive, pin, count, hz, duty);
    begun.map_err(|busy| Refusal::Conflict(busy.to_string()))
}

/// Turns the encoder at the inputs A and B of a drive by `counts` edges, `hz` of them per second ([`ENCODER_HZ`]);
/// backwards if `counts` is negative.
///
/// # Errors
/// The drive has no encoder input, a value is out of range, or the encoder turns already.
pub fn encoder(bench: &mut Bench, drive: DriveId, counts: i64, hz: f64) -> Result<(), Refusal> {
    if bench.spec(drive).encoders.is_empty() {
        return Err(invalid(format!("{} has no encoder input", bench.name(drive))));
    }
    let counts = i32::try_from(counts).ok().filter(|counts| *counts != 0);
    let counts = counts.filter(|_| ENCODER_HZ.contains(&hz)).ok_or_else(|| {
        let (least, most) = (ENCODER_HZ.start(), ENCODER_HZ.end());
        invalid(format!(
            "an encoder makes 1 to 2147483647 edges, or -1 to -2147483648 the other way, and {least} to {most} of them a second"
        ))
    })?;
    let begun = bench.encoder(drive, Encoder(0), counts, hz);
    begun.map_err(|busy| Refusal::Conflict(busy.to_string()))
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
pub fn preset(bench: &mut Bench, drive: DriveId, register: &str, value: &NewValue) -> Result<(), Refusal> {
    let spec = bench.spec(drive);
    let presets = match value {
        NewValue::Number(number) => Preset::new(spec, register, number).map(|preset| vec![preset]),
        NewValue::Typed(text) => Preset::typed(spec, register, text),
    };
    let is_known = spec.find(register).is_some();
    let presets = presets.map_err(if is_known { Refusal::Invalid } else { Refusal::Unknown })?;
    if !bench.powered(drive) {
        return Err(Refusal::Conflict(format!("{} has no power", bench.name(drive))));
    }
    for preset in presets {
        let value = preset.onto(spec, bench.peek(drive, preset.row));
        let poked = bench.poke(drive, preset.row, value);
        poked.map_err(|refused| invalid(preset::refusal(spec, preset.row, register, refused)))?;
    }
    Ok(())
}

/// Sets or clears the cause of a fault.
///
/// # Errors
/// The drive has no such fault.
pub fn fault(bench: &mut Bench, drive: DriveId, name: &str, on: bool) -> Result<(), Refusal> {
    let faults = bench.spec(drive).faults;
    let found = (0..).map(Fault).zip(faults).find(|(_, known)| **known == name);
    let (fault, _) =
        found.ok_or_else(|| Refusal::Unknown(suggest::unknown("fault", name, faults.iter().copied())))?;
    bench.fault(drive, fault, on);
    Ok(())
}
