//! Control laws of each tick, by which an order becomes a duty.

use fixed::types::I40F24;

use super::watch::Sight;
use super::{FULL_DUTY, OUTPUTS, Order, Servo, Settings, TICK, ramp};
use crate::device::{Context, Duration, Instant};

/// The loop is 14 to 24 ms behind a ramp with the gains of the factory, and looks so far ahead, in ms.
const AHEAD_MS: I40F24 = I40F24::lit("8");
/// Longest time that a motor may be behind a ramp.
const TRAILS: Duration = Duration::millis(200);

impl Servo {
    /// Puts the terminals as the order wants them.
    pub(super) fn tick(&mut self, at: Instant, out: &mut dyn Context) {
        self.next = at + TICK;
        let (pace, wanted) = match self.order {
            Order::Free | Order::Brake => return self.rest(at, self.order == Order::Brake, out),
            Order::Velocity(_) => {
                let goal = I40F24::from_num(self.goal().unwrap_or(0));
                let rate = |slow| ramp::rate(slow, self.settings.max_rpm);
                let (up, down) = (rate(self.settings.slow_start), rate(self.settings.slow_down));
                let pace = ramp::next(self.pace, goal, up, down);
                let slope = ramp::next(pace, goal, up, down) - pace;
                let ahead = pace.saturating_add(slope.saturating_mul(AHEAD_MS));
                (pace, ahead.max(pace.min(goal)).min(pace.max(goal)))
            }
            Order::Position { rpm, .. } => {
                let pace = self.pace_to_target(at, rpm);
                (pace, pace)
            }
            Order::Open(output) => {
                let duty = of_output(output);
                self.terminals(at, duty.round().to_num(), self.limit(), out);
                return self.see(at, duty, None);
            }
            Order::Torque(torque) => {
                // With all of the supply, and the limit of the current where it is to be.
                self.terminals(at, i32::from(torque.signum()) * FULL_DUTY, self.allowed(), out);
                return self.see(at, self.put_out(at), None);
            }
        };
        self.pace = pace;
        if pace != 0 {
            self.paced = at;
        }
        if let Some(shorted) = self.is_over(at) {
            return self.rest(at, shorted, out);
        }
        let (wanted, emf) = (self.duty_of(wanted), self.felt(at));
        let Settings { p_gain, i_gain, .. } = self.settings;
        let motor = &self.feedback.motor;
        let spare = motor.duty(motor.lost(self.limit().into()));
        let (output, duty) = self.pi.step(wanted - emf, emf, spare, motor.gain, p_gain, i_gain);
        self.terminals(at, duty.round().to_num(), self.limit(), out);
        self.see(at, output, Some((wanted, emf)));
    }

    /// Returns whether the speed reference is 0 for good, and the motor is released: if so, whether it is shorted
    /// (MDROBOT-17).
    pub(super) fn is_over(&self, at: Instant) -> Option<bool> {
        if self.goal() != Some(0) {
            return None;
        }
        match self.settings.stop_status {
            1 => None,
            3 => Some(false),
            _ if self.pace != 0 || self.trails(at) => None,
            status => Some(status == 2),
        }
    }

    /// Returns whether the motor is still behind the end of a ramp to 0.
    fn trails(&self, at: Instant) -> bool {
        self.settings.slow_down > 0 && at.since(self.paced) < TRAILS && self.reading(at).round() != 0
    }

    /// The speed to which the ramp goes, in rpm.
    pub(super) fn goal(&self) -> Option<i32> {
        let most = i32::from(self.settings.max_rpm);
        if let Order::Velocity(rpm) = self.order { Some(rpm.clamp(-most, most)) } else { None }
    }

    /// Current limit while it controls the motor, in mA: MAX_LOAD, or the torque's part of it.
    pub(super) fn allowed(&self) -> u32 {
        let Order::Torque(torque) = self.order else { return self.limit() };
        let part =
            u64::from(torque.unsigned_abs().min(OUTPUTS)) * u64::from(self.limit()) / u64::from(OUTPUTS);
        u32::try_from(part).unwrap_or(u32::MAX)
    }

    /// Looks for faults.
    fn see(&mut self, at: Instant, wanted: I40F24, speeds: Option<(I40F24, I40F24)>) {
        let sight = Sight {
            ma: self.current(),
            limit_ma: self.limit(),
            wanted,
            speeds,
            rpm: self.speed().rpm(at, self.settings.turn()),
            hall: self.turns.last(),
        };
        self.alarms |= self.watch.look(at, sight);
    }
}

/// The duty of an output in 1/1023 of the supply (MDROBOT-28).
fn of_output(output: i16) -> I40F24 {
    let output = i64::from(output).clamp(-i64::from(OUTPUTS), OUTPUTS.into());
    I40F24::from_num(output * i64::from(FULL_DUTY)) / i64::from(OUTPUTS)
}
