//! Effects of writing variables, also of those with several values: I/O set-ups, trips, CA and MU.

use super::{divider, entry, output_bit, step, user_name};
use crate::device::{Context, Instant};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::hybrid::{Environment, set_motion};
use crate::mdrive::io::{self, Filters};
use crate::mdrive::mcode::operand::{List, Parameter};
use crate::mdrive::motion::{Contact, Order};
use crate::mdrive::reasons::{Why, report};
use crate::mdrive::registers::{Model, Reg, is_frequency, mcode_range};

impl Drive {
    /// Writes a variable: validates, then applies it.
    ///
    /// # Errors
    /// Error 21, 22, 23 or 25, or an error of the drive's state; nothing has changed then. The caller reports
    /// the error with [`Self::fail`].
    pub(in crate::mdrive) fn write(
        &mut self,
        at: Instant,
        reg: Reg,
        value: i32,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        self.reader(at).validate(reg, value, &|other| self.bank.stored(other))?;
        self.apply(at, reg, value, out)
    }

    /// Writes a variable as MCode does: SS and TS in Hz. The drive stores the divider whose frequency is
    /// nearest and not lower.
    ///
    /// # Errors
    /// Those of [`Self::write`].
    pub(in crate::mdrive) fn write_mcode(
        &mut self,
        at: Instant,
        reg: Reg,
        value: i32,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        if !is_frequency(reg) {
            return self.write(at, reg, value, out);
        }
        if !mcode_range(reg).is_some_and(|range| range.contains(&i64::from(value))) {
            return Err(Error::IllegalValue);
        }
        self.write(at, reg, divider(value), out)
    }

    /// Adds 1 or -1 to a variable (IC, DC); 1.000 or -1.000 to CR.
    ///
    /// # Errors
    /// Error 26 for a variable that cannot be counted, or an error of [`Self::write`].
    pub(in crate::mdrive) fn count(
        &mut self,
        at: Instant,
        reg: Reg,
        by: i32,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let value = self.reader(at).counted(reg, by, self.bank.stored(reg))?;
        self.write(at, reg, value, out)
    }

    /// Gives the motor a motion command: MA, MR, SL, HM or HI, from the bus or from MCode. The registers MA,
    /// MR, SL and HM keep the last value of each.
    ///
    /// # Errors
    /// Error 80, 81, 85, 88, 93: the drive's state forbids it; nothing has changed.
    pub(in crate::mdrive) fn order(
        &mut self,
        at: Instant,
        order: Order,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        self.hybrid.takes_orders()?;
        if matches!(order, Order::Home(_)) && self.io.contact(Contact::Home).is_none() {
            return Err(Error::NoHomeSwitch);
        }
        report(self.motion.order(at, order, out)?, at, out);
        if order != Order::Slew(0) {
            report(self.hybrid.needs_bridge(&self.bank), at, out);
        }
        self.mcode.vm.note_order(order);
        match order {
            Order::To { position, .. } => self.bank.set(Reg::MA, position.into()),
            Order::By { distance, .. } => self.bank.set(Reg::MR, distance.into()),
            Order::Slew(speed) => self.bank.set(Reg::SL, speed.into()),
            Order::Home(kind) => self.bank.set(Reg::HM, kind.into()),
            Order::HomeToIndex(_) => {}
        }
        Ok(())
    }

    /// Applies a write that has passed validation.
    ///
    /// # Errors
    /// Those that only motion, trips or the memory can find. Nothing has changed then.
    pub(in crate::mdrive) fn apply(
        &mut self,
        at: Instant,
        reg: Reg,
        value: i32,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let (notify_on_end, continuous) = (false, false);
        match reg {
            Reg::C1 => self.motion.shaft_mut().set_steps(at, value),
            Reg::C2 => self.motion.shaft_mut().set_counts(at, value),
            Reg::P if self.bank.is_closed() => self.motion.shaft_mut().set_counts(at, value),
            Reg::P => self.motion.shaft_mut().set_steps(at, value),
            Reg::ER => self.mcode.errors.put((value & 0xFF) as u8),
            Reg::IC | Reg::DC => {
                let counted = self.reader(at).counted_by_address(value)?;
                return self.count(at, counted, step(reg), out);
            }
            Reg::O1 | Reg::O2 | Reg::O3 | Reg::O4 => {
                let bit = output_bit(reg);
                self.write_outputs(at, bit, if value == 0 { 0 } else { bit }, out);
            }
            Reg::OL | Reg::OT => self.write_outputs(at, 0xF, value, out),
            Reg::IF => self.mcode.vm.set_input_pending(value != 0),
            Reg::ST => self.motion.set_stalled(value != 0),
            Reg::TE => {
                let mask = (value & 0xFF) as u8;
                report(self.mcode.trips.enable(at, mask, &self.bank, self.motion.shaft())?, at, out);
            }
            Reg::MA => return self.order(at, Order::To { position: value, notify_on_end, continuous }, out),
            Reg::MR => return self.order(at, Order::By { distance: value, notify_on_end, continuous }, out),
            Reg::SL => return self.order(at, Order::Slew(value), out),
            Reg::HM => return self.order(at, Order::Home((value & 0xFF) as u8), out),
            Reg::S => return self.save(at, out),
            Reg::CF => return self.calibrate_by_command(at, true, out),
            Reg::SC => return self.calibrate_by_command(at, false, out),
            _ => match user_name(reg) {
                Some(name) => return self.mcode.names.set(name, value),
                None => return self.set(at, reg, value, out),
            },
        }
        Ok(())
    }

