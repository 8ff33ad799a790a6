//! What the drive does with its motor: ramps, moves, and what its Hall sensors and its current tell.

use crate::device::{Instant, Sink};

/// What a motion goes by (6.5).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Settings {
    /// SPEED, in rpm.
    pub(super) speed: u16,
    /// ACC and DEC, as the registers hold them.
    pub(super) acc: u16,
    pub(super) dec: u16,
    /// RATED_SPEED, in rpm.
    pub(super) rated: u16,
    /// PULSES_PER_REVOLUTION.
    pub(super) pulses: u16,
    /// USE_HALL.
    pub(super) halls: u16,
    /// REF_CURRENT, in mA.
    pub(super) limit_ma: u32,
    /// MODE_COIL: the terminals are closed while the motor stands.
    pub(super) closed: bool,
}

/// The drive's half of the motor.
#[derive(Clone, Debug)]
pub(super) struct Servo {
    settings: Settings,
}

impl Servo {
    /// A motor that stands, its terminals as MODE_COIL says. Power has come, or comes again.
    pub(super) fn new(_at: Instant, settings: Settings, _out: &mut dyn Sink) -> Self {
        Self { settings }
    }

    /// Registers have been written. Continuous rotation follows at once, a move keeps what it began with; the
    /// terminals of a motor that stands, the Hall sensors and the limit of the current follow at once, too.
    pub(super) fn set(&mut self, _at: Instant, settings: Settings, _out: &mut dyn Sink) {
        self.settings = settings;
    }

    /// Continuous rotation, or the other way by way of standstill.
    pub(super) fn rotate(&mut self, _at: Instant, _forward: bool, _out: &mut dyn Sink) {}

    /// So many counts on from where it is, with two Hall sensors. Where it stops lies `compensation` counts further
    /// along the motion, and counts as the goal. None to go is no motion.
    pub(super) fn go(&mut self, _at: Instant, _counts: i32, _compensation: i16, _out: &mut dyn Sink) {}

    /// To standstill with DEC.
    pub(super) fn stop(&mut self, _at: Instant, _out: &mut dyn Sink) {}

    /// To standstill without a ramp.
    pub(super) fn halt(&mut self, _at: Instant, _out: &mut dyn Sink) {}

    /// A Hall sensor changed: A, or else B.
    pub(super) fn edge(&mut self, _at: Instant, _a: bool, _high: bool, _out: &mut dyn Sink) {}

    /// The motor draws so many mA.
    pub(super) fn draws(&mut self, _at: Instant, _ma: i32) {}

    pub(super) fn deadline(&self) -> Instant {
        Instant::NEVER
    }

    /// It is due: the next look at the motor.
    pub(super) fn timeout(&mut self, _at: Instant, _out: &mut dyn Sink) {}

    /// What moves: 0 nothing, 1 forward, −1 backward. Braking is moving.
    pub(super) fn direction(&self) -> i8 {
        0
    }

    /// Edges counted, forward less backward.
    pub(super) fn position(&self) -> i32 {
        0
    }

    /// CLR_POSITION: it is 0 here. A move that runs ends where it would have.
    pub(super) fn clear_position(&mut self) {}

    /// Counts that are left of the last move, also of one that was stopped; 0 of one that has arrived.
    pub(super) fn left(&self) -> i32 {
        0
    }

    /// SPEED_VALID, in rpm.
    pub(super) fn speed(&self, _at: Instant) -> u16 {
        0
    }

    /// CURRENT_VALID, in mA.
    pub(super) fn current(&self) -> u16 {
        0
    }

    /// Bits of ERROR that have come up since it was asked last: 4 no Hall edges where there should be some, 11
    /// the limit of the current holds the motor back, 12 less way left than it takes to stop.
    pub(super) fn errors(&mut self) -> u16 {
        0
    }
}
