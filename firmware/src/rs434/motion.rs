//! Starts and stops of the motor, and its motions: continuous rotation, and moves by OFFSET or to a position
//! (6.2, 6.5).

use super::drive::{Drive, State, Words};
use super::errors::{Errors, error};
use super::reasons::Why;
use super::registers::Reg;
use super::servo::Settings;
use crate::device::{Context, Instant};

/// Direction of a start.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Heading {
    /// As selected by DIRECTION or by the sign of OFFSET.
    Registers,
    /// Forward, selected by IN1 in mode 5 of MODE_EXT_IN.
    Forward,
    /// Backward, or by the negative OFFSET, selected by IN2.
    Backward,
}

/// The motion that was started last.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Motion {
    /// No motion, though the motor may still brake.
    None,
    /// Rotation until a stop.
    Rotates,
    /// A move until its end. A stopped move, until another motion starts or OFFSET is written.
    Moves {
        /// Target.
        target: MoveTarget,
        /// True after the move was stopped on its way, also after it has come to rest.
        braking: bool,
    },
}

/// Target of a move.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum MoveTarget {
    /// By OFFSET, which counts down the remaining distance.
    Offset,
    /// By the negative OFFSET.
    MinusOffset,
    /// To TARGET_POSITION.
    Position,
}

/// Settings of the servo, from the registers.
pub(super) fn settings(bank: &Words, errors: Errors) -> Settings {
    // The injected cause of CURRENT_LIMIT halves the limit, so that this fault has an effect though it does
    // not stop the motor.
    let share = if errors.has_cause(error::CURRENT_LIMIT) { 2 } else { 1 };
    Settings {
        speed: bank.word(Reg::SPEED),
        acc: bank.word(Reg::ACC),
        dec: bank.word(Reg::DEC),
        rated: bank.word(Reg::RATED_SPEED),
        pulses: bank.word(Reg::PULSES_PER_REVOLUTION),
        halls: bank.word(Reg::USE_HALL),
        limit_ma: u32::from(bank.word(Reg::REF_CURRENT)) / share,
        closed: bank.word(Reg::MODE_COIL) == 1,
    }
}

impl Drive {
    /// Passes the settings to the servo. Returns true if they have changed.
    pub(super) fn set_servo(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        let settings = self.servo_settings();
        let changed = self.servo.set(at, settings, out);
        self.other_motor |= changed;
        changed
    }

    pub(super) fn servo_settings(&self) -> Settings {
        settings(&self.bank, self.errors)
    }

    /// Executes written coils and resets them to 0. If one write sets several of them, HARD_STOP has priority
    /// over STOP, and STOP over START (6.2) (RS434-6).
    pub(super) fn apply_coils(&mut self, at: Instant, out: &mut dyn Context) {
        let mut take = |reg| {
            let set = self.bank.word(reg) != 0;
            self.bank.set(reg, 0);
            set
        };
        let (start, stop, hard_stop) = (take(Reg::START_bit), take(Reg::STOP_bit), take(Reg::HARD_STOP_bit));
        let clears = take(Reg::CLR_POSITION_bit);
        if clears {
            self.servo.clear_position();
        }
        let mut done = Ok(());
        if hard_stop {
            self.halt(at, out);
        } else if stop {
            self.stop();
        } else if start && self.is_by_inputs() {
            done = Err(Why::StartedByInputs);
        } else if start {
            done = self.start(at, Heading::Registers, out);
        } else if !clears {
            done = Err(Why::ZeroCoil);
        }
        if let Err(why) = done {
            why.put(at, out);
        }
    }

