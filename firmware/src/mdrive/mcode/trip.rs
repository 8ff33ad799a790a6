//! Trips: inputs, positions, times and the Hybrid's state call subroutines (MC 5-71 to 5-76).

use core::ops::RangeInclusive;

use heapless::Vec;

use super::super::drive::Drive;
use super::super::error::Error;
use super::super::io;
use super::super::reasons::{Why, report};
use super::super::registers::Reg;
use super::statement::{Operand, Parameter, Place, Trip};
use crate::device::{Context, Duration, Instant};

/// Minimum time between two trips of TR, for 20 kHz (MC 5-75). A trip that is earlier waits.
const FASTEST: Duration = Duration::micros(50);

/// Maximum number of repetitions of TR (MC 5-75).
const MAX_REPEATS: u16 = 65_000;

/// Types that are outputs: of I/O 1 to 4 (MC 5-64), and of I/O 13 (MC 5-67).
const OUTPUTS: RangeInclusive<u16> = 16..=25;
const TRIP_OUTPUT: u16 = 61;

/// All trips, in the order of their bits in TE.
const ALL: [Trip; 6] = [Trip::Input, Trip::Position, Trip::Capture, Trip::Time, Trip::Relative, Trip::Hybrid];

impl Trip {
    /// Bit of this trip in TE.
    pub(super) fn bit(self) -> u8 {
        1 << self as u8
    }
}

/// Definition of a trip: its condition and its action.
#[derive(Clone, Copy, Debug)]
struct Definition {
    /// Depends on the trip: an input, a position, a time in ms, a distance, or flags.
    value: i32,
    subroutine: Option<Place>,
    /// TR: number of repetitions, 0 for no limit.
    repeats: u16,
}

/// All trips.
#[derive(Clone, Debug)]
pub(in crate::mdrive) struct Trips {
    definitions: [Option<Definition>; ALL.len()],
    enabled: u8,
    captured: i32,
    /// Time at which motion reaches the position of TP, if the plan does not change.
    position_due: Instant,
    time_due: Instant,
    /// TR: time and position of the next trip, repetitions left, and the earliest time for the trip.
    relative_due: Instant,
    relative_position: i32,
    repeats_left: u16,
    relative_not_before: Instant,
}

impl Trips {
    pub(in crate::mdrive) const NONE: Self = Self {
        definitions: [None; ALL.len()],
        enabled: 0,
        captured: 0,
        position_due: Instant::NEVER,
        time_due: Instant::NEVER,
        relative_due: Instant::NEVER,
        relative_position: 0,
        repeats_left: 0,
        relative_not_before: Instant::ZERO,
    };

    /// Enabled trips (TE), one bit each.
    pub(in crate::mdrive) fn enabled(&self) -> u8 {
        self.enabled
    }

    /// PC: the position at the last trip, except trips of TP.
    pub(in crate::mdrive) fn captured(&self) -> i32 {
        self.captured
    }

    /// Parameters of a trip for printing: as they were defined, or zeros.
    pub(in crate::mdrive) fn parameters(&self, trip: Trip) -> Vec<Parameter, 3> {
        let number = |number| Parameter::Value(Operand::Number(number));
        let definition = self.definition(trip);
        let (value, repeats) = definition.map_or((0, 0), |it| (it.value, it.repeats));
        let subroutine = match definition.and_then(|it| it.subroutine) {
            None => number(0),
            Some(Place::Address(address)) => number(address),
            Some(Place::Label(name)) => Parameter::Label(name),
        };
        let all = [number(value), subroutine, number(repeats.into())];
        all.get(trip.parameters()).and_then(|shown| Vec::from_slice(shown).ok()).unwrap_or_default()
    }

    /// Time of the next trip, if the plan does not change.
    pub(in crate::mdrive) fn deadline(&self) -> Instant {
        self.position_due.min(self.time_due).min(self.relative_due)
    }

    /// Subroutine of the trip with this bit.
    pub(super) fn subroutine(&self, bit: u8) -> Option<Place> {
        let trip = ALL.into_iter().find(|trip| trip.bit() == bit)?;
        self.definition(trip)?.subroutine
    }