    /// Stores a variable's value and applies it.
    fn set(&mut self, at: Instant, reg: Reg, value: i32, out: &mut dyn Context) -> Result<(), Error> {
        let calibrates = self.reader(at).calibrates(reg, value);
        let changes = value != self.bank.stored(reg);
        self.bank.store(reg, value);
        match reg {
            Reg::D5 | Reg::FC | Reg::FM | Reg::CW => self.set_filters(at, out),
            Reg::D1 | Reg::D2 | Reg::D3 | Reg::D4 | Reg::CM | Reg::CR => {
                self.set_filters(at, out);
                self.set_motion(at, out);
            }
            Reg::DE if self.bank.model() == Model::Plus => {
                self.hybrid.enable();
                self.set_motion(at, out);
            }
            _ => self.set_motion(at, out),
        }
        if calibrates && self.calibrate(at, false, out)? {
            report(Err(Why::Calibrates), at, out);
        }
        report(self.reader(at).has_effect(reg, changes), at, out);
        Ok(())
    }

    /// Starts a calibration, because of CF (`clears`) or anything else. Returns false if there is nothing to
    /// calibrate.
    ///
    /// # Errors
    /// In motion 94 for CF, 89 for the others.
    pub(in crate::mdrive) fn calibrate(
        &mut self,
        at: Instant,
        clears: bool,
        out: &mut dyn Context,
    ) -> Result<bool, Error> {
        let (registers, io, motion) = (&mut self.bank, &self.io, &mut self.motion);
        self.hybrid.calibrate(&mut Environment { at, registers, io, motion, out }, clears)
    }

    /// Executes SC, or CF if `clears` is true: starts a calibration.
    ///
    /// # Errors
    /// Those of [`Self::calibrate`].
    pub(in crate::mdrive) fn calibrate_by_command(
        &mut self,
        at: Instant,
        clears: bool,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let is_cleared = clears && self.hybrid.is_locked();
        let calibrates = self.calibrate(at, clears, out)?;
        report(if calibrates || is_cleared { Ok(()) } else { Err(Why::NothingToCalibrate) }, at, out);
        Ok(())
    }

    /// S: begins to save.
    ///
    /// # Errors
    /// Error 73 in motion.
    pub(in crate::mdrive) fn save(&mut self, at: Instant, out: &mut dyn Context) -> Result<(), Error> {
        if self.reader(at).is_in_motion() {
            return Err(Error::SaveInMotion);
        }
        self.saving.begin(at, &mut self.bank, &self.mcode.names, out);
        Ok(())
    }

    /// Passes the settings to motion.
    pub(in crate::mdrive) fn set_motion(&mut self, at: Instant, out: &mut dyn Context) {
        let is_disabled = self.hybrid.is_disabled();
        set_motion(at, &mut self.bank, &self.io, is_disabled, &mut self.motion, out);
    }

    /// Passes the settings to the I/O.
    pub(in crate::mdrive) fn set_filters(&mut self, at: Instant, out: &mut dyn Context) {
        self.io.set_filters(at, Filters::of(&self.bank), out);
    }

    /// Sets the points in `outputs`, one bit each, active or inactive by the same bits of `active`. Points that
    /// are not outputs are skipped.
    fn write_outputs(&mut self, at: Instant, outputs: i32, active: i32, out: &mut dyn Context) {
        let outputs = outputs & i32::from(self.io.outputs());
        for n in 1..=4 {
            let bit = 1 << (n - 1);
            if outputs & bit != 0 {
                // Cannot fail, because the point is an output.
                let _ = self.io.write(at, n, active & bit != 0, out);
            }
        }
    }

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
                let definition = self.read(at, |reader| reader.trip_definition(trip, parameters))?;
                self.mcode.trips.define(at, trip, definition, self.motion.shaft());
                Ok(())
            }
            List::Io(reg) => {
                let count = usize::from(entry(reg).shape.words());
                let values = self.read(at, |reader| reader.values(count, parameters))?;
                self.set_up(at, reg, values, out)
            }
            List::With(reg) => {
                let [value, with, _] = self.read(at, |reader| reader.values(2, parameters))?;
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
        if self.bank.model() == Model::Plus && io::is_of_hybrid(kind) {
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
}
