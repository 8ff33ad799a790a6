//! Fault detection of a motor that is driven (p. 9; MDROBOT-31).

use fixed::types::I40F24;

use super::pi::FULL;
use crate::device::{Duration, Instant};
use crate::mdrobot::alarm::status;

const OVER_LOAD: Duration = Duration::secs(4);
const STALL: Duration = Duration::secs(1);
const CTRL_FAIL: Duration = Duration::secs(3);
const INV_VEL: Duration = Duration::millis(500);
const ENCODER: Duration = Duration::millis(600);

/// A mistake that shrank by this part since it began is being corrected.
const LESS: i64 = 16;

/// A condition that is a fault if it lasts (on-delay).
#[derive(Clone, Copy, Debug)]
struct OnDelay(Option<Instant>);

impl OnDelay {
    const NOT: Self = Self(None);

    /// Returns whether the condition has lasted for `span`.
    fn is(&mut self, so: bool, at: Instant, span: Duration) -> bool {
        self.0 = so.then(|| self.0.unwrap_or(at));
        self.0.is_some_and(|since| at.since(since) >= span)
    }
}

/// An error that is a fault if it lasts and does not improve.
#[derive(Clone, Copy, Debug)]
struct PersistentError {
    wrong: OnDelay,
    /// By how much it was wrong when it began.
    first: I40F24,
}

impl PersistentError {
    const NOT: Self = Self { wrong: OnDelay::NOT, first: I40F24::ZERO };

    /// Returns whether the error has lasted for `span`, is now `by`, and has not improved in that time.
    fn fails(&mut self, by: Option<I40F24>, at: Instant, span: Duration) -> bool {
        let by_now = by.unwrap_or(I40F24::ZERO);
        if self.wrong.0.is_none() {
            self.first = by_now;
        }
        if !self.wrong.is(by.is_some(), at, span) {
            return false;
        }
        let less = by_now < self.first - self.first / LESS;
        if less {
            *self = Self { wrong: OnDelay(Some(at)), first: by_now };
        }
        !less
    }
}

/// Readings of a control tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    /// Current in mA.
    pub(super) ma: i32,
    /// MAX_LOAD.
    pub(super) limit_ma: u32,
    /// The output that it is to have, as a duty; a limit of the current may leave less of it.
    pub(super) wanted: I40F24,
    /// The speed that it is to have and the one that its sensor reads, as duties; none without control of the speed.
    pub(super) speeds: Option<(I40F24, I40F24)>,
    /// By the sensor that tells the speed.
    pub(super) rpm: i32,
    /// The last edge of a Hall sensor.
    pub(super) hall: Option<Instant>,
}

/// Conditions that may become faults, and their times.
#[derive(Clone, Debug)]
pub(super) struct FaultMonitor {
    load: OnDelay,
    stands: OnDelay,
    fails: PersistentError,
    inverse: PersistentError,
    /// Since the last edge of the encoder: the first edge of a Hall sensor, and its count.
    silent: Option<(Instant, i64)>,
}

impl FaultMonitor {
    /// State without any condition.
    pub(super) const NEW: Self = Self {
        load: OnDelay::NOT,
        stands: OnDelay::NOT,
        fails: PersistentError::NOT,
        inverse: PersistentError::NOT,
        silent: None,
    };

    /// Takes the readings of a control tick; returns the fault bits.
    pub(super) fn look(&mut self, at: Instant, sight: Sight) -> u16 {
        let mut alarms = 0;
        if self.load.is(sight.ma != 0 && sight.ma.unsigned_abs() >= sight.limit_ma, at, OVER_LOAD) {
            alarms |= status::OVER_LOAD;
        }
        let moved = sight.hall.is_some_and(|hall| at.since(hall) < STALL);
        if self.stands.is(sight.wanted.abs() > FULL / 2, at, STALL) && !moved {
            alarms |= status::STALL;
        }
        // A reference of 0 has no half.
        let off = sight.speeds.filter(|(wanted, _)| *wanted != 0).and_then(|(wanted, speed)| {
            let off = (wanted - speed).abs();
            (off > wanted.abs() / 2).then_some(off)
        });
        if self.fails.fails(off, at, CTRL_FAIL) {
            alarms |= status::CTRL_FAIL;
        }
        let against = sight.speeds.and_then(|(wanted, _)| {
            (wanted.signum() * i64::from(sight.rpm.signum()) < 0).then(|| I40F24::from_num(sight.rpm).abs())
        });
        if self.inverse.fails(against, at, INV_VEL) {
            alarms |= status::INV_VEL;
        }
        alarms
    }

    /// The encoder made an edge.
    pub(super) fn encoder_edge(&mut self) {
        self.silent = None;
    }

    /// The Hall sensors made an edge and count so much; that is `turn` a turn, in which the encoder is to make
    /// `edges`. Returns what is wrong: it has turned for a while, and as far as two of those.
    pub(super) fn hall_edge(&mut self, at: Instant, count: i64, turn: i64, edges: i64) -> u16 {
        let (since, first) = *self.silent.get_or_insert((at, count));
        let missed = count.abs_diff(first).saturating_mul(edges.unsigned_abs());
        if at.since(since) >= ENCODER && missed >= 2 * turn.unsigned_abs() {
            status::HALL_FAIL | status::ENCODER_FAIL
        } else {
            0
        }
    }
}
