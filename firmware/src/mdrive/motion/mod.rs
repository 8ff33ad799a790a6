//! The motor: its steps, moves, limits, homing, jog, currents, and the encoder on its shaft.
//!
//! Positions and velocities are in steps here. With EE = 1, orders in counts are converted to steps, and
//! values are converted back when a variable is read.
//!
//! | file | content |
//! |---|---|
//! | `inputs` | inputs of the motion, and what the drive reads of it |
//! | `orders` | how one activity follows another |
//! | `scale` | steps and counts |
//! | `shaft` | the shaft: the motor's plan and current, encoder, C1 and C2, the rotor's lag |
//! | `response` | SS: the maximum speed of a Hybrid's rotor |
//! | `encoder` | the encoder on the shaft, or a remote one |
//! | `queue` | the waiting task; PS and RS |
//! | `contacts` | home switch, limits and jog contacts |
//! | `home` | homing to a switch or to the index |
//! | `follow` | clock inputs |
//! | `closed` | EE = 1: stalls, positions that are off |
//! | `current` | RC and HC |
//! | `events` | events for the rest of the drive |
//!
//! The parts own their state, do not know [`Motion`], and return what follows. `inputs` takes the inputs, each of
//! which ends with `refresh`; `orders` acts on them and on what the parts return. This file has the values that they
//! share.

mod closed;
mod contacts;
mod current;
mod encoder;
mod events;
mod follow;
mod home;
mod inputs;
mod orders;
mod queue;
mod response;
mod scale;
mod shaft;
#[cfg(test)]
mod tests;

use fixed::types::I24F8;

use self::closed::Closed;
pub(super) use self::contacts::Contact;
use self::contacts::Contacts;
use self::current::Current;
pub(super) use self::encoder::Channel;
pub(super) use self::events::Event;
use self::events::Events;
use self::follow::Follow;
use self::home::Homing;
use self::queue::{Queue, Task};
pub(super) use self::scale::Scale;
pub(super) use self::shaft::Shaft;
use super::error::Error;
use super::reasons::Why;
use super::registers::Reg;
use super::variables::{Registers, frequency};
use crate::device::Instant;
use crate::motion::Limits;
use crate::motor::stepper::StepperParameters;

/// Value of CR at which the motor follows a clock without ramps.
const AT_ONCE: u16 = 1_000;

/// Settings of the motion: present values of variables.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Settings {
    /// Initial speed VI and maximum speed VM, in steps/s or counts/s.
    start: u32,
    speed: u32,
    /// Acceleration A and deceleration D.
    up: u32,
    down: u32,
    /// MS: microsteps in a full step.
    microsteps: u16,
    /// Settling time MT and delay HT to the holding current, in ms.
    settle_ms: u16,
    hold_delay_ms: u16,
    /// Run current RC and holding current HC, in %.
    run_percent: u8,
    hold_percent: u8,
    /// DE: true if the output bridge is on.
    enabled: bool,
    /// Maximum speed of the rotor, in steps/s: SS of a Hybrid with AS 1 and 2.
    response: u32,
    /// True if the circuitry keeps the field next to a rotor that does not follow: AS of a Hybrid is not 0.
    keeps_field: bool,
    /// LM: reaction to a limit, 1 to 6.
    limit_mode: u8,
    /// Debounce time of the home switch, one of D1 to D4, in ms.
    home_debounce_ms: u8,
    /// JE: true if jog contacts turn the motor.
    jogs: bool,
    /// CM with clock inputs: limits and jog have no effect.
    follows_clock: bool,
    /// Clock ratio CR, in thousandths.
    ratio: u16,
    /// EE: true if the user's units are counts. EL: lines of the encoder.
    closed: bool,
    lines: u16,
    /// Deadband DB and stall factor SF, in counts; SM: continue after a stall; PM: position maintenance.
    deadband: u16,
    stall_factor: u16,
    goes_on_stalled: bool,
    maintains: bool,
    /// The motor and its load.
    machine: StepperParameters,
}

