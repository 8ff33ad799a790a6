//! Trips: inputs, positions, times and the Hybrid's state call subroutines (MC 5-71 to 5-76).

use core::ops::RangeInclusive;

use heapless::Vec;

use super::super::error::Error;
use super::super::io;
use super::super::motion::Shaft;
use super::super::reasons::Why;
use super::super::registers::Reg;
use super::super::variables::Registers;
use super::operand::{Operand, Parameter, Place, Trip};
use crate::device::{Duration, Instant};

/// Minimum time between two trips of TR, for 20 kHz (MC 5-75). A trip that is earlier waits.
const FASTEST: Duration = Duration::micros(50);

/// Maximum number of repetitions of TR (MC 5-75).
pub(in crate::mdrive) const MAX_REPEATS: u16 = 65_000;

/// Types that are outputs: of I/O 1 to 4 (MC 5-64), and of I/O 13 (MC 5-67).
const OUTPUTS: RangeInclusive<u16> = 16..=25;
const TRIP_OUTPUT: u16 = 61;

/// All trips, in the order of their bits in TE.
const ALL: [Trip; 6] = [Trip::Input, Trip::Position, Trip::Capture, Trip::Time, Trip::Relative, Trip::Hybrid];

impl Trip {
    /// Bit of this trip in TE.
    pub(in crate::mdrive) fn bit(self) -> u8 {
        1 << self as u8
    }

    /// The first trip with one of these bits.
    pub(super) fn first(bits: u8) -> Option<Self> {
        ALL.into_iter().find(|trip| bits & trip.bit() != 0)
    }

    /// Returns true if the trip makes a pulse at the trip output.
    pub(in crate::mdrive) fn pulses(self) -> bool {
        matches!(self, Self::Position | Self::Relative)
    }
}

/// Definition of a trip: its condition and its action.
#[derive(Clone, Copy, Debug)]
pub(in crate::mdrive) struct Definition {
    /// Depends on the trip: an input, a position, a time in ms, a distance, or flags.
    pub(in crate::mdrive) value: i32,
    pub(in crate::mdrive) subroutine: Option<Place>,
    /// TR: number of repetitions, 0 for no limit.
    pub(in crate::mdrive) repeats: u16,
}

/// Trips that have just been made, one bit each as in TE. The drive makes their pulses and calls their subroutines.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[must_use]
pub(in crate::mdrive) struct Made(u8);

impl Made {
    const NONE: Self = Self(0);

    /// The trips, in the order of their bits.
    pub(in crate::mdrive) fn trips(self) -> impl Iterator<Item = Trip> {
        ALL.into_iter().filter(move |trip| self.0 & trip.bit() != 0)
    }
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

