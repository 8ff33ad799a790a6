//! Wires of a board, and the pin or fault of a drive to which each leads.

use drivetwin_firmware::device::{AxisSpec, Fault, Framing, Level, Pin, Port, PortSpec, Role, Spec};
use drivetwin_firmware::shell::BoardEvent;

/// End of a wire at the drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum End {
    /// A pin.
    Pin(Pin),
    /// The cause of a fault, there while the wire is low (BOARD-7).
    Fault(Fault),
    /// DTR of the host at a port, which is there while the wire is low, as it is behind an RS-232 receiver or a
    /// USB adapter (BOARD-11).
    Dtr(Port),
}

/// The only port of a board.
const PORT: Port = Port(0);

impl End {
    /// End of that name: a pin, or else a fault; `DTR` of a drive that detects its host.
    #[must_use]
    pub fn of(spec: &Spec, name: &str) -> Option<Self> {
        if let Some(pin) = spec.pin(name) {
            return Some(Self::Pin(pin));
        }
        if let Some(place) = spec.faults.iter().position(|fault| *fault == name) {
            return u8::try_from(place).ok().map(|place| Self::Fault(Fault(place)));
        }
        (name == "DTR" && is_full_duplex(spec)).then_some(Self::Dtr(PORT))
    }

    /// Returns whether the drive reads it.
    #[must_use]
    pub fn is_input(self, spec: &Spec) -> bool {
        match self {
            Self::Pin(Pin(place)) => {
                let pin = spec.pins.get(usize::from(place));
                pin.is_some_and(|pin| matches!(pin.role, Role::Input | Role::Both | Role::AnalogueOrDigital))
            }
            Self::Fault(_) | Self::Dtr(_) => true,
        }
    }

    /// Returns the idle level without a wire: low only where the manual requires it.
    #[must_use]
    pub fn rests_high(self, spec: &Spec) -> bool {
        match self {
            Self::Pin(Pin(place)) => {
                spec.pins.get(usize::from(place)).is_some_and(|pin| pin.idle != Level::Low)
            }
            Self::Fault(_) | Self::Dtr(_) => true,
        }
    }

    /// Returns whether the drive pulls it low or releases it, but never drives it high.
    #[must_use]
    pub fn is_open_drain(self, spec: &Spec) -> bool {
        match self {
            Self::Pin(Pin(place)) => spec
                .pins
                .get(usize::from(place))
                .is_some_and(|pin| pin.role == Role::Output && pin.idle == Level::Float),
            Self::Fault(_) | Self::Dtr(_) => false,
        }
    }

    /// Event for a change of its level.
    #[must_use]
    pub const fn edge(self, high: bool) -> BoardEvent {
        match self {
            Self::Pin(pin) => BoardEvent::Edge(pin, high),
            Self::Fault(fault) => BoardEvent::Fault(fault, !high),
            Self::Dtr(port) => BoardEvent::HostPresence(port, !high),
        }
    }
}

/// Returns whether the bus of a drive has a wire for each direction; else it has one for both, with a transceiver that
/// must be turned around.
#[must_use]
pub fn is_full_duplex(spec: &Spec) -> bool {
    matches!(spec.ports, [PortSpec { framing: Framing::Character, .. }, ..])
}

/// Pins of STEP and DIR of a drive's axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AxisPins {
    /// There is no axis, or its motor is inside the drive and its steps leave nowhere.
    None,
    /// At pins of their own.
    Own,
    /// At pins that serve other purposes, too: a plan takes them, a level takes them back. This one carries DIR.
    Shared(Pin),
}

impl AxisPins {
    /// Pins for the axis of `spec`, with what is `wired` to the board beside STEP and DIR.
    #[must_use]
    pub fn of(spec: &Spec, mut wired: impl Iterator<Item = Option<End>>) -> Self {
        match spec.axes {
            [] | [AxisSpec { step_dir: None, .. }, ..] => Self::None,
            [AxisSpec { step_dir: Some((_, dir)), .. }, ..]
                if wired.any(|end| end == Some(End::Pin(*dir))) =>
            {
                Self::Shared(*dir)
            }
            _ => Self::Own,
        }
    }
}
