//! Tables of faults on lines and TCP ports.

use drivetwin_firmware::device::Duration;

use super::Reader;
use super::drive_tables::Line;
use super::table::{LocatedError, Table};
use crate::config::layout::FaultLayout;
use crate::ids::DriveId;
use crate::line::faults::{Amount, BAUDS, Direction, FaultRule, LONGEST_DELAY, LineFaults, Party};

/// The keys of every rule.
pub(super) const RULE: [&str; 6] = ["rate", "count", "direction", "drive", "function", "register"];

/// The keys of `[[fault]]`.
pub(super) fn fault_keys() -> Vec<&'static str> {
    [&["bus"], &line_fault_keys()[..]].concat()
}

/// The keys of `[[fault]]` without `bus`.
pub(super) fn line_fault_keys() -> Vec<&'static str> {
    let mut faults = LineFaults::NONE;
    let rules = faults.rules().map(|(name, _)| name);
    [&rules[..], &["exception_code", "delay_ms", "baud"]].concat()
}

/// Number of ticks in 1 ms.
const MILLI: f64 = Duration::millis(1).ticks() as f64;

/// Greatest delay in ms.
const MOST_MS: f64 = LONGEST_DELAY.ticks() as f64 / MILLI;

impl Reader {
    pub(super) fn fault(&mut self, table: &Table<'_>) -> Result<(), LocatedError> {
        let bus = table.needed_text("bus")?;
        let line = self.line_named(bus.is).map_err(LocatedError::at(bus.at))?;
        let name = self.name_of(line);
        if self.layout.faults.iter().any(|other| other.bus == name) {
            return Err(bus.wrong(format!("'{name}' has a [[fault]] already")));
        }
        let faults = self.line_faults(table, line)?;
        self.layout.faults.push(FaultLayout { bus: name, faults });
        Ok(())
    }

    /// Reads the faults of a line or TCP port.
    pub(super) fn line_faults(&self, table: &Table<'_>, line: Line) -> Result<LineFaults, LocatedError> {
        let parties = self.parties(line);
        let mut faults = LineFaults::NONE;
        if let Some(code) = table.whole("exception_code", 1, u8::MAX)? {
            faults.exception_code = code.is;
        }
        let (mut code, mut noise_before) = (faults.exception_code, false);
        for (name, rule) in faults.rules() {
            let extra: &[&str] = match name {
                "exception" => &["code"],
                "noise" => &["before"],
                _ => &[],
            };
            if let Some(keys) = rule_table(table, name, extra)? {
                *rule = read_rule(&keys, &parties)?;
                code = keys.whole("code", 1, u8::MAX)?.map_or(code, |code| code.is);
                noise_before |= keys.flag("before")?.is_some_and(|before| before.is);
            } else if name == "mute" && table.is_flag(name) {
                let on = table.flag(name)?.is_some_and(|on| on.is);
                *rule = if on { FaultRule::ALL } else { FaultRule::NONE };
            } else {
                *rule = table.number(name, 0.0, 1.0)?.map_or(FaultRule::NONE, |rate| rate.is.into());
            }
        }
        (faults.exception_code, faults.noise_before) = (code, noise_before);
        read_delay(table, &mut faults, &parties)?;
        faults.baud = table.whole("baud", *BAUDS.start(), *BAUDS.end())?.map(|baud| baud.is);
        let at = |key| table.any_of(&[key]).map_or(table.at, |key| key.at);
        if let Some(port) = self.port_of(line)
            && let Some((key, what)) = faults.impossible_on(port)
        {
            return Err(LocatedError { at: at(key), what });
        }
        faults.check().map_err(LocatedError::at(table.at))?;
        Ok(faults)
    }

    /// The drives on a line.
    fn parties(&self, line: Line) -> Vec<Party<'_>> {
        let indices: Vec<usize> = match line {
            Line::Shared(bus) => self.layout.buses[bus].drives.iter().map(|&(drive, _)| drive).collect(),
            Line::Own(drive, _) => vec![drive],
        };
        let party = |index: usize| Party {
            id: DriveId(index as u32),
            name: &self.layout.drives[index].name,
            spec: self.spec(index),
        };
        indices.into_iter().map(party).collect()
    }
}

/// The table of a fault with a rule; `None` if the key is missing or has a plain value.
fn rule_table<'a>(
    table: &Table<'a>,
    key: &'static str,
    extra: &[&str],
) -> Result<Option<Table<'a>>, LocatedError> {
    if !table.is_table(key) {
        return Ok(None);
    }
    table.table(key, &[&RULE, extra].concat())
}

/// Reads a rule. Without `rate` and `count` it covers every frame.
fn read_rule(keys: &Table<'_>, parties: &[Party<'_>]) -> Result<FaultRule, LocatedError> {
    let (rate, count) = (keys.number("rate", 0.0, 1.0)?, keys.whole("count", 0, u32::MAX)?);
    let amount = match (rate, count) {
        (Some(_), Some(count)) => {
            return Err(count.wrong("a fault takes rate or count, not both"));
        }
        (None, Some(count)) => Amount::Count(count.is),
        (rate, None) => Amount::Rate(rate.map_or(1.0, |rate| rate.is)),
    };
    let mut rule = FaultRule { amount, ..FaultRule::NONE };
    if let Some(direction) = keys.text("direction")? {
        rule.direction = Some(Direction::named(direction.is).map_err(LocatedError::at(direction.at))?);
    }
    rule.function = keys.whole("function", 1, 127)?.map(|function| function.is);
    if let Some(drive) = keys.text("drive")? {
        rule = rule.drive_named(drive.is, parties).map_err(LocatedError::at(drive.at))?;
    }
    if let Some(register) = keys.text("register")? {
        rule = rule.register_named(register.is, parties).map_err(LocatedError::at(register.at))?;
    }
    Ok(rule)
}

/// Reads `delay_ms`: a time, or a table.
fn read_delay(table: &Table<'_>, faults: &mut LineFaults, parties: &[Party<'_>]) -> Result<(), LocatedError> {
    let span = |ms: f64| Duration::from_ticks((ms * MILLI).round() as u64);
    let Some(keys) = rule_table(table, "delay_ms", &["ms", "spread_ms"])? else {
        let delay = table.number("delay_ms", 0.0, MOST_MS)?;
        faults.delay = delay.map_or(Duration::ZERO, |delay| span(delay.is));
        return Ok(());
    };
    faults.delayed = read_rule(&keys, parties)?;
    let ms = keys.needs("ms", keys.number("ms", 0.0, MOST_MS)?)?.is;
    faults.delay = span(ms);
    if let Some(spread) = keys.number("spread_ms", 0.0, MOST_MS - ms)? {
        faults.delay_spread = span(spread.is);
    }
    Ok(())
}
