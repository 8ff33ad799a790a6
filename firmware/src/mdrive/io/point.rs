//! I/O 1 to 4: inputs and outputs, general purpose or with a type (MC 5-63, 5-64).

use super::super::error::Error;
use super::super::motion::Contact;
use super::{Event, StateFlags};
use crate::debounce::Debounce;
use crate::device::{Context, Duration, Instant, Level, Output, Pin};

/// Type of a point.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Kind {
    /// A general purpose input.
    Input,
    /// A contact of the motion.
    Contact(Contact),
    /// An input whose activation causes this event.
    Command(Event),
    /// A general purpose output.
    Output,
    /// An output that shows a state of the drive.
    StateOutput(StateOutput),
}

/// State that an output with a type shows.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum StateOutput {
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
            4 => Self::Command(Event::Go),
            5 => Self::Command(Event::SoftStop),
            6 => Self::Command(Event::Pause),
            7 => Self::Contact(Contact::JogPlus),
            8 => Self::Contact(Contact::JogMinus),
            11 => Self::Command(Event::Reset),
            16 => Self::Output,
            17 => Self::StateOutput(StateOutput::Moving),
            18 => Self::StateOutput(StateOutput::Fault),
            19 => Self::StateOutput(StateOutput::Stall),
            20 => Self::StateOutput(StateOutput::Changing),
            21 => Self::StateOutput(StateOutput::LockedRotor),
            // MC table 7.7 gives the next three types the numbers 22 to 24.
            23 => Self::StateOutput(StateOutput::Positioning),
            24 => Self::StateOutput(StateOutput::Hybrid),
            25 => Self::StateOutput(StateOutput::MakesUp),
            _ => return None,
        })
    }

    /// Returns true if only a Hybrid has this type (FB 4.3.1).
    pub(super) fn is_of_hybrid(self) -> bool {
        matches!(
            self,
            Self::StateOutput(StateOutput::LockedRotor | StateOutput::Hybrid | StateOutput::MakesUp)
        )
    }

    /// Returns true if only one point may have this type (MC 9.1).
    pub(super) fn is_dedicated(self) -> bool {
        !matches!(self, Self::Input | Self::Output)
    }

    fn is_output(self) -> bool {
        matches!(self, Self::Output | Self::StateOutput(_))
    }
}

impl StateOutput {
    fn of(self, flags: StateFlags) -> bool {
        match self {
            Self::Moving => flags.moving,
            Self::Fault => flags.fault,
            Self::Stall => flags.stall,
            Self::Changing => flags.changing,
            Self::LockedRotor => flags.locked_rotor,
            Self::Positioning => flags.positioning,
            Self::Hybrid => flags.hybrid,
            Self::MakesUp => flags.is_making_up,
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

    /// Checks a set-up: type, active state, sinking or sourcing.
    ///
    /// # Errors
    /// Error 8 for the type, 21 for the others.
    pub(super) fn of([kind, active_high, sources]: [u16; 3]) -> Result<Self, Error> {
        let kind = Kind::of(kind).ok_or(Error::IllegalType)?;
        Ok(Self { kind, active_high: flag(active_high)?, sources: flag(sources)? })
    }
}

/// A value that is 0 or 1.
///
/// # Errors
/// Error 21: the value is neither 0 nor 1.
pub(super) fn flag(value: u16) -> Result<bool, Error> {
    match value {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(Error::IllegalValue),
    }
}

impl SetUp {
    /// Returns true if this set-up causes a reset when the pin is high, even if the pin falls immediately
    /// after: "If setting the input to sourcing, active true, ground the input first or a reset will occur"
    /// (MC 5-63, type 11).
    pub(super) fn resets_when_high(self) -> bool {
        self.kind == Kind::Command(Event::Reset) && self.sources && self.active_high
    }
}

/// An I/O point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    set_up: SetUp,
    /// Level that something outside drives; `None` if the pin is open.
    outside: Option<bool>,
    debounced: Debounce,
    /// Time at which an input can be used after its set-up (MC 5-64, note 2); [`Instant::NEVER`] if it
    /// already can.
    settles: Instant,
    active: bool,
    /// Level that the point drives.
    driven: Level,
}

impl Point {
    pub(super) const OPEN: Self = Self {
        set_up: SetUp::FACTORY,
        outside: None,
        debounced: Debounce::new(true),
        settles: Instant::NEVER,
        active: false,
        driven: Level::Float,
    };

