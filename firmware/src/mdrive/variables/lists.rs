//! Variables of several values: I/O set-ups, trips, CA and MU.

use super::entry;
use crate::device::{Context, Instant};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::mcode::statement::{List, Operand, Parameter, Place, Trip};
use crate::mdrive::mcode::trip::{Definition, MAX_REPEATS, judge_source};
use crate::mdrive::registers::Reg;

impl Drive {
    /// Writes a variable of several values: S1 to S13, CA, MU, a trip. An omitted value after the first one
    /// is 0.
    ///
    /// # Errors
    /// Error 6, 8, 9, 11, 12, 21, 30, 38 or 39; nothing has changed then.
    pub(in crate::mdrive) fn write_list(
        &mut self,
        at: Instant,
        list: List,
        parameters: &[Parameter],
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        match list {
            List::Trip(trip) => {
                let definition = self.trip_definition(at, trip, parameters)?;
                self.mcode.trips.define(at, trip, definition, self.motion.shaft());
                Ok(())
            }
            List::Io(reg) => {
                let values = self.values(at, usize::from(entry(reg).shape.words()), parameters)?;
                self.set_up(at, reg, values, out)
            }
            List::With(reg) => {
                let [value, with, _] = self.values(at, 2, parameters)?;
                if with > 1 {
                    return Err(Error::IllegalValue);
                }
                self.write(at, reg, value.into(), out)?;
                match reg {
                    Reg::CA => self.bank.set(Reg::CalibrationMethod, with.into()),
                    // MCode clears the lag if the second value of MU is 1, as in `MU=2,1`.
                    Reg::MU if with == 1 => self.motion.shaft_mut().clear_lag(at),
                    _ => {}
                }
                Ok(())
            }
        }
    }

    /// Sets up an I/O point.
    ///
    /// # Errors
    /// Error 6, 8, 11 or 21; nothing has changed then.
    pub(in crate::mdrive) fn set_up(
        &mut self,
        at: Instant,
        reg: Reg,
        values: [u16; 3],
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let [kind, second, _] = values;
        if !self.bank.has_type(kind) {
            return Err(Error::IllegalType);
        }
        match reg {
            Reg::S1 => self.io.set_up(at, 1, values, out),
            Reg::S2 => self.io.set_up(at, 2, values, out),
            Reg::S3 => self.io.set_up(at, 3, values, out),
            Reg::S4 => self.io.set_up(at, 4, values, out),
            Reg::S5 => self.io.set_up_analogue(at, [kind, second]),
            Reg::S7 => self.io.set_up_clock(at, 7, [kind, second], out),
            Reg::S8 => self.io.set_up_clock(at, 8, [kind, second], out),
            Reg::S13 => self.io.set_up_capture(at, [kind, second], out),
            _ => Err(Error::IllegalIo),
        }?;
        let words = values.iter().take(usize::from(entry(reg).shape.words()));
        self.bank.set(reg, words.fold(0, |all, &word| all << 16 | i64::from(word)));
        if let Reg::S7 | Reg::S8 = reg {
            // The two points always have the same type (MC 5-66).
            let pair = if reg == Reg::S7 { Reg::S8 } else { Reg::S7 };
            let [_, active, _] = self.bank.set_up_of(pair);
            self.bank.set(pair, i64::from(kind) << 16 | i64::from(active));
        }
        self.set_motion(at, out);
        Ok(())
    }

    /// Definition of a trip by these parameters; `None` if they remove it.
    ///
    /// # Errors
    /// Error 12 for a source that is not an input, 21 for another illegal value, 30 and 42 for a wrong
    /// subroutine, 38 for a missing one.
    fn trip_definition(
        &mut self,
        at: Instant,
        trip: Trip,
        parameters: &[Parameter],
    ) -> Result<Option<Definition>, Error> {
        let mut all = [Parameter::Absent; 3];
        for (place, parameter) in all.iter_mut().skip(trip.parameters().start).zip(parameters) {
            *place = *parameter;
        }
        let [value, subroutine, repeats] = all;

        let value = self.trip_number(at, value)?;
        let value = match (trip, value) {
            (Trip::Input | Trip::Time | Trip::Relative | Trip::Hybrid, Some(0)) => return Ok(None),
            (Trip::Capture, _) => 0,
            (Trip::Position | Trip::Relative, Some(value))
            | (Trip::Input, Some(value @ 1..=4))
            | (Trip::Time, Some(value @ 1..=65_535))
            | (Trip::Hybrid, Some(value @ 1..=31)) => value,
            (Trip::Input, Some(_)) => return Err(Error::IllegalTrip),
            (_, Some(_)) => return Err(Error::IllegalValue),
            (_, None) => return Err(Error::MissingSeparator),
        };
        let place = match subroutine {
            Parameter::Absent => None,
            Parameter::Label(name) => Some(Place::Label(name)),
            Parameter::Value(operand) => Some(Place::Address(self.operand(at, operand)?)),
        };
        let subroutine = match (trip, place) {
            (Trip::Capture, Some(Place::Address(0))) => return Ok(None),
            // These trips may have no subroutine, because they make a pulse at the trip output.
            (Trip::Position | Trip::Relative, None | Some(Place::Address(0))) => None,
            (_, None) => return Err(Error::MissingSeparator),
            (_, Some(place)) => self.mcode.find_line(place).map(|_| Some(place))?,
        };
        let repeats = self.trip_number(at, repeats)?.unwrap_or(0);
        let repeats = u16::try_from(repeats).ok().filter(|&repeats| repeats <= MAX_REPEATS);
        let repeats = repeats.ok_or(Error::IllegalValue)?;
        judge_source(trip, value, &self.bank)?;
        Ok(Some(Definition { value, subroutine, repeats }))
    }

    fn trip_number(&mut self, at: Instant, parameter: Parameter) -> Result<Option<i32>, Error> {
        match parameter {
            Parameter::Absent => Ok(None),
            Parameter::Value(operand) => self.operand(at, operand).map(Some),
            Parameter::Label(name) => self.operand(at, Operand::User(name)).map(Some),
        }
    }

    /// Evaluates the values of a list, which has at most `count` of them. The first is required; others that
    /// are omitted are 0.
    fn values(&mut self, at: Instant, count: usize, parameters: &[Parameter]) -> Result<[u16; 3], Error> {
        if parameters.len() > count {
            return Err(Error::IllegalValue);
        }
        if matches!(parameters.first(), None | Some(Parameter::Absent)) {
            return Err(Error::IllegalData);
        }
        let mut values = [0; 3];
        for (value, &parameter) in values.iter_mut().zip(parameters) {
            let number = match parameter {
                Parameter::Absent => 0,
                Parameter::Value(operand) => self.operand(at, operand)?,
                Parameter::Label(name) => self.operand(at, Operand::User(name))?,
            };
            *value = u16::try_from(number).map_err(|_| Error::IllegalValue)?;
        }
        Ok(values)
    }
}
