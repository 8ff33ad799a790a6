//! Tables of motors, of sensors on their shafts, and of wires.

use drivetwin_firmware::device::{Axis, Pin, Role, Spec};
use drivetwin_firmware::motor::{self, stepper};

use super::Reader;
use super::table::{Located, LocatedError, Table};
use crate::bench::{CYCLES_PER_REV, Closed, FURTHEST_REV};
use crate::catalog;
use crate::config::board_place::reasons;
use crate::config::layout::{At, BrushKeys, EncoderLayout, MotorKind, MotorLayout, SwitchLayout, WireLayout};
use crate::suggest;

/// The keys of `[[motor]]`.
pub(super) const MOTOR: [&str; 14] = [
    "name",
    "drive",
    "inertia_gcm2",
    "friction_mnm",
    "load_mnm",
    "steps_per_rev",
    "holding_mnm",
    "rated_ma",
    "pull_out_rpm",
    "no_load_rpm",
    "supply_v",
    "resistance_ohm",
    "hall_pulses",
    "poles",
];
/// The keys of `[[encoder]]`.
pub(super) const ENCODER: [&str; 3] = ["motor", "cycles_per_rev", "to"];
/// The keys of `[[switch]]`.
pub(super) const SWITCH: [&str; 3] = ["motor", "closed", "to"];
/// The keys of `[[wire]]`.
pub(super) const WIRE: [&str; 2] = ["from", "to"];

/// Kind of motor that a drive turns.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Sort {
    Stepper,
    Brush,
    Brushless,
}

impl Sort {
    fn of(spec: &Spec) -> Self {
        let own = catalog::make(spec.kind).ok().and_then(|device| device.internal_motor());
        own.map_or(Self::Stepper, |own| if own.is_brushless() { Self::Brushless } else { Self::Brush })
    }

    /// The kinds of motor that have a key; the first one is named in messages. Empty for keys that are common
    /// to all kinds.
    fn with(key: &str) -> &'static [Self] {
        match key {
            "steps_per_rev" | "holding_mnm" | "rated_ma" | "pull_out_rpm" => &[Self::Stepper],
            "no_load_rpm" | "supply_v" | "resistance_ohm" => &[Self::Brush, Self::Brushless],
            "hall_pulses" => &[Self::Brush],
            "poles" => &[Self::Brushless],
            _ => &[],
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Stepper => "stepper",
            Self::Brush => "brush",
            Self::Brushless => "brushless",
        }
    }
}

impl Reader {
    pub(super) fn motor(&mut self, table: &Table<'_>) -> Result<(), LocatedError> {
        let name = self.name(table, "motor")?;
        let text = table.needed_text("drive")?;
        let drive = self.emulated(text.is, reasons::NO_MOTOR).map_err(LocatedError::at(text.at))?;
        let axis = Axis(0);
        let spec = self.spec(drive);
        if spec.axes.is_empty() {
            return Err(text.wrong(format!("{} turns no motor", spec.kind)));
        }
        if let Some(other) =
            self.layout.motors.iter().find(|motor| (motor.drive, motor.axis) == (drive, axis))
        {
            return Err(text.wrong(format!("'{}' turns the motor '{}' already", text.is, other.name)));
        }
        let (sort, why) = self.sort(table, drive);
        for key in table.keys() {
            if let [first, ..] = Sort::with(key.is)
                && !Sort::with(key.is).contains(&sort)
            {
                return Err(key.wrong(format!("{} is a key of a {} motor; {why}", key.is, first.name())));
            }
            if key.is == "hall_pulses" && spec.dc_motor.is_some() {
                let what = format!(
                    "hall_pulses is a key of a motor with Hall sensors; {} has no pins for them",
                    spec.kind
                );
                return Err(key.wrong(what));
            }
        }
        if let Some(key) = table.keys().iter().find(|key| key.is == "supply_v")
            && let Some(row) = spec.supply.and_then(|row| spec.registers.rows.get(row))
            && self.layout.drives[drive].presets.iter().any(|preset| Some(preset.row) == spec.supply)
        {
            let what = format!("{} of '{}' sets the same as supply_v; use one of them", row.name, text.is);
            return Err(key.wrong(what));
        }
        let is = match sort {
            Sort::Stepper => MotorKind::Stepper(stepper(table)?),
            Sort::Brush | Sort::Brushless => MotorKind::Brush(brush(table)?),
        };
        self.layout.motors.push(MotorLayout { name, drive, axis, is });
        Ok(())
    }

