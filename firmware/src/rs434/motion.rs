//! Starts and stops of the motor, and its motions: continuous rotation, and moves by OFFSET or to a position
//! (6.2, 6.5).

use super::reasons::Why;
use super::registers::{Reg, Words};
use super::servo::Servo;
use crate::device::{Context, Instant};

/// Direction of a start.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Heading {
    /// The direction that DIRECTION or the sign of OFFSET selects.
    Registers,
    /// Forward, selected by IN1 in mode 5 of MODE_EXT_IN.
    Forward,
    /// Backward, or by the negative OFFSET, selected by IN2.
    Backward,
}

/// State of the motion that was started last.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// No motion, though the motor may still brake.
    None,
    /// Rotation until a stop.
    Rotates,
    /// A move until its end. A stopped move, until another motion starts or OFFSET is written.
    Moves {
        /// Target.
        target: Target,
        /// True after the move was stopped on its way, also after it has come to rest.
        braking: bool,
    },
}

/// Target of a move.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Target {
    /// By OFFSET, which counts down the remaining distance.
    Offset,
    /// By the negative OFFSET.
    MinusOffset,
    /// To TARGET_POSITION.
    Position,
}

/// The motion that was started last. The servo carries it out.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Motion {
    state: State,
}

impl Motion {
    pub(super) const NONE: Self = Self { state: State::None };

    /// Starts the motor as MODE_ROTATION selects, unless a move is in progress.
    ///
    /// # Errors
    /// The reason why nothing starts.
    pub(super) fn start(
        &mut self,
        at: Instant,
        heading: Heading,
        servo: &mut Servo,
        bank: &mut Words,
        out: &mut dyn Context,
    ) -> Result<(), Why> {
        let rotation = bank.word(Reg::MODE_ROTATION);
        let forward = match heading {
            Heading::Registers => is_forward(bank),
            Heading::Forward => true,
            Heading::Backward => false,
        };
        match self.state {
            State::Moves { braking: false, .. } => return Err(Why::MoveRuns),
            State::Moves { braking: true, .. } => self.end_move(servo, bank),
            State::Rotates => {
                self.rotate(at, forward, servo, out);
                return if rotation == 1 { Ok(()) } else { Err(Why::Rotates) };
            }
            State::None => {}
        }
        if rotation != 1 && has_too_few_halls(bank) {
            return Err(Why::TooFewHalls);
        }
        let constant = bank.get(Reg::OFFSET_CONST);
        if constant != 0 {
            bank.set(Reg::OFFSET, constant);
        }
        let (counts, target) = match rotation {
            1 => {
                self.rotate(at, forward, servo, out);
                return Ok(());
            }
            2 => {
                let offset = bank.get(Reg::OFFSET) as i32;
                match (offset, heading) {
                    (0, _) => return Err(Why::NoOffset),
                    (_, Heading::Backward) => (offset.saturating_neg(), Target::MinusOffset),
                    _ => (offset, Target::Offset),
                }
            }
            _ => match distance_to_position(servo, bank) {
                0 => return Err(Why::IsThere),
                distance => (distance, Target::Position),
            },
        };
        self.state = State::Moves { target, braking: false };
        servo.go(at, counts, bank.get(Reg::OFFSET_COMPENSATION) as i16, out)
    }

    fn rotate(&mut self, at: Instant, forward: bool, servo: &mut Servo, out: &mut dyn Context) {
        self.state = State::Rotates;
        servo.rotate(at, forward, out);
    }

    /// Applies a new DIRECTION to continuous rotation at once.
    pub(super) fn direction_changed(
        &mut self,
        at: Instant,
        forward: bool,
        servo: &mut Servo,
        out: &mut dyn Context,
    ) {
        if self.state == State::Rotates {
            self.rotate(at, forward, servo, out);
        }
    }

    /// Returns true if a move by OFFSET is in progress whose target is not that of this heading.
    pub(super) fn is_against(&self, heading: Heading) -> bool {
        let other = if heading == Heading::Backward { Target::Offset } else { Target::MinusOffset };
        matches!(self.state, State::Moves { target, .. } if target == other)
    }

