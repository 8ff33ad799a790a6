//! Tables of scenarios.

use drivetwin_firmware::device::{Duration, Fault, Instant, Role, Spec, Writes};
use drivetwin_protocol::registers::{Row, Shape, Space};

use super::Reader;
use super::fault_tables::line_fault_keys;
use super::table::{Located, LocatedError, Table};
use crate::bench::scenario::{Action, MOST_SCENARIOS, Scenario, Step, Trigger, Written};
use crate::bench::{PULSE_HZ, PinStimulus, PowerAction};
use crate::config::board_place::reasons;
use crate::decode::modbus::legal;
use crate::ids::DriveId;
use crate::suggest;

/// The keys of `[[scenario]]`.
pub(super) const SCENARIO: [&str; 1] = ["steps"];
/// The keys of a step.
pub(super) const STEP: [&str; 14] = [
    "at_s", "after_ms", "when", "bus", "faults", "drive", "fault", "clear", "power", "pin", "level", "volts",
    "pulses", "hz",
];
/// The keys of `when`.
pub(super) const WHEN: [&str; 3] = ["drive", "register", "value"];

/// The actions, each with the key of its subject.
const ACTIONS: [(&str, &str); 7] = [
    ("faults", "bus"),
    ("fault", "drive"),
    ("clear", "drive"),
    ("power", "drive"),
    ("level", "pin"),
    ("volts", "pin"),
    ("pulses", "pin"),
];

/// Greatest bench time of a step in s: over 30 years.
const LATEST_S: f64 = 1e9;
/// Greatest time after an event in ms.
const LONGEST_MS: f64 = LATEST_S * 1e3;

impl Reader {
    /// Reads a text that has nothing but scenarios.
    pub(super) fn read_scenarios(mut self, root: &Table<'_>) -> Result<Vec<Scenario>, LocatedError> {
        for table in root.each("scenario", "[[scenario]]", &SCENARIO)? {
            self.scenario(&table)?;
        }
        Ok(self.layout.scenarios)
    }

    pub(super) fn scenario(&mut self, table: &Table<'_>) -> Result<(), LocatedError> {
        let tables = table.needs("steps", table.tables("steps", "a step", &STEP)?)?;
        let mut steps = Vec::new();
        // The earliest time of the next step.
        let mut earliest = self.now;
        for table in tables {
            let step = self.step(&table, earliest)?;
            let begins = match step.trigger {
                Trigger::At(at) => at,
                Trigger::Previous | Trigger::Written(_) => earliest,
            };
            earliest = begins + step.after;
            steps.push(step);
        }
        if steps.is_empty() {
            return Err(LocatedError { at: table.at, what: "a scenario needs a step".to_owned() });
        }
        if self.layout.scenarios.len() >= MOST_SCENARIOS {
            let what = format!("a bench plays {MOST_SCENARIOS} scenarios at once");
            return Err(LocatedError { at: table.at, what });
        }
        self.layout.scenarios.push(Scenario { steps });
        Ok(())
    }

    fn step(&self, table: &Table<'_>, earliest: Instant) -> Result<Step, LocatedError> {
        let after = table.number("after_ms", 0.0, LONGEST_MS)?;
        let after = after.map_or(Duration::ZERO, |ms| ticks(ms.is / 1e3));
        let (at, when) = (table.number("at_s", 0.0, LATEST_S)?, table.table("when", &WHEN)?);
        let trigger = match (at, when) {
            (Some(at), Some(_)) => return Err(at.wrong("a step takes at_s or when, not both")),
            (Some(at), None) => {
                let begins = Instant::ZERO + ticks(at.is);
                if begins < self.now {
                    let now = self.now.since(Instant::ZERO).ticks() as f64 / SECOND;
                    return Err(at.wrong(format!("at_s = {} is past: the bench is at {now} s", at.is)));
                }
                if begins < earliest {
                    let before = earliest.since(Instant::ZERO).ticks() as f64 / SECOND;
                    let what = format!("at_s = {} is before the step above, which is at {before} s", at.is);
                    return Err(at.wrong(what));
                }
                Trigger::At(begins)
            }
            (None, Some(when)) => Trigger::Written(self.written(&when)?),
            (None, None) => Trigger::Previous,
        };
        Ok(Step { trigger, after, action: self.action(table)? })
    }

    fn written(&self, when: &Table<'_>) -> Result<Written, LocatedError> {
        let drive = self.drive_at(&when.needed_text("drive")?)?;
        let (spec, name) = (self.spec(drive), when.needed_text("register")?);
        let rows = || spec.rows().filter(|(_, row)| row.access.writes() && row.space != Space::Setting);
        let Some(named) = spec.find(name.is) else {
            let place = format!(" of {} that a master writes", spec.kind);
            let names = rows().map(|(_, row)| row.name);
            return Err(name.wrong(suggest::unknown_at("register", name.is, &place, names)));
        };
        let Some((_, row)) = rows().find(|(row, _)| *row == named.row) else {
            return Err(name.wrong(format!("no master writes {} of {}", name.is, spec.kind)));
        };
        if named.word.is_some() {
            return Err(name.wrong(format!("register takes a whole register: {}, not {}", row.name, name.is)));
        }
        let value = when.whole("value", i64::MIN, i64::MAX)?;
        if let Some(value) = &value {
            let never = |why| value.wrong(format!("{} never has the value {}: {why}", row.name, value.is));
            check_value(spec, (named.row, row), value.is).map_err(never)?;
        }
        let value = value.map(|value| value.is);
        Ok(Written { drive: DriveId(drive as u32), row: named.row, value })
    }

