//! Starts and stops of the motor, and its motions: rotation, moves by OFFSET or to a position (6.2, 6.5).

use super::drive::{Drive, State, Words};
use super::errors::{Errors, error};
use super::registers::Reg;
use super::servo::Settings;
use crate::device::{Context, Instant};

/// Which way a start goes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Heading {
    /// As DIRECTION, or the sign of OFFSET, selects.
    Registers,
    /// Forward, as IN1 wants in way 5 of MODE_EXT_IN.
    Forward,
    /// Backward, or by the negative OFFSET, as IN2 wants.
    Backward,
}

/// Motion that was ordered.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Motion {
    /// No motion, though it may still brake.
    None,
    /// To rotate until it is stopped.
    Rotates,
    /// A move, until it has arrived; one that was stopped, until another motion begins or OFFSET is written.
    Moves {
        /// Target.
        target: MoveTarget,
        /// True once it was stopped on its way, also after it has come to rest.
        braking: bool,
    },
}

/// Target of a move.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum MoveTarget {
    /// By OFFSET, which counts the remaining distance.
    Offset,
    /// By its negative.
    MinusOffset,
    /// To TARGET_POSITION.
    Position,
}

/// Settings of the servo.
pub(super) fn settings(bank: &Words, errors: Errors) -> Settings {
    // So a fault shows that limits and does not stop.
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
    /// Passes the settings to the servo. Returns whether they have changed.
    pub(super) fn set_servo(&mut self, at: Instant, out: &mut dyn Context) -> bool {
        let settings = self.servo_settings();
        let changed = self.servo.set(at, settings, out);
        self.other_motor |= changed;
        changed
    }

    pub(super) fn servo_settings(&self) -> Settings {
        settings(&self.bank, self.errors)
    }

    /// Carries out written coils. Of several at once the strongest counts; all read 0 again (6.2) (RS434-6).
    pub(super) fn apply_coils(&mut self, at: Instant, out: &mut dyn Context) {
        let mut take = |reg| {
            let set = self.bank.word(reg) != 0;
            self.bank.set(reg, 0);
            set
        };
        let (start, stop, hard_stop) = (take(Reg::START_bit), take(Reg::STOP_bit), take(Reg::HARD_STOP_bit));
        if take(Reg::CLR_POSITION_bit) {
            self.servo.clear_position();
        }
        if hard_stop {
            self.halt(at, out);
        } else if stop {
            self.stop();
        } else if start && !self.is_by_inputs() {
            self.start(at, Heading::Registers, out);
        }
    }

    /// Starts the motor as MODE_ROTATION selects, unless an error forbids it or a move runs.
    pub(super) fn start(&mut self, at: Instant, heading: Heading, out: &mut dyn Context) {
        if self.state != State::Ready || self.errors.stop() {
            return;
        }
        match self.motion {
            Motion::Moves { braking: false, .. } => return,
            Motion::Moves { braking: true, .. } => self.move_over(),
            Motion::Rotates => return self.rotate(at, heading, out),
            Motion::None => {}
        }
        let rotation = self.bank.word(Reg::MODE_ROTATION);
        if rotation != 1 && self.has_too_few_halls() {
            self.raise(at, error::TOO_FEW_HALLS, out);
            return;
        }
        let constant = self.bank.get(Reg::OFFSET_CONST);
        if constant != 0 {
            self.bank.set(Reg::OFFSET, constant);
        }
        match rotation {
            1 => self.rotate(at, heading, out),
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

    fn move_by_offset(&mut self, at: Instant, negative: bool, out: &mut dyn Context) {
        let offset = self.bank.get(Reg::OFFSET) as i32;
        if negative {
            self.go(at, offset.saturating_neg(), MoveTarget::MinusOffset, out);
        } else {
            self.go(at, offset, MoveTarget::Offset, out);
        }
    }

    fn move_to_position(&mut self, at: Instant, out: &mut dyn Context) {
        let target = self.bank.get(match self.bank.word(Reg::POSITION_N) {
            1 => Reg::TARGET_POSITION1,
            2 => Reg::TARGET_POSITION2,
            3 => Reg::TARGET_POSITION3,
            _ => Reg::TARGET_POSITION4,
        });
        self.bank.set(Reg::TARGET_POSITION, target);
        // A way that is longer than any move never goes round the other side: the next start goes on.
        self.go(at, (target as i32).saturating_sub(self.servo.position()), MoveTarget::Position, out);
    }

    fn go(&mut self, at: Instant, counts: i32, target: MoveTarget, out: &mut dyn Context) {
        if counts != 0 {
            self.motion = Motion::Moves { target, braking: false };
            let compensation = self.bank.get(Reg::OFFSET_COMPENSATION) as i16;
            self.servo.go(at, counts, compensation, out);
        }
    }

    /// Lets the motor run, or stops it: what an input asks for as long as it is closed.
    pub(super) fn run(&mut self, at: Instant, heading: Option<Heading>, out: &mut dyn Context) {
        if heading.is_none_or(|heading| self.moves_against(heading)) {
            self.stop();
        }
        if let Some(heading) = heading {
            self.start(at, heading, out);
        }
    }

    /// Returns whether a move by OFFSET runs that is not the one of this heading.
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

    /// Stops the motor with DEC as it is now, which was perhaps not there when its move began. What is left of that
    /// is not counted down any more.
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

    /// Returns whether DIRECTION is forward.
    pub(super) fn is_forward(&self) -> bool {
        self.bank.word(Reg::DIRECTION) != 2
    }

    /// An input gives DIRECTION another value.
    pub(super) fn set_direction(&mut self, at: Instant, direction: i64, out: &mut dyn Context) {
        self.bank.set(Reg::DIRECTION, direction);
        self.direction_changed(at, out);
    }

    /// Continuous rotation follows DIRECTION at once, unless each input has its own direction.
    pub(super) fn direction_changed(&mut self, at: Instant, out: &mut dyn Context) {
        if self.motion == Motion::Rotates && !self.is_by_both() {
            self.rotate(at, Heading::Registers, out);
        }
    }

    /// USE_HALL was written, and the servo does not know yet: what is left of a move can be counted only with two.
    pub(super) fn halls_changed(&mut self, at: Instant, out: &mut dyn Context) {
        if matches!(self.motion, Motion::Moves { .. }) && self.has_too_few_halls() {
            if self.servo.direction() != 0 {
                self.raise(at, error::TOO_FEW_HALLS, out);
                self.stop();
            }
            self.move_over();
        }
    }

    /// Returns whether there are too few Hall sensors to know the place of a move (RS434-18).
    fn has_too_few_halls(&self) -> bool {
        self.bank.word(Reg::USE_HALL) < 2
    }

    /// OFFSET: what is left of a move by it; what was written, or was left of the last one, otherwise (RS434-16).
    pub(super) fn offset(&self) -> i64 {
        match self.motion {
            Motion::Moves { target: MoveTarget::Offset, .. } => self.servo.left().into(),
            Motion::Moves { target: MoveTarget::MinusOffset, .. } => {
                self.servo.left().saturating_neg().into()
            }
            _ => self.bank.get(Reg::OFFSET),
        }
    }

    /// OFFSET was written: a motor that stands goes on with it, and not with what was left of its last move.
    pub(super) fn offset_written(&mut self) {
        if matches!(self.motion, Motion::Moves { .. }) && self.servo.direction() == 0 {
            self.motion = Motion::None;
        }
    }

    /// A move is over, because another one takes its place or nobody can count: OFFSET keeps what is left.
    fn move_over(&mut self) {
        self.bank.set(Reg::OFFSET, self.offset());
        self.motion = Motion::None;
    }

    /// Takes the servo's errors, and the end of its move.
    pub(super) fn update_motion(&mut self, at: Instant, out: &mut dyn Context) {
        let errors = self.servo.errors();
        if errors != 0 {
            self.raise(at, errors, out);
        }
        if let Motion::Moves { braking, .. } = self.motion
            && self.servo.direction() == 0
        {
            self.bank.set(Reg::OFFSET, self.offset());
            // A stopped shaft may still turn a little: the remaining distance of its move follows it.
            if !braking {
                self.motion = Motion::None;
            }
        }
    }
}