    /// Kind of a motor, and the reason for it as text. If the drive turns either kind, the keys of the motor
    /// decide, otherwise the `set` of the drive.
    fn sort(&self, table: &Table<'_>, drive: usize) -> (Sort, String) {
        let (sort, spec) = (Sort::of(self.spec(drive)), self.spec(drive));
        let Some((row, bit)) = spec.dc_motor else {
            return (sort, format!("{} turns a {} motor", spec.kind, sort.name()));
        };
        let drive = &self.layout.drives[drive];
        let is_of = |key: &&Located<&str>, sort| matches!(Sort::with(key.is), [first, ..] if *first == sort);
        if let Some(key) = table.keys().iter().find(|key| is_of(key, Sort::Brush)) {
            return (Sort::Brush, format!("{} is a key of a brush motor", key.is));
        }
        if drive.presets.iter().any(|preset| preset.row == row && preset.onto(spec, 0) & i64::from(bit) != 0)
        {
            let name = spec.registers.rows.get(row).map_or("", |row| row.name);
            return (Sort::Brush, format!("{name} of '{}' selects a brush motor", drive.name));
        }
        (sort, format!("{} turns a stepper or a brush motor", spec.kind))
    }

    pub(super) fn encoder(&mut self, table: &Table<'_>) -> Result<(), LocatedError> {
        let motor = self.motor_named(&table.needed_text("motor")?)?;
        let (least, most) = CYCLES_PER_REV.into_inner();
        let cycles = table.needs("cycles_per_rev", table.whole("cycles_per_rev", least, most)?)?;
        let to = table.needs("to", table.table("to", &["a", "b", "index"])?)?;
        if to.keys().is_empty() {
            return Err(LocatedError { at: to.at, what: "to takes a, b, index or some of them".to_owned() });
        }
        let mut taken = Vec::new();
        let mut pin = |key| {
            let Some(text) = to.text(key)? else { return Ok(None) };
            let pin = self.input(&text)?;
            if let Some((other, _)) = taken.iter().find(|(_, other)| *other == pin) {
                return Err(text.wrong(format!("'{}' has '{other}' of this encoder already", text.is)));
            }
            taken.push((key, pin));
            Ok(Some(pin))
        };
        let [a, b, index] = [pin("a")?, pin("b")?, pin("index")?];
        self.layout.encoders.push(EncoderLayout { motor, cycles_per_rev: cycles.is, a, b, index });
        Ok(())
    }

    pub(super) fn switch(&mut self, table: &Table<'_>) -> Result<(), LocatedError> {
        let motor = self.motor_named(&table.needed_text("motor")?)?;
        let closed = table.table("closed", &["above_rev", "below_rev"])?;
        let closed = table.needs("closed", closed)?;
        let bound = |key| closed.number(key, -FURTHEST_REV, FURTHEST_REV);
        let wrong = |what: String| LocatedError { at: closed.at, what };
        let closed = match (bound("above_rev")?, bound("below_rev")?) {
            (None, None) => return Err(wrong("closed takes above_rev, below_rev or both".to_owned())),
            (Some(above), Some(below)) if above.is >= below.is => {
                let nowhere = format!("above {} and below {} is nowhere", above.is, below.is);
                return Err(wrong(format!("{nowhere}; two ranges are two switches")));
            }
            (above, below) => {
                Closed { above_rev: above.map(|above| above.is), below_rev: below.map(|below| below.is) }
            }
        };
        let to = self.input(&table.needed_text("to")?)?;
        self.layout.switches.push(SwitchLayout { motor, closed, to });
        Ok(())
    }

    pub(super) fn wire(&mut self, table: &Table<'_>) -> Result<(), LocatedError> {
        let (from, to) = (table.needed_text("from")?, table.needed_text("to")?);
        let wire = WireLayout { from: self.output(&from)?, to: self.input(&to)? };
        if wire.from == wire.to {
            return Err(to.wrong(format!("'{}' is wired to itself", to.is)));
        }
        if self.layout.wires.iter().any(|other| (other.from, other.to) == (wire.from, wire.to)) {
            return Err(from.wrong(format!("'{}' is wired to '{}' already", from.is, to.is)));
        }
        self.layout.wires.push(wire);
        Ok(())
    }

    fn motor_named(&self, text: &Located<&str>) -> Result<usize, LocatedError> {
        let names = self.layout.motors.iter().map(|motor| motor.name.as_str());
        let index = names.clone().position(|name| name == text.is);
        index.ok_or_else(|| text.wrong(suggest::unknown("motor", text.is, names)))
    }

    /// The pin with that name, which must be one that the drive reads.
    pub(super) fn input(&self, text: &Located<&str>) -> Result<At, LocatedError> {
        let at = self.pin(text.is).map_err(LocatedError::at(text.at))?;
        match self.role(at) {
            Role::Input | Role::Both | Role::Analogue | Role::AnalogueOrDigital => Ok(at),
            Role::Output => Err(text.wrong(format!("'{}' is an output; an input is wanted here", text.is))),
            Role::Led => Err(text.wrong(format!("'{}' is a light; an input is wanted here", text.is))),
        }
    }