impl Settings {
    /// Settings of the motion without inputs: the motion follows no clock and has no home switch.
    pub(super) fn of(bank: &Registers) -> Self {
        let long = |reg| u32::try_from(bank.get(reg)).unwrap_or(0);
        let byte = |reg| (bank.word(reg) & 0xFF) as u8;
        let flag = |reg| bank.word(reg) != 0;
        Self {
            start: long(Reg::VI),
            speed: long(Reg::VM),
            up: long(Reg::A),
            down: long(Reg::D),
            microsteps: bank.word(Reg::MS),
            settle_ms: bank.word(Reg::MT),
            hold_delay_ms: bank.word(Reg::HT),
            run_percent: byte(Reg::RC),
            hold_percent: byte(Reg::HC),
            enabled: flag(Reg::DE),
            response: response(bank),
            keeps_field: bank.word(Reg::AS) != 0,
            limit_mode: byte(Reg::LM),
            jogs: flag(Reg::JE),
            home_debounce_ms: 0,
            follows_clock: false,
            ratio: bank.word(Reg::CR),
            closed: flag(Reg::EE),
            lines: bank.word(Reg::EL),
            deadband: bank.word(Reg::DB),
            stall_factor: bank.word(Reg::SF),
            goes_on_stalled: flag(Reg::SM),
            maintains: flag(Reg::PM),
            machine: machine(bank),
        }
    }

    /// The settings with the debounce time of a home switch, and whether the motion follows a clock.
    pub(super) fn with_inputs(self, home_debounce_ms: u8, follows_clock: bool) -> Self {
        Self { home_debounce_ms, follows_clock, ..self }
    }

    /// The settings with the bridge off if `is_disabled`, whatever the value of DE.
    pub(super) fn switched_off(self, is_disabled: bool) -> Self {
        Self { enabled: self.enabled && !is_disabled, ..self }
    }

    /// Scale of the user's units.
    fn scale(&self) -> Scale {
        if self.closed {
            Scale::of_encoder(self.machine.steps_per_rev, self.microsteps, self.lines)
        } else {
            Scale::STEPS
        }
    }

    /// Steps of the motor in a revolution.
    fn steps_per_rev(&self) -> i64 {
        i64::from(self.machine.steps_per_rev) * i64::from(self.microsteps)
    }

    /// VI, VM, A and D, converted to steps.
    fn rates(&self) -> Limits {
        let scale = self.scale();
        Limits {
            start_speed: scale.speed(self.start),
            max_speed: scale.speed(self.speed),
            acceleration: scale.acceleration(self.up),
            deceleration: scale.acceleration(self.down),
        }
    }

    /// Returns true if the motor follows the clock without ramps.
    fn follows_at_once(&self) -> bool {
        self.ratio == AT_ONCE
    }

    /// Returns true if PM is in effect, which requires that the bridge is on.
    fn keeps_position(&self) -> bool {
        self.closed && self.maintains && self.enabled
    }

    /// Returns true if the bridge is off although the circuitry is on (MC 5-50).
    fn lacks_bridge(&self) -> bool {
        self.keeps_field && !self.enabled
    }

    /// Counts off the target that count as a stall.
    fn stall_counts(&self) -> i32 {
        self.stall_factor.max(1).into()
    }

    /// Returns true if a limit stops the motor without a ramp.
    fn stops_abruptly(&self) -> bool {
        self.limit_mode >= 4
    }
}

/// Highest speed that the rotor can follow, in steps/s. SS limits it with AS 1 and 2 only (FB 5.1); an
/// MDrivePlus has no AS.
fn response(bank: &Registers) -> u32 {
    match bank.word(Reg::AS) {
        1 | 2 => frequency(bank.word(Reg::SS).into()).unsigned_abs(),
        _ => u32::MAX,
    }
}

