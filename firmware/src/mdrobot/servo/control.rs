//! Control laws of each tick: they compute a duty from the order.

use fixed::types::I40F24;

use super::watch::ControlSample;
use super::{FULL_DUTY, OUTPUTS, Order, Servo, Settings, TICK, ramp};
use crate::device::{Context, Duration, Instant};

/// The speed loop uses the reference this many ms ahead, because the motor follows a ramp 14 to 24 ms late
/// with the factory gains.
const LOOKAHEAD_MS: I40F24 = I40F24::lit("8");
/// Longest time for which a motor may still follow after a ramp has ended.
const MAX_TRAIL: Duration = Duration::millis(200);

impl Servo {
    /// Sets the terminals as the order requires.
    pub(super) fn tick(&mut self, at: Instant, out: &mut dyn Context) {
        self.next = at + TICK;
        let (setpoint, wanted) = match self.order {
            Order::Free | Order::Brake => return self.release(at, self.order == Order::Brake, out),
            Order::Velocity(_) => {
                let goal = I40F24::from_num(self.goal().unwrap_or(0));
                let rate = |slow| ramp::rate(slow, self.settings.max_rpm);
                let (up, down) = (rate(self.settings.slow_start), rate(self.settings.slow_down));
                let setpoint = ramp::next(self.setpoint, goal, up, down);
                let slope = ramp::next(setpoint, goal, up, down) - setpoint;
                let ahead = setpoint.saturating_add(slope.saturating_mul(LOOKAHEAD_MS));
                (setpoint, ahead.max(setpoint.min(goal)).min(setpoint.max(goal)))
            }
            Order::Position { rpm, .. } => {
                let setpoint = self.setpoint_to_target(at, rpm);
                (setpoint, setpoint)
            }
            Order::Open(output) => {
                let duty = of_output(output);
                self.terminals(at, duty.round().to_num(), self.limit(), out);
                return self.check_faults(at, duty, None);
            }
            Order::Torque(torque) => {
                // The duty is the whole supply, and the current limit sets the torque.
                self.terminals(at, i32::from(torque.signum()) * FULL_DUTY, self.allowed(), out);
                return self.check_faults(at, self.applied_duty(at), None);
            }
        };
        self.setpoint = setpoint;
        if setpoint != 0 {
            self.setpoint_since = at;
        }
        if let Some(shorted) = self.is_over(at) {
            return self.release(at, shorted, out);
        }
        let (wanted, emf) = (self.duty_of(wanted), self.back_emf(at));
        let Settings { p_gain, i_gain, .. } = self.settings;
        let motor = &self.feedback.motor;
        let headroom = motor.duty(motor.speed_drop(self.limit().into()));
        let (output, duty) = self.pi.step(wanted - emf, emf, headroom, motor.gain, p_gain, i_gain);
        self.terminals(at, duty.round().to_num(), self.limit(), out);
        self.check_faults(at, output, Some((wanted, emf)));
    }

    /// Returns how to release the motor, if the speed reference stays 0 and the motor is to be released: true
    /// with shorted terminals, false with open terminals (MDROBOT-17).
    pub(super) fn is_over(&self, at: Instant) -> Option<bool> {
        if self.goal() != Some(0) {
            return None;
        }
        match self.settings.stop_status {
            1 => None,
            3 => Some(false),
            _ if self.setpoint != 0 || self.trails(at) => None,
            status => Some(status == 2),
        }
    }

    /// Returns true if the motor has not yet reached standstill after a ramp to 0.
    fn trails(&self, at: Instant) -> bool {
        self.settings.slow_down > 0
            && at.since(self.setpoint_since) < MAX_TRAIL
            && self.reading(at).round() != 0
    }

    /// The speed in rpm at which the ramp ends; `None` without speed control.
    pub(super) fn goal(&self) -> Option<i32> {
        let most = i32::from(self.settings.max_rpm);
        if let Order::Velocity(rpm) = self.order { Some(rpm.clamp(-most, most)) } else { None }
    }

    /// Current limit while the servo controls the motor, in mA: `MAX_LOAD`, or a part of it in torque
    /// control.
    pub(super) fn allowed(&self) -> u32 {
        let Order::Torque(torque) = self.order else { return self.limit() };
        let part =
            u64::from(torque.unsigned_abs().min(OUTPUTS)) * u64::from(self.limit()) / u64::from(OUTPUTS);
        u32::try_from(part).unwrap_or(u32::MAX)
    }

    /// Checks for faults.
    fn check_faults(&mut self, at: Instant, wanted: I40F24, speeds: Option<(I40F24, I40F24)>) {
        let sample = ControlSample {
            ma: self.current(),
            limit_ma: self.limit(),
            wanted,
            speeds,
            rpm: self.speed().rpm(at, self.settings.turn()),
            hall: self.hall_edges.last(),
        };
        self.alarms |= self.faults.update(at, sample);
    }
}

/// The duty of an output in 1/1023 of the supply (MDROBOT-28).
fn of_output(output: i16) -> I40F24 {
    let output = i64::from(output).clamp(-i64::from(OUTPUTS), OUTPUTS.into());
    I40F24::from_num(output * i64::from(FULL_DUTY)) / i64::from(OUTPUTS)
}
