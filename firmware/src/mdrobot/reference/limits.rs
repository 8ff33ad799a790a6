//! The limit switches (p. 7; MDROBOT-23).

use super::Environment;
use crate::mdrobot::registers::Pid;
use crate::mdrobot::servo::Order;

/// A slower shaft counts as standing still for the limit switches. From this speed, the ramp of 3,000 rpm in
/// 15 s stops the shaft within one of the 12 counts of a turn. The last edge is then at most a sixth of a
/// second old.
const TURNS_RPM: u32 = 30;

/// Decision of the limit switches about an order.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Verdict {
    /// The order is executed.
    Permits,
    /// The shaft turns towards an open switch, and the order turns it back: the shaft is stopped first.
    Reverses,
    /// The order is dropped.
    Forbids,
}

/// The limit switches at the last check.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// True for the directions, CCW and CW, that the switches forbade.
    forbidden: [bool; 2],
}

impl Limits {
    pub(super) const NONE: Self = Self { forbidden: [false; 2] };

    /// Checks an order against the limit switches (MDROBOT-23). An open switch forbids an order that turns the motor
    /// towards this switch. When a switch opens, the drive also stops a shaft that still turns towards this switch
    /// while a speed or position order slows the shaft down. A later order away from the switch is executed.
    pub(super) fn check(&mut self, order: Order, by_bus: bool, env: &Environment<'_>) -> Verdict {
        let forbids = |way| env.inputs.limit_forbids(env.bank, way);
        let now = [forbids(1), forbids(-1)];
        let before = core::mem::replace(&mut self.forbidden, now);
        if !by_bus {
            return Verdict::Permits;
        }
        let shaft = match env.servo.rpm(env.at) {
            rpm if rpm.unsigned_abs() < TURNS_RPM => 0,
            rpm => rpm,
        };
        // Directions of the order and of the shaft, positive CCW.
        let [way, shaft] = match order {
            Order::Free | Order::Brake => [0, 0],
            Order::Velocity(rpm) => [rpm, shaft],
            // Open loop and torque in the other direction brake the shaft at once.
            Order::Open(part) | Order::Torque(part) => [part.into(), 0],
            // A position order within the window has no distance to go.
            Order::Position { count, .. } => match env.servo.distance_to(count) {
                error if error.unsigned_abs() <= u64::from(env.bank.word(Pid::IN_POSITION).max(1)) => {
                    [0, shaft]
                }
                error => [error.signum() as i32, shaft],
            },
        };
        let has_opened = now.iter().zip(before).any(|(now, before)| *now && !before);
        match order {
            _ if forbids(way) => Verdict::Forbids,
            _ if !forbids(shaft) => Verdict::Permits,
            _ if way == 0 || has_opened => Verdict::Forbids,
            Order::Velocity(_) => Verdict::Reverses,
            // A position order has no ramp.
            _ => Verdict::Permits,
        }
    }
}
