//! Where the wires of a board go.

use standin_firmware::device::{Fault, Level, Pin, Role, Spec};
use standin_firmware::shell::Caught;

/// What of a drive is at the end of a wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum End {
    /// A pin.
    Pin(Pin),
    /// The cause of a fault, there while the wire is low.
    Fault(Fault),
}

impl End {
    /// What `spec` calls by that name: a pin, or else a fault.
    #[must_use]
    pub fn of(spec: &Spec, name: &str) -> Option<Self> {
        if let Some(place) = spec.pins.iter().position(|pin| pin.name == name) {
            return u8::try_from(place).ok().map(|place| Self::Pin(Pin(place)));
        }
        let place = spec.faults.iter().position(|fault| *fault == name)?;
        u8::try_from(place).ok().map(|place| Self::Fault(Fault(place)))
    }

    /// Whether the drive looks at it.
    #[must_use]
    pub fn is_input(self, spec: &Spec) -> bool {
        match self {
            Self::Pin(Pin(place)) => {
                let pin = spec.pins.get(usize::from(place));
                pin.is_some_and(|pin| matches!(pin.role, Role::Input | Role::Both))
            }
            Self::Fault(_) => true,
        }
    }

    /// What it reads while nothing is wired to it: low only where the manual says so.
    #[must_use]
    pub fn rests_high(self, spec: &Spec) -> bool {
        match self {
            Self::Pin(Pin(place)) => {
                spec.pins.get(usize::from(place)).is_some_and(|pin| pin.rest != Level::Low)
            }
            Self::Fault(_) => true,
        }
    }

    /// Whether the drive pulls it low or lets it go, but never drives it high.
    #[must_use]
    pub fn is_open_drain(self, spec: &Spec) -> bool {
        match self {
            Self::Pin(Pin(place)) => spec
                .pins
                .get(usize::from(place))
                .is_some_and(|pin| pin.role == Role::Output && pin.rest == Level::Float),
            Self::Fault(_) => false,
        }
    }

    /// What a change of its level is to the drive.
    #[must_use]
    pub const fn edge(self, high: bool) -> Caught {
        match self {
            Self::Pin(pin) => Caught::Edge(pin, high),
            Self::Fault(fault) => Caught::Fault(fault, !high),
        }
    }
}
