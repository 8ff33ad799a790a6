//! What each look does: the laws by which an order becomes what the terminals are put to.

use fixed::types::I40F24;

use super::watch::Sight;
use super::{FULL_DUTY, LOOK, OUTPUTS, Order, PROBED, Probe, Servo, Settings, position, ramp};
use crate::device::{Duration, Instant, Sink};

/// The loop is 14 to 24 ms behind a ramp with the gains of the factory, and looks so far ahead, in ms.
const AHEAD_MS: I40F24 = I40F24::lit("8");
/// How long a motor may be behind a ramp.
const TRAILS: Duration = Duration::millis(200);

impl Servo {
    /// When the next look is: in a ms, or at once to measure the winding.
    pub(super) fn look_again(&mut self, at: Instant) {
        let probes = !self.emf.knows_winding();
        (self.probe, self.next) = if probes { (Probe::Due, at + PROBED) } else { (Probe::Not, at + LOOK) };
    }

    /// Looks at the motor, and puts the terminals as the order wants them.
    pub(super) fn look(&mut self, at: Instant, out: &mut dyn Sink) {
        match core::mem::replace(&mut self.probe, Probe::Not) {
            Probe::Due => {
                // At its limit the current tells nothing.
                if self.emf.is_limited() {
                    return self.next = at + LOOK;
                }
                (self.probe, self.next) = (Probe::Back(self.duty), at + PROBED);
                let duty = self.emf.probe(at, self.carries);
                return self.terminals(at, duty, self.carries, out);
            }
            Probe::Back(duty) => {
                // No sooner: a processor may take a tenth of a ms for each of these.
                self.next = at + LOOK;
                return self.terminals(at, duty, self.carries, out);
            }
            Probe::Not => self.look_again(at),
        }
        self.emf.go_on(at);
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
                let pace = I40F24::from_num(position::pace(self.way(), rpm, &self.settings));
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
        let (wanted, emf) = (wanted.saturating_mul(self.emf.per_rpm()), self.felt());
        let Settings { p_gain, i_gain, .. } = self.settings;
        let spare = self.emf.spare(self.limit());
        let (output, duty) = self.pi.step(wanted - emf, emf, spare, p_gain, i_gain);
        self.terminals(at, duty.round().to_num(), self.limit(), out);
        self.see(at, output, Some((wanted, emf)));
    }

    /// Whether the reference of the speed is 0 for good, and the motor left alone: if so, whether it is shorted.
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

    /// Whether the motor has not yet come to the end of a ramp to 0 that is over.
    fn trails(&self, at: Instant) -> bool {
        self.settings.slow_down > 0 && at.since(self.paced) < TRAILS && self.rpm(at) != 0
    }

    /// The speed to which the ramp goes, in rpm.
    pub(super) fn goal(&self) -> Option<i32> {
        let most = i32::from(self.settings.max_rpm);
        if let Order::Velocity(rpm) = self.order { Some(rpm.clamp(-most, most)) } else { None }
    }

    /// What the terminals may carry while it controls the motor, in mA: MAX_LOAD, or the torque's part of it.
    pub(super) fn allowed(&self) -> u32 {
        let Order::Torque(torque) = self.order else { return self.limit() };
        let part =
            u64::from(torque.unsigned_abs().min(OUTPUTS)) * u64::from(self.limit()) / u64::from(OUTPUTS);
        u32::try_from(part).unwrap_or(u32::MAX)
    }

    /// Whether anything is wrong.
    fn see(&mut self, at: Instant, wanted: I40F24, speeds: Option<(I40F24, I40F24)>) {
        let sight = Sight {
            ma: self.emf.ma(),
            limit_ma: self.limit(),
            wanted,
            speeds,
            rpm: self.speed().rpm(at, self.settings.turn()),
            hall: self.turns.last(),
        };
        self.alarms |= self.watch.look(at, sight);
    }
}

/// The duty of an output in 1/1023 of the supply.
fn of_output(output: i16) -> I40F24 {
    let output = i64::from(output).clamp(-i64::from(OUTPUTS), OUTPUTS.into());
    I40F24::from_num(output * i64::from(FULL_DUTY)) / i64::from(OUTPUTS)
}
