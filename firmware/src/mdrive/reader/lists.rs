//! Values of variables with several values: I/O set-ups, trips, CA and MU.

use super::Reader;
use crate::mdrive::error::Error;
use crate::mdrive::mcode::operand::{Operand, Parameter, Place, Trip};
use crate::mdrive::mcode::trip::{Definition, MAX_REPEATS, judge_source};

impl Reader<'_> {
    /// Definition of a trip by these parameters; `None` if they remove it.
    ///
    /// # Errors
    /// Error 12 for a source that is not an input, 21 for another illegal value, 30 and 42 for a wrong
    /// subroutine, 38 for a missing one.
    pub(in crate::mdrive) fn trip_definition(
        &mut self,
        trip: Trip,
        parameters: &[Parameter],
    ) -> Result<Option<Definition>, Error> {
        let mut all = [Parameter::Absent; 3];
        for (place, parameter) in all.iter_mut().skip(trip.parameters().start).zip(parameters) {
            *place = *parameter;
        }
        let [value, subroutine, repeats] = all;

        let value = self.trip_number(value)?;
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
            Parameter::Value(operand) => Some(Place::Address(self.operand(operand)?)),
        };
        let subroutine = match (trip, place) {
            (Trip::Capture, Some(Place::Address(0))) => return Ok(None),
            // These trips may have no subroutine, because they make a pulse at the trip output.
            (Trip::Position | Trip::Relative, None | Some(Place::Address(0))) => None,
            (_, None) => return Err(Error::MissingSeparator),
            (_, Some(place)) => self.mcode.find_line(place).map(|_| Some(place))?,
        };
        let repeats = self.trip_number(repeats)?.unwrap_or(0);
        let repeats = u16::try_from(repeats).ok().filter(|&repeats| repeats <= MAX_REPEATS);
        let repeats = repeats.ok_or(Error::IllegalValue)?;
        judge_source(trip, value, self.bank)?;
        Ok(Some(Definition { value, subroutine, repeats }))
    }

    fn trip_number(&mut self, parameter: Parameter) -> Result<Option<i32>, Error> {
        match parameter {
            Parameter::Absent => Ok(None),
            Parameter::Value(operand) => self.operand(operand).map(Some),
            Parameter::Label(name) => self.operand(Operand::User(name)).map(Some),
        }
    }

    /// Evaluates the values of a list, which has at most `count` of them. The first is required; others that
    /// are omitted are 0.
    pub(in crate::mdrive) fn values(
        &mut self,
        count: usize,
        parameters: &[Parameter],
    ) -> Result<[u16; 3], Error> {
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
                Parameter::Value(operand) => self.operand(operand)?,
                Parameter::Label(name) => self.operand(Operand::User(name))?,
            };
            *value = u16::try_from(number).map_err(|_| Error::IllegalValue)?;
        }
        Ok(values)
    }
}