/// Parameters of the motor and its load.
fn machine(bank: &Registers) -> StepperParameters {
    let long = |reg| u32::try_from(bank.get(reg)).unwrap_or(0);
    StepperParameters {
        steps_per_rev: bank.word(Reg::FullSteps),
        holding_unm: long(Reg::HoldingTorque) * 1_000,
        pull_out_rpm: long(Reg::PullOutSpeed),
        inertia_gcm2: long(Reg::Inertia),
        friction_unm: long(Reg::Friction) * 1_000,
        load_unm: i32::try_from(bank.get(Reg::Load)).unwrap_or(0) * 1_000,
        ..StepperParameters::NOMINAL
    }
}

/// Motion command. Positions and speeds are in the user's units: steps, or counts with EE = 1.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Order {
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
pub(super) enum Activity {
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
pub(super) enum Preemption {
    /// The command is executed at once.
    AtOnce,
    /// The command waits until the rotor is at rest.
    AtStandstill,
    /// The command is ignored.
    Never,
}

/// A move to a position.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Move {
    /// Target position of the plan.
    target: i32,
    /// Target count of the encoder, with EE = 1.
    encoder_target: Option<i32>,
    /// True if MA or MR ordered the move, false for position maintenance.
    ordered: bool,
    /// True if the drive sends its name at the end.
    notify_on_end: bool,
    /// True if the motion does not stop at the target.
    continuous: bool,
    /// Speed at which the motion continues after the target, in the user's unit: VM when the move began.
    speed: u32,
    /// Number of corrections of the position so far.
    tries: u8,
}

impl Move {
    /// Move that an order makes from here. An order that is not a move makes one of no steps.
    ///
    /// # Errors
    /// Error 21: the distance has more than 32 bits of steps.
    fn of(order: Order, at: Instant, shaft: &Shaft, settings: &Settings) -> Result<Self, Error> {
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
    fn back_to(encoder_target: i32) -> Self {
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
    pub(super) fn is_rest(&self) -> bool {
        matches!(self, Self::Rest)
    }

    /// Returns true if no plan runs.
    fn is_idle(&self) -> bool {
        matches!(self, Self::Rest | Self::Planning(_) | Self::Settles(_))
    }

    /// Returns true if the circuitry turns the motor.
    pub(super) fn is_circuit_driven(&self) -> bool {
        matches!(self, Self::CircuitDriven { .. })
    }

    /// Returns true if the motion has inertia.
    fn spins(&self) -> bool {
        matches!(self, Self::CircuitDriven { preemption: Preemption::Never | Preemption::AtStandstill, .. })
    }

    /// Returns true if the motor turns without end, until something stops it.
    fn is_endless(&self) -> bool {
        matches!(self, Self::Slews(_) | Self::Jogs { .. } | Self::Follows)
    }

    /// Task that PS interrupts and RS continues. A jog or a motion by the clock is none, because it is not the
    /// program's.
    fn task(&self) -> Option<Task> {
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
    pub(super) fn needs_rates(&self, is_speed: bool) -> Result<(), Why> {
        match self {
            Self::Moves(_) => Err(Why::KeepsRates),
            Self::Slews(_) if is_speed => Err(Why::SlewHasSpeed),
            Self::Slews(_) => Err(Why::NextSpeed),
            _ => Ok(()),
        }
    }
}

/// Motion that a Hybrid's circuitry makes on its own. C1 does not count it (MC 5-9).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Circuit {
    /// Turns the shaft by a number of steps. A motion command ends it.
    Turn { steps: i32, rates: Limits },
    /// Turns the shaft without end, from its present speed on, and ignores motion commands. The shaft has inertia,
    /// so it does not stop when the bridge is switched off.
    Spin { speed: I24F8, acceleration: u32 },
    /// Slows down a spinning shaft. A motion command waits until the shaft is at rest.
    Slow { deceleration: u32 },
}

/// The motor, and the state of its motion.
#[derive(Clone, Debug)]
pub(super) struct Motion {
    settings: Settings,
    shaft: Shaft,
    activity: Activity,
    /// Deadline of the activity.
    due: Instant,
    queue: Queue,
    contacts: Contacts,
    closed: Closed,
    follow: Follow,
    /// Time at which the index changes during a homing to the index.
    index_due: Instant,
    current: Current,
    events: Events,
}