    fn action(&self, table: &Table<'_>) -> Result<Action, LocatedError> {
        let Some(key) = table.any_of(&ACTIONS.map(|(action, _)| action)) else {
            let names = ACTIONS.map(|(action, _)| action).join(", ");
            return Err(LocatedError { at: table.at, what: format!("a step needs an action: {names}") });
        };
        let subject = ACTIONS.iter().find(|(action, _)| *action == key.is).map_or("", |(_, subject)| subject);
        let belongs = |other: &str| {
            ["at_s", "after_ms", "when", subject, key.is].contains(&other)
                || (key.is, other) == ("pulses", "hz")
        };
        if let Some(other) = table.keys().into_iter().find(|other| !belongs(other.is)) {
            return Err(other.wrong(format!("a step with '{}' takes no '{}'", key.is, other.is)));
        }
        let name = table.needed_text(subject)?;
        match subject {
            "bus" => {
                let line = self.line_named(name.is).map_err(LocatedError::at(name.at))?;
                let faults = table.needs("faults", table.table("faults", &line_fault_keys())?)?;
                let faults = Box::new(self.line_faults(&faults, line)?);
                Ok(Action::LineFaults { bus: self.name_of(line), faults })
            }
            "drive" => {
                let drive = self.drive_at(&name)?;
                let (spec, value) = (self.spec(drive), table.needed_text(key.is)?);
                let drive = DriveId(drive as u32);
                if key.is == "power" {
                    let action = power(value.is).map_err(LocatedError::at(value.at))?;
                    return Ok(Action::Power { drive, action });
                }
                let fault = find_fault(spec, value.is).map_err(LocatedError::at(value.at))?;
                Ok(Action::Fault { drive, fault, on: key.is == "fault" })
            }
            _ => self.pin_action(table, &key, &name),
        }
    }

    fn pin_action(
        &self,
        table: &Table<'_>,
        key: &Located<&str>,
        name: &Located<&str>,
    ) -> Result<Action, LocatedError> {
        let (drive, pin) = self.input(name)?;
        let spec = self.spec(drive);
        let role = spec.pins.get(usize::from(pin.0)).map_or(Role::Input, |pin| pin.role);
        let drive = DriveId(drive as u32);
        let takes_levels = role != Role::Analogue;
        let takes_volts = matches!(role, Role::Analogue | Role::AnalogueOrDigital);
        let stimulus = match key.is {
            "volts" if !takes_volts => return Err(key.wrong(format!("{} takes a level, not volts", name.is))),
            "volts" => {
                let volts = table.needs("volts", table.number("volts", -1_000.0, 1_000.0)?)?;
                PinStimulus::Millivolts((volts.is * 1e3).round() as i32)
            }
            "level" => {
                let level = table.needed_text("level")?;
                match level.is {
                    "open" => PinStimulus::Open,
                    "low" | "high" if !takes_levels => {
                        return Err(level.wrong(format!("{} takes volts, or the level open", name.is)));
                    }
                    "low" => PinStimulus::Low,
                    "high" => PinStimulus::High,
                    other => return Err(level.wrong(format!("level takes low, high or open, not '{other}'"))),
                }
            }
            _ if !takes_levels => return Err(key.wrong(format!("{} takes no pulses", name.is))),
            _ => {
                let count = table.needs("pulses", table.whole("pulses", 1, u32::MAX)?)?.is;
                let hz = table.needs("hz", table.number("hz", *PULSE_HZ.start(), *PULSE_HZ.end())?)?.is;
                return Ok(Action::Pulses { drive, pin, count, hz });
            }
        };
        Ok(Action::Pin { drive, pin, stimulus })
    }

    fn drive_at(&self, name: &Located<&str>) -> Result<usize, LocatedError> {
        self.emulated(name.is, reasons::NO_SCENARIO).map_err(LocatedError::at(name.at))
    }
}

/// Checks that a request of a master can write a value to a row.
///
/// # Errors
/// The reason why the drive never accepts such a request.
fn check_value(spec: &Spec, (index, row): (usize, &Row), value: i64) -> Result<(), String> {
    if let Shape::Words(count) = row.shape {
        return Err(format!("it has {count} words, so 'value' cannot name them"));
    }
    let Writes { language, refuses } = spec.writes.unwrap_or(&Writes::OF_ROWS);
    match language(index) {
        Some(range) if range.contains(&value) => Ok(()),
        _ if refuses(index, value) => Err(format!("{} refuses it", spec.kind)),
        _ if row.accepts(value) => Ok(()),
        Some(range) => Err(format!("{}, in MCode {} to {}", legal(row), range.start(), range.end())),
        None => Err(legal(row)),
    }
}

/// Ticks in a second.
const SECOND: f64 = Duration::secs(1).ticks() as f64;

fn ticks(seconds: f64) -> Duration {
    Duration::from_ticks((seconds * SECOND).round() as u64)
}

fn power(text: &str) -> Result<PowerAction, String> {
    match text {
        "off" => Ok(PowerAction::Off),
        "on" => Ok(PowerAction::On),
        "cycle" => Ok(PowerAction::Cycle),
        "cut" => Ok(PowerAction::Cut),
        _ => Err(format!("power takes off, on, cycle or cut, not '{text}'")),
    }
}

/// The fault of a kind with that name.
pub(super) fn find_fault(spec: &Spec, name: &str) -> Result<Fault, String> {
    let index = spec.faults.iter().position(|known| *known == name);
    let unknown = || suggest::unknown(&format!("fault of {}", spec.kind), name, spec.faults.iter().copied());
    index.map(|index| Fault(index as u8)).ok_or_else(unknown)
}
