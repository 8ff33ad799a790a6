//! I/O 13: the capture input or the trip output (MC 5-67).

use super::super::CAPTURE;
use super::super::error::Error;
use super::point::flag;
use crate::debounce::Debounce;
use crate::device::{Context, Duration, Instant, Level, Output};

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Kind {
    Captures,
    Trips,
}

/// I/O 13.
#[derive(Clone, Copy, Debug)]
pub(super) struct HighSpeed {
    kind: Kind,
    active_high: bool,
    debounced: Debounce,
    driven: Level,
    /// End of the pulse; [`Instant::NEVER`] if there is none.
    ends: Instant,
}

impl HighSpeed {
    /// A capture input, active low, that nothing drives.
    pub(super) const OPEN: Self = Self {
        kind: Kind::Captures,
        active_high: false,
        debounced: Debounce::new(true),
        driven: Level::Float,
        ends: Instant::NEVER,
    };

    /// Restarts with the factory's settings. The level stays as it is.
    pub(super) fn restart(&mut self, at: Instant, out: &mut dyn Context) {
        self.put(at, Level::Float, out);
        *self = Self { debounced: self.debounced, ..Self::OPEN };
    }

    /// S13: type, active state.
    ///
    /// # Errors
    /// Error 8 for the type, 21 for the state.
    pub(super) fn set_up(
        &mut self,
        at: Instant,
        [kind, active_high]: [u16; 2],
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        let kind = match kind {
            60 => Kind::Captures,
            61 => Kind::Trips,
            _ => return Err(Error::IllegalType),
        };
        (self.kind, self.active_high) = (kind, flag(active_high)?);
        self.ends = Instant::NEVER;
        self.drive_pin(at, out);
        Ok(())
    }

    /// Sets the level of the pin. Returns true if the input captures now.
    pub(super) fn sample(&mut self, at: Instant, high: bool, min_time: Duration) -> bool {
        self.debounced.sample(at, high, min_time) && self.captures()
    }

    /// Makes a pulse of `width`, because a position has tripped, if this is a trip output.
    pub(super) fn pulse(&mut self, at: Instant, width: Duration, out: &mut dyn Context) {
        if self.kind == Kind::Trips {
            self.ends = at + width;
            self.drive_pin(at, out);
        }
    }

    pub(super) fn deadline(&self) -> Instant {
        self.debounced.due().min(self.ends)
    }

    /// Handles the deadline. Returns true if the input captures now.
    pub(super) fn timeout(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        if self.ends <= at {
            self.ends = Instant::NEVER;
            self.drive_pin(at, out);
        }
        self.debounced.timeout(at) && self.captures()
    }

    /// Returns true if this is a capture input and the level in effect is active.
    fn captures(&self) -> bool {
        self.kind == Kind::Captures && self.debounced.level() == self.active_high
    }

    fn drive_pin(&mut self, at: Instant, out: &mut dyn Context) {
        let pulses = self.ends != Instant::NEVER;
        let level = match self.kind {
            Kind::Captures => Level::Float,
            Kind::Trips if pulses == self.active_high => Level::High,
            Kind::Trips => Level::Low,
        };
        self.put(at, level, out);
    }

    fn put(&mut self, at: Instant, level: Level, out: &mut dyn Context) {
        if level != self.driven {
            self.driven = level;
            out.put(at, Output::Level { pin: CAPTURE, level });
        }
    }
}
