//! The present activity of the motion, and the commands that begin one.

use super::home::Homing;
use super::queue::Task;
use super::settings::Settings;
use super::shaft::Shaft;
use crate::device::Instant;
use crate::mdrive::error::Error;
use crate::mdrive::reasons::Why;

/// Motion command. Positions and speeds are in the user's units: steps, or counts with EE = 1.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Order {
    /// MA: move to a position.
    To { position: i32, notify_on_end: bool, continuous: bool },
    /// MR: move by a distance.
    By { distance: i32, notify_on_end: bool, continuous: bool },
    /// SL: turn at this speed.
    Slew(i32),
    /// HM: homing to the switch, with type 1 to 4.
    Home(u8),
    /// HI: homing to the index, with type 1 to 4.
    HomeToIndex(u8),
}

/// Present activity.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Activity {
    Rest,
    /// A move is being calculated.
    Planning(Move),
    Moves(Move),
    /// SL: turns without end at this speed, in the user's unit.
    Slews(i32),
    Jogs {
        back: bool,
    },
    /// Ramp to standstill. The waiting task begins after that, `at_once` or after MT.
    Stops {
        at_once: bool,
    },
    /// Settling time MT, after a move or another motion.
    Settles(Option<Move>),
    Homes(Homing),
    /// The motor follows the clock inputs.
    Follows,
    /// A Hybrid's circuitry turns the motor, with this percentage of its current.
    CircuitDriven {
        percent: u8,
        preemption: Preemption,
    },
}

/// Treatment of a motion command while a Hybrid's circuitry turns the shaft.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) enum Preemption {
    /// The command is executed at once.
    AtOnce,
    /// The command waits until the rotor is at rest.
    AtStandstill,
    /// The command is ignored.
    Never,
}

/// A move to a position.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) struct Move {
    /// Target position of the plan.
    pub(super) target: i32,
    /// Target count of the encoder, with EE = 1.
    pub(super) encoder_target: Option<i32>,
    /// True if MA or MR ordered the move, false for position maintenance.
    pub(super) ordered: bool,
    /// True if the drive sends its name at the end.
    pub(super) notify_on_end: bool,
    /// True if the motion does not stop at the target.
    pub(super) continuous: bool,
    /// Speed at which the motion continues after the target, in the user's unit: VM when the move began.
    pub(super) speed: u32,
    /// Number of corrections of the position so far.
    pub(super) tries: u8,
}

impl Move {
    /// Move that an order makes from here. An order that is not a move makes one of no steps.
    ///
    /// # Errors
    /// Error 21: the distance has more than 32 bits of steps.
    pub(super) fn of(order: Order, at: Instant, shaft: &Shaft, settings: &Settings) -> Result<Self, Error> {
        let (distance, notify_on_end, continuous) = match order {
            Order::To { position, notify_on_end, continuous } => {
                (position.wrapping_sub(shaft.displayed_position(at)), notify_on_end, continuous)
            }
            Order::By { distance, notify_on_end, continuous } => (distance, notify_on_end, continuous),
            Order::Slew(_) | Order::Home(_) | Order::HomeToIndex(_) => (0, false, false),
        };
        let steps = shaft.steps_of(at, distance).ok_or(Error::IllegalValue)?;
        Ok(Self {
            target: shaft.position(at).wrapping_add(steps),
            encoder_target: settings.closed.then(|| shaft.count(at).wrapping_add(distance)),
            ordered: true,
            notify_on_end,
            continuous,
            speed: settings.speed,
            tries: 0,
        })
    }

    /// Move that brings the encoder back to `encoder_target`.
    pub(super) fn back_to(encoder_target: i32) -> Self {
        Self {
            target: 0,
            encoder_target: Some(encoder_target),
            ordered: false,
            notify_on_end: false,
            continuous: false,
            speed: 0,
            tries: 0,
        }
    }
}

impl Activity {
    /// Returns true if the axis is at rest: nothing moves, settles or is calculated.
    pub(in crate::mdrive) fn is_rest(&self) -> bool {
        matches!(self, Self::Rest)
    }

    /// Returns true if no plan runs.
    pub(super) fn is_idle(&self) -> bool {
        matches!(self, Self::Rest | Self::Planning(_) | Self::Settles(_))
    }

    /// Returns true if the circuitry turns the motor.
    pub(in crate::mdrive) fn is_circuit_driven(&self) -> bool {
        matches!(self, Self::CircuitDriven { .. })
    }

    /// Returns true if the motion has inertia.
    pub(super) fn spins(&self) -> bool {
        matches!(self, Self::CircuitDriven { preemption: Preemption::Never | Preemption::AtStandstill, .. })
    }

    /// Returns true if the motor turns without end, until something stops it.
    pub(super) fn is_endless(&self) -> bool {
        matches!(self, Self::Slews(_) | Self::Jogs { .. } | Self::Follows)
    }

    /// Task that PS interrupts and RS continues. A jog or a motion by the clock is none, because it is not the
    /// program's.
    pub(super) fn task(&self) -> Option<Task> {
        match *self {
            Self::Planning(movement) | Self::Moves(movement) if movement.ordered => {
                Some(Task::Move(movement))
            }
            Self::Slews(speed) => Some(Task::Slew(speed)),
            Self::Homes(homing) => Some(Task::Home(homing.order())),
            _ => None,
        }
    }

    /// Checks that the motion uses new values of A, D and VI, or of VM (`is_speed`).
    ///
    /// # Errors
    /// The motion keeps the values with which it began (MDRIVE-17).
    pub(in crate::mdrive) fn needs_rates(&self, is_speed: bool) -> Result<(), Why> {
        match self {
            Self::Moves(_) => Err(Why::KeepsRates),
            Self::Slews(_) if is_speed => Err(Why::SlewHasSpeed),
            Self::Slews(_) => Err(Why::NextSpeed),
            _ => Ok(()),
        }
    }
}
