//! I/O 1 to 4: inputs and outputs, general or of a type (MC 5-63, 5-64).

use super::super::error::Error;
use super::super::motion::Contact;
use super::lasting::Debounce;
use super::{Event, Shown};
use crate::device::{Context, Duration, Instant, Level, Output, Pin};

/// Type of a point.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Kind {
    /// A general purpose input.
    Input,
    /// A contact of the motion.
    Contact(Contact),
    /// An input that tells this when it becomes active.
    Tells(Event),
    /// A general purpose output.
    Output,
    /// An output that shows something.
    Shows(Shows),
}

/// State that an output with a type shows.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Shows {
    Moving,
    Fault,
    Stall,
    Changing,
    LockedRotor,
    Positioning,
    Hybrid,
    MakesUp,
}

impl Kind {
    pub(super) fn of(code: u16) -> Option<Self> {
        Some(match code {
            0 => Self::Input,
            1 => Self::Contact(Contact::Home),
            2 => Self::Contact(Contact::PlusLimit),
            3 => Self::Contact(Contact::MinusLimit),
            4 => Self::Tells(Event::Go),
            5 => Self::Tells(Event::SoftStop),
            6 => Self::Tells(Event::Pause),
            7 => Self::Contact(Contact::JogPlus),
            8 => Self::Contact(Contact::JogMinus),
            11 => Self::Tells(Event::Reset),
            16 => Self::Output,
            17 => Self::Shows(Shows::Moving),
            18 => Self::Shows(Shows::Fault),
            19 => Self::Shows(Shows::Stall),
            20 => Self::Shows(Shows::Changing),
            21 => Self::Shows(Shows::LockedRotor),
            // MC table 7.7 has 22 to 24 for these three.
            23 => Self::Shows(Shows::Positioning),
            24 => Self::Shows(Shows::Hybrid),
            25 => Self::Shows(Shows::MakesUp),
            _ => return None,
        })
    }

    /// Returns whether only a Hybrid has it (FB 4.3.1).
    pub(super) fn is_of_hybrid(self) -> bool {
        matches!(self, Self::Shows(Shows::LockedRotor | Shows::Hybrid | Shows::MakesUp))
    }

    /// Returns whether only one point may have it (MC 9.1).
    pub(super) fn is_dedicated(self) -> bool {
        !matches!(self, Self::Input | Self::Output)
    }

    fn is_output(self) -> bool {
        matches!(self, Self::Output | Self::Shows(_))
    }
}

impl Shows {
    fn of(self, shown: Shown) -> bool {
        match self {
            Self::Moving => shown.moving,
            Self::Fault => shown.fault,
            Self::Stall => shown.stall,
            Self::Changing => shown.changing,
            Self::LockedRotor => shown.locked_rotor,
            Self::Positioning => shown.positioning,
            Self::Hybrid => shown.hybrid,
            Self::MakesUp => shown.makes_up,
        }
    }
}

/// Set-up by S1 to S4.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct SetUp {
    pub(super) kind: Kind,
    active_high: bool,
    sources: bool,
}

impl SetUp {
    /// A general purpose input, active low, sinking.
    pub(super) const FACTORY: Self = Self { kind: Kind::Input, active_high: false, sources: false };

    /// Type, active state, sinking or sourcing.
    ///
    /// # Errors
    /// 8 for the type, 21 for the others.
    pub(super) fn of([kind, active_high, sources]: [u16; 3]) -> Result<Self, Error> {
        let kind = Kind::of(kind).ok_or(Error::IllegalType)?;
        Ok(Self { kind, active_high: flag(active_high)?, sources: flag(sources)? })
    }
}

/// A value that is 0 or 1.
///
/// # Errors
/// 21: it is another one.
pub(super) fn flag(value: u16) -> Result<bool, Error> {
    match value {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(Error::IllegalValue),
    }
}

impl SetUp {
    /// Returns whether a pin that is high when this is set up is a reset, even if it falls then: "If setting the input
    /// to sourcing, active true, ground the input first or a reset will occur" (MC 5-63, type 11).
    pub(super) fn resets_when_high(self) -> bool {
        self.kind == Kind::Tells(Event::Reset) && self.sources && self.active_high
    }
}

/// An I/O point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    set_up: SetUp,
    /// Level from outside; `None` if it is open.
    outside: Option<bool>,
    held: Debounce,
    /// Time at which an input that was set up can be used (MC 5-64, note 2); [`Instant::NEVER`] if it can.
    settles: Instant,
    active: bool,
    /// Level that it drives.
    driven: Level,
}

