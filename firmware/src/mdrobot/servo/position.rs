//! Position control: present position, target, and the speed towards it (p. 15; MDROBOT-19).

use fixed::types::I40F24;

use super::{FULL_DUTY, NEAR, Order, Servo};
use crate::device::Instant;

/// At a larger distance no motor is so fast that it would have to brake, in counts.
const FAR: i64 = 1 << 24;
/// The part of what MAX_LOAD can brake that a move takes; the loop of the speed keeps the rest.
const BRAKE_DIVISOR: i64 = 2;
/// The loop of the speed with the gains of the factory is behind its reference by this part of a second at least.
const LAG_PER_S: i64 = 40;
/// And by this part of the motor's time constant: a heavy motor would swing about its target.
const LAG_PART: i64 = 2;

impl Servo {
    /// The speed to go for, in rpm: PV_GAIN for each count that is left, at most `most`, and no more than MAX_LOAD can
    /// brake on that way.
    pub(super) fn setpoint_to_target(&self, at: Instant, most: i32) -> I40F24 {
        const TICKS_PER_S: i64 = 1_000;
        let (turn, motor) = (self.settings.counts(), &self.feedback.motor);
        let left = self.hall_edges.distance(self.distance(), FAR, at, turn, &self.feedback);
        if left.abs() <= NEAR {
            return I40F24::ZERO;
        }
        let sign = left.to_bits().signum();
        let brakes =
            motor.max_deceleration(self.settings.limit_ma, FULL_DUTY, sign) / BRAKE_DIVISOR * TICKS_PER_S;
        // v² = 2·a·(s − v·t), with 60 rpm for a turn in a second.
        let brakes = self.hall_edges.of_sensor(brakes, turn).max(I40F24::ONE).to_num::<i64>();
        let lag_ms = (motor.slowness / LAG_PART).to_num::<i64>().max(TICKS_PER_S / LAG_PER_S);
        let lag = brakes.saturating_mul(lag_ms) / TICKS_PER_S;
        let square = (left.abs().to_bits() >> 8)
            .saturating_mul((2 * 60 * brakes).checked_div(turn).unwrap_or(0))
            >> 16;
        let root = square.saturating_add(lag.saturating_mul(lag)).unsigned_abs().isqrt();
        let braking_speed = root.cast_signed().saturating_sub(lag);
        let most = I40F24::from_num(i64::from(most.clamp(0, u16::MAX.into())).min(braking_speed.max(1)));
        left.saturating_mul(self.settings.pv_gain.into()).min(most).max(-most)
    }

    /// Counts to the target.
    pub(super) fn distance(&self) -> i64 {
        self.distance_to(self.target)
    }

    /// Counts from where the motor is to a position.
    pub(in crate::mdrobot) fn distance_to(&self, position: i32) -> i64 {
        self.zero + i64::from(position) - self.halls.count()
    }

    /// Counts of the Hall sensors, CCW less CW; further than positions go it stays at the last one.
    pub(in crate::mdrobot) fn position(&self) -> i32 {
        of_position(self.halls.count() - self.zero)
    }

    /// The position is 0 here; a position that is held moves along.
    pub(in crate::mdrobot) fn clear_position(&mut self) {
        self.target = of_position(self.distance());
        self.zero = self.halls.count();
        if let Order::Position { count, .. } = &mut self.order {
            *count = self.target;
        }
    }

    /// Target of position control, or the last one, in counts; it moves along when the position is cleared.
    pub(in crate::mdrobot) fn target(&self) -> i32 {
        self.target
    }

    /// The error of position control, in counts; `None` unless it controls the position.
    pub(in crate::mdrobot) fn error(&self) -> Option<i64> {
        matches!(self.order, Order::Position { .. }).then(|| self.distance())
    }
}

/// Counts as a position, or as far as positions go.
fn of_position(counts: i64) -> i32 {
    counts.clamp(i32::MIN.into(), i32::MAX.into()) as i32
}