    /// Stops the motor with DEC.
    pub(super) fn stop(&mut self, servo: &mut Servo) {
        if self.state != State::None {
            self.interrupt();
            servo.stop();
        }
    }

    /// Stops the motor with the present DEC, which may differ from the DEC of its move. The remaining
    /// distance of the move is no longer counted down.
    pub(super) fn brake(&mut self, servo: &mut Servo) {
        self.state = State::None;
        servo.brake();
    }

    /// Stops the motor without a ramp.
    pub(super) fn halt(&mut self, at: Instant, servo: &mut Servo, out: &mut dyn Context) {
        self.interrupt();
        servo.halt(at, out);
    }

    fn interrupt(&mut self) {
        self.state = match self.state {
            State::Moves { target, .. } => State::Moves { target, braking: true },
            State::None | State::Rotates => State::None,
        };
    }

    /// Called after USE_HALL was written and before the servo gets it: a move cannot go on with too few sensors.
    /// Returns true if this stops the motor.
    pub(super) fn halls_changed(&mut self, servo: &mut Servo, bank: &mut Words) -> bool {
        if !matches!(self.state, State::Moves { .. }) || !has_too_few_halls(bank) {
            return false;
        }
        let moves = servo.direction() != 0;
        if moves {
            self.stop(servo);
        }
        self.end_move(servo, bank);
        moves
    }

    /// Value of OFFSET. During a move by OFFSET and after its stop this is the remaining distance, otherwise
    /// the value in the bank (RS434-16).
    pub(super) fn offset(&self, servo: &Servo, bank: &Words) -> i64 {
        match self.state {
            State::Moves { target: Target::Offset, .. } => servo.left().into(),
            State::Moves { target: Target::MinusOffset, .. } => servo.left().saturating_neg().into(),
            _ => bank.get(Reg::OFFSET),
        }
    }

    /// Called after OFFSET was written. A motor at standstill then uses this value, and not the remaining
    /// distance of its last move.
    ///
    /// # Errors
    /// The move in progress counts OFFSET down.
    pub(super) fn offset_written(&mut self, servo: &Servo) -> Result<(), Why> {
        match self.state {
            State::Moves { .. } if servo.direction() == 0 => self.state = State::None,
            State::Moves { target: Target::Offset | Target::MinusOffset, .. } => {
                return Err(Why::CountedOffset);
            }
            _ => {}
        }
        Ok(())
    }

    /// Ends a move because another one replaces it or the distance can no longer be counted. OFFSET keeps the
    /// remaining distance.
    fn end_move(&mut self, servo: &Servo, bank: &mut Words) {
        bank.set(Reg::OFFSET, self.offset(servo, bank));
        self.state = State::None;
    }

    /// Takes the end of a move from the servo.
    pub(super) fn follow(&mut self, servo: &Servo, bank: &mut Words) {
        if let State::Moves { braking, .. } = self.state
            && servo.direction() == 0
        {
            bank.set(Reg::OFFSET, self.offset(servo, bank));
            // A stopped shaft may still turn a little, and the remaining distance changes with it.
            if !braking {
                self.state = State::None;
            }
        }
    }
}

/// Returns true if DIRECTION is forward.
pub(super) fn is_forward(bank: &Words) -> bool {
    bank.word(Reg::DIRECTION) != 2
}

/// Returns true if there are too few Hall sensors for a move (RS434-18).
fn has_too_few_halls(bank: &Words) -> bool {
    bank.word(Reg::USE_HALL) < 2
}

/// Copies the selected position to TARGET_POSITION, and returns the counts up to it. A distance beyond the range of a move
/// is limited and does not wrap to the other direction. The next start continues.
fn distance_to_position(servo: &Servo, bank: &mut Words) -> i32 {
    let target = bank.get(match bank.word(Reg::POSITION_N) {
        1 => Reg::TARGET_POSITION1,
        2 => Reg::TARGET_POSITION2,
        3 => Reg::TARGET_POSITION3,
        _ => Reg::TARGET_POSITION4,
    });
    bank.set(Reg::TARGET_POSITION, target);
    (target as i32).saturating_sub(servo.position())
}