impl Point {
    pub(super) const OPEN: Self = Self {
        set_up: SetUp::FACTORY,
        outside: None,
        held: Debounce::new(true),
        settles: Instant::NEVER,
        active: false,
        driven: Level::Float,
    };

    pub(super) fn kind(&self) -> Kind {
        self.set_up.kind
    }

    /// Returns whether it is active: an input as it has settled, an output as it is to be.
    pub(super) fn is_active(&self) -> bool {
        self.active
    }

    /// The level that counts.
    pub(super) fn held(&self) -> bool {
        self.held.level
    }

    /// The level at the pin. Where neither side drives it, what sinks is pulled up and what sources is pulled down
    /// (MDRIVE-24).
    pub(super) fn level(&self) -> bool {
        match self.driven {
            Level::Low => false,
            Level::High => true,
            Level::Float => self.outside.unwrap_or(!self.set_up.sources),
        }
    }

    pub(super) fn deadline(&self) -> Instant {
        self.held.due.min(self.settles)
    }

    /// Takes a set-up. Returns whether it is another one: then [`Self::begin`] must follow.
    pub(super) fn set_up(&mut self, set_up: SetUp) -> bool {
        let is_new = set_up != self.set_up;
        // A general purpose output that stays one stays as active as it is.
        self.active &= !is_new || (self.kind(), set_up.kind) == (Kind::Output, Kind::Output);
        self.set_up = set_up;
        is_new
    }

    /// Begins as it was set up: an input is inactive until it has settled. Returns whether it is active now and was
    /// not.
    pub(super) fn begin(&mut self, at: Instant, pin: Pin, debounce: Duration, out: &mut dyn Context) -> bool {
        self.drive(at, pin, out);
        self.settles = at + debounce;
        self.look(at, debounce);
        self.timeout(at)
    }

    /// As [`Self::begin`], but takes what is there for what has been there for long.
    pub(super) fn load(&mut self, at: Instant, pin: Pin, out: &mut dyn Context) {
        self.drive(at, pin, out);
        self.settles = Instant::NEVER;
        self.held = Debounce::new(self.level());
        self.judge();
    }

    /// Sets the level from outside; returns whether it becomes active.
    pub(super) fn see(&mut self, at: Instant, outside: Option<bool>, debounce: Duration) -> bool {
        self.outside = outside;
        self.look(at, debounce)
    }

    /// Another level counts because it has lasted, or it has settled. Returns whether it becomes active.
    pub(super) fn timeout(&mut self, at: Instant) -> bool {
        self.held.timeout(at);
        if self.settles <= at {
            self.settles = Instant::NEVER;
        }
        self.judge()
    }

    /// An output becomes active, or not.
    ///
    /// # Errors
    /// 9: it is no general purpose output.
    pub(super) fn write(
        &mut self,
        at: Instant,
        pin: Pin,
        active: bool,
        debounce: Duration,
        out: &mut dyn Context,
    ) -> Result<(), Error> {
        if self.kind() != Kind::Output {
            return Err(Error::NoOutput);
        }
        self.put(at, pin, active, debounce, out);
        Ok(())
    }

    /// An output with a type shows what is so.
    pub(super) fn show(
        &mut self,
        at: Instant,
        pin: Pin,
        shown: Shown,
        debounce: Duration,
        out: &mut dyn Context,
    ) {
        if let Kind::Shows(shows) = self.kind() {
            self.put(at, pin, shows.of(shown), debounce, out);
        }
    }

    fn put(&mut self, at: Instant, pin: Pin, active: bool, debounce: Duration, out: &mut dyn Context) {
        if active != self.active {
            self.active = active;
            self.drive(at, pin, out);
            self.look(at, debounce);
        }
    }

    /// Puts out what it is to put out (MC 5-64).
    fn drive(&mut self, at: Instant, pin: Pin, out: &mut dyn Context) {
        let SetUp { kind, active_high, sources } = self.set_up;
        let level = match (self.active == active_high, sources) {
            _ if !kind.is_output() => Level::Float,
            (false, false) => Level::Low,
            (true, true) => Level::High,
            _ => Level::Float,
        };
        if level != self.driven {
            self.driven = level;
            out.put(at, Output::Level { pin, level });
        }
    }

    fn look(&mut self, at: Instant, debounce: Duration) -> bool {
        let level = self.level();
        self.held.see(at, level, debounce) && self.judge()
    }

    /// Returns whether an input becomes active by the level that counts now.
    fn judge(&mut self) -> bool {
        if self.kind().is_output() || self.settles != Instant::NEVER {
            return false;
        }
        let active = self.held.level == self.set_up.active_high;
        let was = core::mem::replace(&mut self.active, active);
        active && !was
    }
}