    /// Starts the motor as MODE_ROTATION selects, unless an error forbids it or a move is in progress.
    ///
    /// # Errors
    /// The reason why nothing starts.
    pub(super) fn start(&mut self, at: Instant, heading: Heading, out: &mut dyn Context) -> Result<(), Why> {
        if self.state != State::Ready {
            return Ok(());
        }
        if self.errors.stop() {
            return Err(Why::HasError);
        }
        let rotation = self.bank.word(Reg::MODE_ROTATION);
        match self.motion {
            Motion::Moves { braking: false, .. } => return Err(Why::MoveRuns),
            Motion::Moves { braking: true, .. } => self.move_over(),
            Motion::Rotates => {
                self.rotate(at, heading, out);
                return if rotation == 1 { Ok(()) } else { Err(Why::Rotates) };
            }
            Motion::None => {}
        }
        if rotation != 1 && self.has_too_few_halls() {
            self.raise(at, error::TOO_FEW_HALLS, out);
            return Err(Why::TooFewHalls);
        }
        let constant = self.bank.get(Reg::OFFSET_CONST);
        if constant != 0 {
            self.bank.set(Reg::OFFSET, constant);
        }
        match rotation {
            1 => {
                self.rotate(at, heading, out);
                Ok(())
            }
            2 => self.move_by_offset(at, heading == Heading::Backward, out),
            _ => self.move_to_position(at, out),
        }
    }

    fn rotate(&mut self, at: Instant, heading: Heading, out: &mut dyn Context) {
        let forward = match heading {
            Heading::Registers => self.is_forward(),
            Heading::Forward => true,
            Heading::Backward => false,
        };
        self.motion = Motion::Rotates;
        self.servo.rotate(at, forward, out);
    }

    fn move_by_offset(&mut self, at: Instant, negative: bool, out: &mut dyn Context) -> Result<(), Why> {
        let offset = self.bank.get(Reg::OFFSET) as i32;
        if negative {
            self.go(at, offset.saturating_neg(), MoveTarget::MinusOffset, out)
        } else {
            self.go(at, offset, MoveTarget::Offset, out)
        }
    }

    fn move_to_position(&mut self, at: Instant, out: &mut dyn Context) -> Result<(), Why> {
        let target = self.bank.get(match self.bank.word(Reg::POSITION_N) {
            1 => Reg::TARGET_POSITION1,
            2 => Reg::TARGET_POSITION2,
            3 => Reg::TARGET_POSITION3,
            _ => Reg::TARGET_POSITION4,
        });
        self.bank.set(Reg::TARGET_POSITION, target);
        // A distance beyond the range of a move is limited and does not wrap to the other direction. The next
        // start continues.
        self.go(at, (target as i32).saturating_sub(self.servo.position()), MoveTarget::Position, out)
    }

    fn go(&mut self, at: Instant, counts: i32, target: MoveTarget, out: &mut dyn Context) -> Result<(), Why> {
        match (counts, target) {
            (0, MoveTarget::Position) => return Err(Why::IsThere),
            (0, MoveTarget::Offset | MoveTarget::MinusOffset) => return Err(Why::NoOffset),
            _ => {}
        }
        self.motion = Motion::Moves { target, braking: false };
        let compensation = self.bank.get(Reg::OFFSET_COMPENSATION) as i16;
        self.servo.go(at, counts, compensation, out)
    }

    /// Runs the motor (`Some`) or stops it (`None`), as selected by an input level.
    pub(super) fn run(&mut self, at: Instant, heading: Option<Heading>, out: &mut dyn Context) {
        if heading.is_none_or(|heading| self.moves_against(heading)) {
            self.stop();
        }
        if let Some(heading) = heading {
            let _ = self.start(at, heading, out);
        }
    }

    /// Returns true if a move by OFFSET is in progress whose target is not that of this heading.
    fn moves_against(&self, heading: Heading) -> bool {
        let other = if heading == Heading::Backward { MoveTarget::Offset } else { MoveTarget::MinusOffset };
        matches!(self.motion, Motion::Moves { target, .. } if target == other)
    }

    /// Stops the motor with DEC.
    pub(super) fn stop(&mut self) {
        if self.motion != Motion::None {
            self.forget_motion();
            self.servo.stop();
        }
    }

    /// Stops the motor with the present DEC, which may differ from the DEC of its move. The remaining
    /// distance of the move is no longer counted down.
    pub(super) fn brake(&mut self) {
        self.motion = Motion::None;
        self.servo.brake();
    }