    fn definition(&self, trip: Trip) -> Option<Definition> {
        self.definitions.get(trip as usize).copied().flatten()
    }

    /// Condition of a trip, if the trip is enabled.
    fn value(&self, trip: Trip) -> Option<i32> {
        let definition = self.definition(trip)?;
        (self.enabled & trip.bit() != 0).then_some(definition.value)
    }

    fn switch_off(&mut self, trip: Trip) {
        self.enabled &= !trip.bit();
        match trip {
            Trip::Position => self.position_due = Instant::NEVER,
            Trip::Time => self.time_due = Instant::NEVER,
            Trip::Relative => self.relative_due = Instant::NEVER,
            Trip::Input | Trip::Capture | Trip::Hybrid => {}
        }
    }
}

impl Drive {
    /// Defines a trip; 0 removes its definition. A trip that is enabled starts again.
    ///
    /// # Errors
    /// Error 12 for a source that is not an input, 21 for another illegal value, 30 and 42 for a wrong
    /// subroutine, 38 for a missing one; nothing has changed then.
    pub(in crate::mdrive) fn define_trip(
        &mut self,
        at: Instant,
        trip: Trip,
        parameters: &[Parameter],
    ) -> Result<(), Error> {
        let definition = self.trip_definition(at, trip, parameters)?;
        let trips = &mut self.mcode.trips;
        let is_on = trips.value(trip).is_some();
        if let Some(place) = trips.definitions.get_mut(trip as usize) {
            *place = definition;
        }
        match definition {
            None => trips.switch_off(trip),
            Some(_) if is_on => self.arm(at, trip),
            Some(_) => {}
        }
        Ok(())
    }

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
            (_, Some(place)) => self.find_line(place).map(|_| Some(place))?,
        };
        let repeats = self.trip_number(at, repeats)?.unwrap_or(0);
        let repeats = u16::try_from(repeats).ok().filter(|&repeats| repeats <= MAX_REPEATS);
        let repeats = repeats.ok_or(Error::IllegalValue)?;
        self.judge_source(trip, value)?;
        Ok(Some(Definition { value, subroutine, repeats }))
    }

    /// Checks that the source of a trip is an input.
    ///
    /// # Errors
    /// Error 12: the source is an output.
    fn judge_source(&self, trip: Trip, value: i32) -> Result<(), Error> {
        let set_up = match (trip, value) {
            (Trip::Input, 1) => Reg::S1,
            (Trip::Input, 2) => Reg::S2,
            (Trip::Input, 3) => Reg::S3,
            (Trip::Input, 4) => Reg::S4,
            (Trip::Capture, _) => Reg::S13,
            _ => return Ok(()),
        };
        let [kind, ..] = self.bank.set_up_of(set_up);
        if OUTPUTS.contains(&kind) || kind == TRIP_OUTPUT { Err(Error::IllegalTrip) } else { Ok(()) }
    }

    fn trip_number(&mut self, at: Instant, parameter: Parameter) -> Result<Option<i32>, Error> {
        match parameter {
            Parameter::Absent => Ok(None),
            Parameter::Value(operand) => self.operand(at, operand).map(Some),
            Parameter::Label(name) => self.operand(at, Operand::User(name)).map(Some),
        }
    }

    /// Writes TE: enables trips, or disables all of them with 0. A trip that is already enabled continues:
    /// "only the activated trip function needs to be re-enabled, the other trips will still be enabled" (MC
    /// 5-73).
    ///
    /// # Errors
    /// Error 12 for a source that is not an input, 21 above 63, 27 for a trip that is not defined, 39 for 2
    /// and 16 together; nothing has changed then.
    pub(in crate::mdrive) fn enable_trips(
        &mut self,
        at: Instant,
        mask: u8,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        self.validate_trips(mask.into())?;
        let trips = &mut self.mcode.trips;
        if mask == 0 {
            ALL.into_iter().for_each(|trip| trips.switch_off(trip));
        }
        let before = trips.enabled;
        trips.enabled |= mask;
        let is_exact = mask == trips.enabled;
        report(if is_exact { Ok(()) } else { Err(Why::AddsTrips) }, at, out);
        for trip in ALL.into_iter().filter(|trip| mask & !before & trip.bit() != 0) {
            self.arm(at, trip);
        }
        Ok(())
    }

    /// Checks that TE may have this value.
    ///
    /// # Errors
    /// As [`Self::enable_trips`].
    pub(in crate::mdrive) fn validate_trips(&self, mask: i32) -> Result<(), Error> {
        let both = i32::from(Trip::Position.bit() | Trip::Relative.bit());
        if !(0..1 << ALL.len()).contains(&mask) {
            return Err(Error::IllegalValue);
        }
        for trip in ALL.into_iter().filter(|trip| mask & i32::from(trip.bit()) != 0) {
            let definition = self.mcode.trips.definition(trip).ok_or(Error::TripNotDefined)?;
            self.judge_source(trip, definition.value)?;
        }
        let on = mask | i32::from(self.mcode.trips.enabled);
        if mask != 0 && on & both == both { Err(Error::TripsTogether) } else { Ok(()) }
    }

    /// Handles an event of the I/O that may cause a trip.
    pub(in crate::mdrive) fn trip_on(&mut self, at: Instant, event: io::Event, out: &mut dyn Context) {
        match event {
            io::Event::Active(n) if self.mcode.trips.value(Trip::Input) == Some(n.into()) => {
                self.trip(at, Trip::Input, out);
            }
            io::Event::Capture if self.mcode.trips.value(Trip::Capture).is_some() => {
                self.trip(at, Trip::Capture, out);
            }
            _ => {}
        }
    }

    /// Returns true if TA trips on one of these conditions of the Hybrid, given as bits of TA.
    pub(in crate::mdrive) fn trips_on_status(&self, flags: u8) -> bool {
        self.mcode.trips.value(Trip::Hybrid).is_some_and(|wanted| wanted & i32::from(flags) != 0)
    }

    /// Trips TA if one of these conditions is selected. They have just become true and are given as bits of
    /// TA.
    pub(in crate::mdrive) fn trip_on_status(&mut self, at: Instant, flags: u8, out: &mut dyn Context) {
        if self.trips_on_status(flags) {
            self.trip(at, Trip::Hybrid, out);
        }
    }

    /// Trips TP if steps of the clock inputs have reached or passed its position, beginning at `from`. No
    /// plan contains these steps, so the time of TP was not predicted.
    pub(in crate::mdrive) fn trip_on_steps(&mut self, at: Instant, from: i32, out: &mut dyn Context) {
        let Some(position) = self.mcode.trips.value(Trip::Position) else { return };
        let (way, made) = (position.wrapping_sub(from), self.motion.steps(at).wrapping_sub(from));
        if way != 0 && way.signum() == made.signum() && way.unsigned_abs() <= made.unsigned_abs() {
            self.trip(at, Trip::Position, out);
        }
    }

    /// Handles a change of the plan, or a trip that is due.
    pub(in crate::mdrive) fn check_trips(&mut self, at: Instant, out: &mut dyn Context) {
        let trips = &self.mcode.trips;
        let dues = [
            (Trip::Position, trips.position_due),
            (Trip::Time, trips.time_due),
            (Trip::Relative, trips.relative_due),
        ];
        for (trip, _) in dues.into_iter().filter(|&(_, due)| due <= at) {
            // The shaft may have changed its motion since the prediction.
            if trip != Trip::Relative || self.is_at_relative(at) {
                self.trip(at, trip, out);
            }
        }
        self.predict_position(at);
        self.predict_relative(at);
    }

    /// Returns true if TR depends on the encoder's count. Then everything that turns the shaft changes the
    /// time of TR.
    pub(in crate::mdrive) fn trips_on_counts(&self) -> bool {
        self.mcode.trips.value(Trip::Relative).is_some() && self.bank.word(Reg::EE) != 0
    }

    /// Arms a trip that has been enabled.
    fn arm(&mut self, at: Instant, trip: Trip) {
        let Some(Definition { value, repeats, .. }) = self.mcode.trips.definition(trip) else { return };
        match trip {
            Trip::Position => self.predict_position(at),
            Trip::Time => {
                let ms = u64::try_from(value).unwrap_or(0);
                self.mcode.trips.time_due = at + Duration::millis(ms);
            }
            Trip::Relative => {
                let position = self.read(at, Reg::P);
                let trips = &mut self.mcode.trips;
                (trips.relative_position, trips.repeats_left) = (position, repeats);
                trips.relative_not_before = at;
                self.aim_relative(at);
            }
            Trip::Input | Trip::Capture | Trip::Hybrid => {}
        }
    }

    /// Predicts the time of TP. TP uses motor steps even with EE = 1 (MC 5-74).
    fn predict_position(&mut self, at: Instant) {
        if let Some(position) = self.mcode.trips.value(Trip::Position) {
            self.mcode.trips.position_due = self.motion.reaches_steps(at, position);
        }
    }

    /// Sets the next position of TR.
    fn aim_relative(&mut self, at: Instant) {
        if let Some(distance) = self.mcode.trips.value(Trip::Relative) {
            let trips = &mut self.mcode.trips;
            trips.relative_position = trips.relative_position.wrapping_add(distance);
            self.predict_relative(at);
        }
    }

    /// Makes a TR without a limit of repetitions skip positions that P has already passed. Trips faster than
    /// [`FASTEST`], or skipped by a write of P, are lost.
    fn skip_missed(&mut self, at: Instant) {
        let (position, distance) =
            (self.read(at, Reg::P), self.mcode.trips.value(Trip::Relative).unwrap_or(0));
        if self.is_at_relative(at) {
            let trips = &mut self.mcode.trips;
            let behind = position.wrapping_sub(trips.relative_position);
            let missed = behind.checked_div(distance).unwrap_or(0).wrapping_add(1);
            trips.relative_position = trips.relative_position.wrapping_add(distance.wrapping_mul(missed));
            self.predict_relative(at);
        }
    }

    /// Predicts the time of TR, which uses the unit of P (MC 5-75). It is not before [`FASTEST`] has passed;
    /// if P has passed the position by then, TR trips at that time.
    fn predict_relative(&mut self, at: Instant) {
        if self.mcode.trips.value(Trip::Relative).is_some() {
            let is_there = self.is_at_relative(at);
            let trips = &mut self.mcode.trips;
            let due = if is_there { at } else { self.motion.reaches(at, trips.relative_position) };
            trips.relative_due = due.max(trips.relative_not_before);
        }
    }

    /// Returns true if P has reached or passed the position of TR.
    fn is_at_relative(&self, at: Instant) -> bool {
        let ahead = self.mcode.trips.relative_position.wrapping_sub(self.read(at, Reg::P));
        let distance = self.mcode.trips.value(Trip::Relative).unwrap_or(0);
        ahead == 0 || (ahead < 0) == (distance > 0)
    }

    /// Makes a trip: captures P, makes a pulse, and calls the subroutine.
    fn trip(&mut self, at: Instant, trip: Trip, out: &mut dyn Context) {
        if trip != Trip::Position {
            self.mcode.trips.captured = self.read(at, Reg::P);
        }
        if matches!(trip, Trip::Position | Trip::Relative) {
            self.io.pulse(at, out);
        }
        let trips = &mut self.mcode.trips;
        let repeats_for_ever = trips.repeats_left == 0;
        if trip == Trip::Relative && trips.repeats_left != 1 {
            trips.repeats_left = trips.repeats_left.saturating_sub(1);
            trips.relative_not_before = at + FASTEST;
            self.aim_relative(at);
            if repeats_for_ever {
                self.skip_missed(at);
            }
        } else {
            trips.switch_off(trip);
        }
        if self.mcode.trips.subroutine(trip.bit()).is_some() {
            self.call_trip(at, trip, out);
        }
    }
}