    /// The pin with that name, which must be one that the drive can drive.
    fn output(&self, text: &Located<&str>) -> Result<At, LocatedError> {
        let at = self.pin(text.is).map_err(LocatedError::at(text.at))?;
        match self.role(at) {
            Role::Output | Role::Both | Role::Led => Ok(at),
            Role::Input | Role::Analogue | Role::AnalogueOrDigital => {
                Err(text.wrong(format!("'{}' is an input; an output is wanted here", text.is)))
            }
        }
    }

    fn role(&self, (drive, pin): (usize, Pin)) -> Role {
        let spec: &Spec = self.spec(drive);
        spec.pins.get(usize::from(pin.0)).map_or(Role::Input, |pin| pin.role)
    }
}

fn stepper(table: &Table<'_>) -> Result<stepper::StepperParameters, LocatedError> {
    use stepper::StepperParameters;
    let (least, most, nominal) =
        (StepperParameters::LEAST, StepperParameters::MOST, StepperParameters::NOMINAL);
    let whole =
        |key, least, most, nominal| Ok(table.whole(key, least, most)?.map_or(nominal, |number| number.is));
    let unsigned = |key, least, most, nominal| Ok(unsigned(table, key, least, most)?.unwrap_or(nominal));
    let steps_per_rev = table.whole("steps_per_rev", least.steps_per_rev, most.steps_per_rev)?;
    let load_unm = thousandths(table, "load_mnm", least.load_unm, most.load_unm)?;
    Ok(StepperParameters {
        steps_per_rev: steps_per_rev.map_or(nominal.steps_per_rev, |steps| steps.is),
        holding_unm: unsigned("holding_mnm", least.holding_unm, most.holding_unm, nominal.holding_unm)?,
        rated_ma: whole("rated_ma", least.rated_ma, most.rated_ma, nominal.rated_ma)?,
        pull_out_rpm: whole("pull_out_rpm", least.pull_out_rpm, most.pull_out_rpm, nominal.pull_out_rpm)?,
        inertia_gcm2: whole("inertia_gcm2", least.inertia_gcm2, most.inertia_gcm2, nominal.inertia_gcm2)?,
        friction_unm: unsigned("friction_mnm", least.friction_unm, most.friction_unm, nominal.friction_unm)?,
        load_unm: load_unm.unwrap_or(nominal.load_unm),
    })
}

fn brush(table: &Table<'_>) -> Result<BrushKeys, LocatedError> {
    use motor::Parameters;
    let (least, most) = (Parameters::LEAST, Parameters::MOST);
    let whole = |key, least, most| Ok(table.whole(key, least, most)?.map(|number| number.is));
    let hall_pulses = table.whole("hall_pulses", least.hall_pulses, most.hall_pulses)?;
    let pairs_of_poles = match table.whole("poles", 2 * least.hall_pulses, 2 * most.hall_pulses)? {
        Some(poles) if poles.is % 2 == 1 => {
            return Err(poles.wrong(format!("poles takes an even number, not {}", poles.is)));
        }
        poles => poles.map(|poles| poles.is / 2),
    };
    Ok(BrushKeys {
        supply_mv: unsigned(table, "supply_v", least.supply_mv, most.supply_mv)?,
        no_load_rpm: whole("no_load_rpm", least.no_load_rpm, most.no_load_rpm)?,
        resistance_mohm: unsigned(table, "resistance_ohm", least.resistance_mohm, most.resistance_mohm)?,
        inertia_gcm2: whole("inertia_gcm2", least.inertia_gcm2, most.inertia_gcm2)?,
        friction_unm: unsigned(table, "friction_mnm", least.friction_unm, most.friction_unm)?,
        load_unm: thousandths(table, "load_mnm", least.load_unm, most.load_unm)?,
        hall_pulses: hall_pulses.map(|pulses| pulses.is).or(pairs_of_poles),
    })
}

/// The value of a key in thousandths of its unit; `least` and `most` are in thousandths, too.
fn thousandths(table: &Table<'_>, key: &str, least: i32, most: i32) -> Result<Option<i32>, LocatedError> {
    let number = table.number(key, f64::from(least) / 1_000.0, f64::from(most) / 1_000.0)?;
    Ok(number.map(|number| (number.is * 1_000.0).round() as i32))
}

/// Like [`thousandths`], for a value that is never negative.
fn unsigned(table: &Table<'_>, key: &str, least: u32, most: u32) -> Result<Option<u32>, LocatedError> {
    let number = thousandths(table, key, least.cast_signed(), most.cast_signed())?;
    Ok(number.map(i32::unsigned_abs))
}
