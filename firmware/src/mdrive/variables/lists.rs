//! Variables of several values: I/O set-ups, trips, CA and MU.

use super::entry;
use crate::device::{Context, Instant};
use crate::mdrive::drive::Drive;
use crate::mdrive::error::Error;
use crate::mdrive::mcode::statement::{List, Parameter};
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
}