    pub(super) fn kind(&self) -> Kind {
        self.set_up.kind
    }

    /// Returns true if the point is active: an input by its debounced level, an output as it was set.
    pub(super) fn is_active(&self) -> bool {
        self.active
    }

    /// Level in effect after debouncing.
    pub(super) fn debounced_level(&self) -> bool {
        self.debounced.level()
    }

    /// Level at the pin. If nothing drives it, a sinking point is pulled up and a sourcing point is pulled
    /// down (MDRIVE-24).
    pub(super) fn level(&self) -> bool {
        match self.driven {
            Level::Low => false,
            Level::High => true,
            Level::Float => self.outside.unwrap_or(!self.set_up.sources),
        }
    }

    pub(super) fn deadline(&self) -> Instant {
        self.debounced.due().min(self.settles)
    }

    /// Stores a set-up. Returns true if the set-up has changed; then the caller must call [`Self::start`].
    pub(super) fn set_up(&mut self, set_up: SetUp) -> bool {
        let is_new = set_up != self.set_up;
        // A general purpose output that stays one keeps its state.
        self.active &= !is_new || (self.kind(), set_up.kind) == (Kind::Output, Kind::Output);
        self.set_up = set_up;
        is_new
    }

    /// Begins to use a new set-up. An input is inactive until it has settled. Returns true if the input has
    /// become active.
    pub(super) fn start(&mut self, at: Instant, pin: Pin, debounce: Duration, out: &mut dyn Context) -> bool {
        self.drive(at, pin, out);
        self.settles = at + debounce;
        self.update(at, debounce);
        self.timeout(at)
    }

    /// Like [`Self::start`], but the present level takes effect at once.
    pub(super) fn load(&mut self, at: Instant, pin: Pin, out: &mut dyn Context) {
        self.drive(at, pin, out);
        self.settles = Instant::NEVER;
        self.debounced = Debounce::new(self.level());
        self.update_active();
    }

    /// Sets the level from outside. Returns true if the input becomes active.
    pub(super) fn sample(&mut self, at: Instant, outside: Option<bool>, debounce: Duration) -> bool {
        self.outside = outside;
        self.update(at, debounce)
    }

    /// Handles the deadlines of debouncing and settling. Returns true if the input becomes active.
    pub(super) fn timeout(&mut self, at: Instant) -> bool {
        self.debounced.timeout(at);
        if self.settles <= at {
            self.settles = Instant::NEVER;
        }
        self.update_active()
    }

    /// Makes an output active or inactive.
    ///
    /// # Errors
    /// Error 9: the point is not a general purpose output.
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

    /// Updates an output that shows a state of the drive.
    pub(super) fn update_output(
        &mut self,
        at: Instant,
        pin: Pin,
        flags: StateFlags,
        debounce: Duration,
        out: &mut dyn Context,
    ) {
        if let Kind::StateOutput(output) = self.kind() {
            self.put(at, pin, output.of(flags), debounce, out);
        }
    }

    fn put(&mut self, at: Instant, pin: Pin, active: bool, debounce: Duration, out: &mut dyn Context) {
        if active != self.active {
            self.active = active;
            self.drive(at, pin, out);
            self.update(at, debounce);
        }
    }

    /// Drives the pin as its state and set-up require (MC 5-64).
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

    fn update(&mut self, at: Instant, debounce: Duration) -> bool {
        let level = self.level();
        self.debounced.sample(at, level, debounce) && self.update_active()
    }

    /// Updates the state of an input from the level in effect. Returns true if the input becomes active.
    fn update_active(&mut self) -> bool {
        if self.kind().is_output() || self.settles != Instant::NEVER {
            return false;
        }
        let active = self.debounced.level() == self.set_up.active_high;
        let was = core::mem::replace(&mut self.active, active);
        active && !was
    }
}
