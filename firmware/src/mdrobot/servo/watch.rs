//! Fault detection while the servo controls the motor (p. 9; MDROBOT-31).

use fixed::types::I40F24;

use super::pi::FULL;
use crate::debounce::Debounce;
use crate::device::{Duration, Instant};
use crate::mdrobot::alarm::Alarm;

const OVER_LOAD: Duration = Duration::secs(4);
const STALL: Duration = Duration::secs(1);
const CTRL_FAIL: Duration = Duration::secs(3);
const INV_VEL: Duration = Duration::millis(500);
const ENCODER: Duration = Duration::millis(600);

/// An error that shrank by 1/16 since its timer started counts as improving.
const IMPROVED_DIVISOR: i64 = 16;

/// An error that is a fault if it lasts and does not improve.
#[derive(Clone, Copy, Debug)]
struct PersistentError {
    wrong: Debounce,
    /// The size of the error when its timer started.
    first: I40F24,
}

impl PersistentError {
    const NOT: Self = Self { wrong: Debounce::new(false), first: I40F24::ZERO };

    /// Returns true if the error has lasted for `span` and has not improved in that time; `by` is its present
    /// size.
    fn persists(&mut self, by: Option<I40F24>, at: Instant, span: Duration) -> bool {
        let by_now = by.unwrap_or(I40F24::ZERO);
        if !self.wrong.level() && self.wrong.due() == Instant::NEVER {
            self.first = by_now;
        }
        if !self.wrong.has_lasted(at, by.is_some(), span) {
            return false;
        }
        let less = by_now < self.first - self.first / IMPROVED_DIVISOR;
        if less {
            *self = Self { first: by_now, ..Self::NOT };
            self.wrong.note(at, true, span);
        }
        !less
    }
}

/// Readings of a control tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct ControlSample {
    /// Current in mA.
    pub(super) ma: i32,
    /// `MAX_LOAD` in mA.
    pub(super) limit_ma: u32,
    /// The requested output, as a duty. The current limit may reduce it.
    pub(super) wanted: I40F24,
    /// Reference and reading of the speed, as duties; `None` without speed control.
    pub(super) speeds: Option<(I40F24, I40F24)>,
    /// Speed from the edges of the speed sensor, in rpm.
    pub(super) rpm: i32,
    /// Time of the last edge of a Hall sensor.
    pub(super) hall: Option<Instant>,
}

/// Conditions that become faults if they last.
#[derive(Clone, Debug)]
pub(super) struct FaultMonitor {
    load: Debounce,
    standstill: Debounce,
    deviation: PersistentError,
    inverse: PersistentError,
    /// Time and count of the first edge of a Hall sensor after the last edge of the encoder.
    since_encoder_edge: Option<(Instant, i64)>,
}

impl FaultMonitor {
    /// State without any condition.
    pub(super) const NEW: Self = Self {
        load: Debounce::new(false),
        standstill: Debounce::new(false),
        deviation: PersistentError::NOT,
        inverse: PersistentError::NOT,
        since_encoder_edge: None,
    };

    /// Checks the readings of a control tick. Returns the bits of new faults.
    pub(super) fn update(&mut self, at: Instant, sample: ControlSample) -> u16 {
        let mut alarms = 0;
        let is_at_limit = sample.ma != 0 && sample.ma.unsigned_abs() >= sample.limit_ma;
        if self.load.has_lasted(at, is_at_limit, OVER_LOAD) {
            alarms |= Alarm::OverLoad as u16;
        }
        let moved = sample.hall.is_some_and(|hall| at.since(hall) < STALL);
        if self.standstill.has_lasted(at, sample.wanted.abs() > FULL / 2, STALL) && !moved {
            alarms |= Alarm::Stall as u16;
        }
        // A deviation of half the reference has no meaning at reference 0.
        let off = sample.speeds.filter(|(wanted, _)| *wanted != 0).and_then(|(wanted, speed)| {
            let off = (wanted - speed).abs();
            (off > wanted.abs() / 2).then_some(off)
        });
        if self.deviation.persists(off, at, CTRL_FAIL) {
            alarms |= Alarm::CtrlFail as u16;
        }
        let against = sample.speeds.and_then(|(wanted, _)| {
            (wanted.signum() * i64::from(sample.rpm.signum()) < 0).then(|| I40F24::from_num(sample.rpm).abs())
        });
        if self.inverse.persists(against, at, INV_VEL) {
            alarms |= Alarm::InvVel as u16;
        }
        alarms
    }

    /// Handles an edge of the encoder.
    pub(super) fn encoder_edge(&mut self) {
        self.since_encoder_edge = None;
    }

    /// Handles an edge of a Hall sensor. `count` is the present count, `turn` the Hall counts in a turn,
    /// `edges` the encoder's edges in a turn. Returns the alarms of an encoder that fails: it made no edge
    /// for the time `ENCODER`, while the shaft turned by two of its edges.
    pub(super) fn hall_edge(&mut self, at: Instant, count: i64, turn: i64, edges: i64) -> u16 {
        let (since, first) = *self.since_encoder_edge.get_or_insert((at, count));
        let missed = count.abs_diff(first).saturating_mul(edges.unsigned_abs());
        if at.since(since) >= ENCODER && missed >= 2 * turn.unsigned_abs() {
            Alarm::HallFail as u16 | Alarm::EncoderFail as u16
        } else {
            0
        }
    }
}