    /// Subroutine of a trip.
    pub(in crate::mdrive) fn subroutine(&self, trip: Trip) -> Option<Place> {
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

    /// Defines a trip; `None` removes its definition. A trip that is enabled starts again.
    pub(in crate::mdrive) fn define(
        &mut self,
        at: Instant,
        trip: Trip,
        definition: Option<Definition>,
        shaft: &Shaft,
    ) {
        let is_on = self.value(trip).is_some();
        if let Some(place) = self.definitions.get_mut(trip as usize) {
            *place = definition;
        }
        match definition {
            None => self.switch_off(trip),
            Some(_) if is_on => self.arm(at, trip, shaft),
            Some(_) => {}
        }
    }

    /// Writes TE: enables trips, or disables all of them with 0. A trip that is already enabled continues:
    /// "only the activated trip function needs to be re-enabled, the other trips will still be enabled" (MC
    /// 5-73).
    ///
    /// # Errors
    /// Error 12 for a source that is not an input, 21 above 63, 27 for a trip that is not defined, 39 for 2
    /// and 16 together; nothing has changed then. The inner error is the reason why other trips are enabled, too.
    pub(in crate::mdrive) fn enable(
        &mut self,
        at: Instant,
        mask: u8,
        registers: &Registers,
        shaft: &Shaft,
    ) -> Result<Result<(), Why>, Error> {
        self.validate(mask.into(), registers)?;
        if mask == 0 {
            ALL.into_iter().for_each(|trip| self.switch_off(trip));
        }
        let before = self.enabled;
        self.enabled |= mask;
        for trip in ALL.into_iter().filter(|trip| mask & !before & trip.bit() != 0) {
            self.arm(at, trip, shaft);
        }
        Ok(if mask == self.enabled { Ok(()) } else { Err(Why::AddsTrips) })
    }

    /// Checks that TE may have this value.
    ///
    /// # Errors
    /// Those of [`Self::enable`].
    pub(in crate::mdrive) fn validate(&self, mask: i32, registers: &Registers) -> Result<(), Error> {
        let both = i32::from(Trip::Position.bit() | Trip::Relative.bit());
        if !(0..1 << ALL.len()).contains(&mask) {
            return Err(Error::IllegalValue);
        }
        for trip in ALL.into_iter().filter(|trip| mask & i32::from(trip.bit()) != 0) {
            let definition = self.definition(trip).ok_or(Error::TripNotDefined)?;
            judge_source(trip, definition.value, registers)?;
        }
        let on = mask | i32::from(self.enabled);
        if mask != 0 && on & both == both { Err(Error::TripsTogether) } else { Ok(()) }
    }

    /// Handles an event of the I/O that may cause a trip.
    pub(in crate::mdrive) fn on_io_event(&mut self, at: Instant, event: io::Event, shaft: &Shaft) -> Made {
        match event {
            io::Event::Active(n) if self.value(Trip::Input) == Some(n.into()) => {
                self.trip(at, Trip::Input, shaft)
            }
            io::Event::Capture if self.value(Trip::Capture).is_some() => self.trip(at, Trip::Capture, shaft),
            _ => Made::NONE,
        }
    }

    /// Returns true if TA trips on one of these conditions of the Hybrid, given as bits of TA.
    pub(in crate::mdrive) fn is_on_status(&self, flags: u8) -> bool {
        self.value(Trip::Hybrid).is_some_and(|wanted| wanted & i32::from(flags) != 0)
    }

    /// Trips TA if one of these conditions is selected. They have just become true and are given as bits of
    /// TA.
    pub(in crate::mdrive) fn on_status(&mut self, at: Instant, flags: u8, shaft: &Shaft) -> Made {
        if self.is_on_status(flags) { self.trip(at, Trip::Hybrid, shaft) } else { Made::NONE }
    }

    /// Trips TP if steps of the clock inputs have reached or passed its position, beginning at `from`. No
    /// plan contains these steps, so the time of TP was not predicted.
    pub(in crate::mdrive) fn on_steps(&mut self, at: Instant, from: i32, shaft: &Shaft) -> Made {
        let Some(position) = self.value(Trip::Position) else { return Made::NONE };
        let (way, made) = (position.wrapping_sub(from), shaft.steps(at).wrapping_sub(from));
        if way != 0 && way.signum() == made.signum() && way.unsigned_abs() <= made.unsigned_abs() {
            self.trip(at, Trip::Position, shaft)
        } else {
            Made::NONE
        }
    }

    /// Handles a change of the plan, or a trip that is due.
    pub(in crate::mdrive) fn check(&mut self, at: Instant, shaft: &Shaft) -> Made {
        let dues = [
            (Trip::Position, self.position_due),
            (Trip::Time, self.time_due),
            (Trip::Relative, self.relative_due),
        ];
        let mut made = Made::NONE;
        for (trip, _) in dues.into_iter().filter(|&(_, due)| due <= at) {
            // The shaft may have changed its motion since the prediction.
            if trip != Trip::Relative || self.is_at_relative(at, shaft) {
                made.0 |= self.trip(at, trip, shaft).0;
            }
        }
        self.predict_position(at, shaft);
        self.predict_relative(at, shaft);
        made
    }

    /// Returns true if TR depends on the encoder's count. Then everything that turns the shaft changes the
    /// time of TR.
    pub(in crate::mdrive) fn is_on_counts(&self, shaft: &Shaft) -> bool {
        self.value(Trip::Relative).is_some() && shaft.is_closed()
    }

    /// Arms a trip that has been enabled.
    fn arm(&mut self, at: Instant, trip: Trip, shaft: &Shaft) {
        let Some(Definition { value, repeats, .. }) = self.definition(trip) else { return };
        match trip {
            Trip::Position => self.predict_position(at, shaft),
            Trip::Time => {
                let ms = u64::try_from(value).unwrap_or(0);
                self.time_due = at + Duration::millis(ms);
            }
            Trip::Relative => {
                let position = shaft.displayed_position(at);
                (self.relative_position, self.repeats_left) = (position, repeats);
                self.relative_not_before = at;
                self.aim_relative(at, shaft);
            }
            Trip::Input | Trip::Capture | Trip::Hybrid => {}
        }
    }

    /// Predicts the time of TP. TP uses motor steps even with EE = 1 (MC 5-74).
    fn predict_position(&mut self, at: Instant, shaft: &Shaft) {
        if let Some(position) = self.value(Trip::Position) {
            self.position_due = shaft.reaches_steps(at, position);
        }
    }

    /// Sets the next position of TR.
    fn aim_relative(&mut self, at: Instant, shaft: &Shaft) {
        if let Some(distance) = self.value(Trip::Relative) {
            self.relative_position = self.relative_position.wrapping_add(distance);
            self.predict_relative(at, shaft);
        }
    }

    /// Makes a TR without a limit of repetitions skip positions that P has already passed. Trips faster than
    /// [`FASTEST`], or skipped by a write of P, are lost.
    fn skip_missed(&mut self, at: Instant, shaft: &Shaft) {
        let (position, distance) = (shaft.displayed_position(at), self.value(Trip::Relative).unwrap_or(0));
        if self.is_at_relative(at, shaft) {
            let behind = position.wrapping_sub(self.relative_position);
            let missed = behind.checked_div(distance).unwrap_or(0).wrapping_add(1);
            self.relative_position = self.relative_position.wrapping_add(distance.wrapping_mul(missed));
            self.predict_relative(at, shaft);
        }
    }

    /// Predicts the time of TR, which uses the unit of P (MC 5-75). It is not before [`FASTEST`] has passed;
    /// if P has passed the position by then, TR trips at that time.
    fn predict_relative(&mut self, at: Instant, shaft: &Shaft) {
        if self.value(Trip::Relative).is_some() {
            let is_there = self.is_at_relative(at, shaft);
            let due = if is_there { at } else { shaft.reaches(at, self.relative_position) };
            self.relative_due = due.max(self.relative_not_before);
        }
    }

    /// Returns true if P has reached or passed the position of TR.
    fn is_at_relative(&self, at: Instant, shaft: &Shaft) -> bool {
        let ahead = self.relative_position.wrapping_sub(shaft.displayed_position(at));
        let distance = self.value(Trip::Relative).unwrap_or(0);
        ahead == 0 || (ahead < 0) == (distance > 0)
    }

    /// Makes a trip and captures P.
    fn trip(&mut self, at: Instant, trip: Trip, shaft: &Shaft) -> Made {
        if trip != Trip::Position {
            self.captured = shaft.displayed_position(at);
        }
        let repeats_for_ever = self.repeats_left == 0;
        if trip == Trip::Relative && self.repeats_left != 1 {
            self.repeats_left = self.repeats_left.saturating_sub(1);
            self.relative_not_before = at + FASTEST;
            self.aim_relative(at, shaft);
            if repeats_for_ever {
                self.skip_missed(at, shaft);
            }
        } else {
            self.switch_off(trip);
        }
        Made(trip.bit())
    }
}

/// Checks that the source of a trip is an input.
///
/// # Errors
/// Error 12: the source is an output.
pub(in crate::mdrive) fn judge_source(trip: Trip, value: i32, registers: &Registers) -> Result<(), Error> {
    let set_up = match (trip, value) {
        (Trip::Input, 1) => Reg::S1,
        (Trip::Input, 2) => Reg::S2,
        (Trip::Input, 3) => Reg::S3,
        (Trip::Input, 4) => Reg::S4,
        (Trip::Capture, _) => Reg::S13,
        _ => return Ok(()),
    };
    let [kind, ..] = registers.set_up_of(set_up);
    if OUTPUTS.contains(&kind) || kind == TRIP_OUTPUT { Err(Error::IllegalTrip) } else { Ok(()) }
}