    /// Stops the motor without a ramp.
    pub(super) fn halt(&mut self, at: Instant, out: &mut dyn Context) {
        self.forget_motion();
        self.servo.halt(at, out);
    }

    fn forget_motion(&mut self) {
        self.motion = match self.motion {
            Motion::Moves { target, .. } => Motion::Moves { target, braking: true },
            Motion::None | Motion::Rotates => Motion::None,
        };
    }

    /// Returns true if DIRECTION is forward.
    pub(super) fn is_forward(&self) -> bool {
        self.bank.word(Reg::DIRECTION) != 2
    }

    /// Sets DIRECTION to the value that an input selects.
    pub(super) fn set_direction(&mut self, at: Instant, direction: i64, out: &mut dyn Context) {
        self.bank.set(Reg::DIRECTION, direction);
        let _ = self.direction_changed(at, out);
    }

    /// Applies a new DIRECTION to continuous rotation at once.
    ///
    /// # Errors
    /// DIRECTION has no effect now, because each input has a direction of its own.
    pub(super) fn direction_changed(&mut self, at: Instant, out: &mut dyn Context) -> Result<(), Why> {
        if self.is_by_both() {
            return Err(Why::DirectionOfInputs);
        }
        if self.motion == Motion::Rotates {
            self.rotate(at, Heading::Registers, out);
        }
        Ok(())
    }

    /// Called after USE_HALL was written and before the servo gets it. The remaining distance of a move needs
    /// two sensors.
    pub(super) fn halls_changed(&mut self, at: Instant, out: &mut dyn Context) {
        if matches!(self.motion, Motion::Moves { .. }) && self.has_too_few_halls() {
            if self.servo.direction() != 0 {
                self.raise(at, error::TOO_FEW_HALLS, out);
                self.stop();
            }
            self.move_over();
        }
    }

    /// Returns true if there are too few Hall sensors for a move (RS434-18).
    fn has_too_few_halls(&self) -> bool {
        self.bank.word(Reg::USE_HALL) < 2
    }

    /// Value of OFFSET. During a move by OFFSET and after its stop this is the remaining distance, otherwise
    /// the value in the bank (RS434-16).
    pub(super) fn offset(&self) -> i64 {
        match self.motion {
            Motion::Moves { target: MoveTarget::Offset, .. } => self.servo.left().into(),
            Motion::Moves { target: MoveTarget::MinusOffset, .. } => {
                self.servo.left().saturating_neg().into()
            }
            _ => self.bank.get(Reg::OFFSET),
        }
    }

    /// Called after OFFSET was written. A motor at standstill then uses this value, and not the remaining
    /// distance of its last move.
    pub(super) fn offset_written(&mut self, at: Instant, out: &mut dyn Context) {
        match self.motion {
            Motion::Moves { .. } if self.servo.direction() == 0 => self.motion = Motion::None,
            Motion::Moves { target: MoveTarget::Offset | MoveTarget::MinusOffset, .. } => {
                Why::CountedOffset.put(at, out);
            }
            _ => {}
        }
        if self.bank.get(Reg::OFFSET_CONST) != 0 {
            Why::CopiedOffset.put(at, out);
        }
    }

    /// Ends a move because another one replaces it or the distance can no longer be counted. OFFSET keeps the
    /// remaining distance.
    fn move_over(&mut self) {
        self.bank.set(Reg::OFFSET, self.offset());
        self.motion = Motion::None;
    }

    /// Takes errors and the end of a move from the servo.
    pub(super) fn update_motion(&mut self, at: Instant, out: &mut dyn Context) {
        let errors = self.servo.errors();
        if errors != 0 {
            self.raise(at, errors, out);
        }
        if let Motion::Moves { braking, .. } = self.motion
            && self.servo.direction() == 0
        {
            self.bank.set(Reg::OFFSET, self.offset());
            // A stopped shaft may still turn a little, and the remaining distance changes with it.
            if !braking {
                self.motion = Motion::None;
            }
        }
    }
}
