//! Wires of a board, and the pin or fault of a drive to which each leads.

use drivetwin_firmware::device::{AxisSpec, Fault, Framing, Level, Pin, Port, PortSpec, Role, Spec};
use drivetwin_firmware::shell::BoardEvent;

/// The drive's end of a wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum End {
    /// A pin.
    Pin(Pin),
    /// The cause of a fault, which is present while the wire is low (BOARD-7).
    Fault(Fault),
    /// DTR of the host at a port. The host is present while the wire is low, as behind an RS-232 receiver or
    /// a USB adapter (BOARD-11).
    Dtr(Port),
}

/// The only port of a board.
const PORT: Port = Port(0);

impl End {
    /// The pin with this name, or else the fault with this name. `DTR` is valid only if the drive detects its
    /// host.
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

    /// Returns whether the drive reads this end.
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

    /// Returns true if the idle level, without a wire, is high. It is low only where the manual requires
    /// that.
    #[must_use]
    pub fn rests_high(self, spec: &Spec) -> bool {
        match self {
            Self::Pin(Pin(place)) => {
                spec.pins.get(usize::from(place)).is_some_and(|pin| pin.idle != Level::Low)
            }
            Self::Fault(_) | Self::Dtr(_) => true,
        }
    }

    /// Returns true if the drive pulls this end low or releases it, but never drives it high.
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

    /// Event for a change to this level.
    #[must_use]
    pub const fn edge(self, high: bool) -> BoardEvent {
        match self {
            Self::Pin(pin) => BoardEvent::Edge(pin, high),
            Self::Fault(fault) => BoardEvent::Fault(fault, !high),
            Self::Dtr(port) => BoardEvent::HostPresence(port, !high),
        }
    }
}

/// Returns true if the bus of a drive has a wire for each direction. Otherwise it has one wire for both, with
/// a transceiver whose direction must be switched.
#[must_use]
pub fn is_full_duplex(spec: &Spec) -> bool {
    matches!(spec.ports, [PortSpec { framing: Framing::Character, .. }, ..])
}

/// Location of STEP and DIR of a drive's axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AxisPins {
    /// No pins: there is no axis, or its motor is inside the drive and the step pulses do not leave it.
    None,
    /// Pins for STEP and DIR only.
    Own,
    /// Pins that have other purposes, too: a plan takes them, and a level at one of them takes that pin back.
    /// The argument is the pin of DIR.
    Shared(Pin),
}

impl AxisPins {
    /// Location of STEP and DIR for the axis of `spec`, if `wired` lists all other ends that are wired to the
    /// board.
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
