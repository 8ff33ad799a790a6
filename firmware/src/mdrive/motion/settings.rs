//! Settings of the motion, and the user's units: steps, or counts with EE = 1 (MC 7.3.7).

use super::scale::Scale;
use crate::motion::Limits;
use crate::motor::stepper::StepperParameters;

/// Value of CR at which the motor follows a clock without ramps.
const AT_ONCE: u16 = 1_000;

/// Settings of the motion: present values of variables.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::mdrive) struct Settings {
    /// Initial speed VI and maximum speed VM, in steps/s or counts/s.
    pub(in crate::mdrive) start: u32,
    pub(in crate::mdrive) speed: u32,
    /// Acceleration A and deceleration D.
    pub(in crate::mdrive) up: u32,
    pub(in crate::mdrive) down: u32,
    /// MS: microsteps in a full step.
    pub(in crate::mdrive) microsteps: u16,
    /// Settling time MT and delay HT to the holding current, in ms.
    pub(in crate::mdrive) settle_ms: u16,
    pub(in crate::mdrive) hold_delay_ms: u16,
    /// Run current RC and holding current HC, in %.
    pub(in crate::mdrive) run_percent: u8,
    pub(in crate::mdrive) hold_percent: u8,
    /// DE: true if the output bridge is on.
    pub(in crate::mdrive) enabled: bool,
    /// Maximum speed of the rotor, in steps/s: SS of a Hybrid with AS 1 and 2.
    pub(in crate::mdrive) response: u32,
    /// True if the circuitry keeps the field next to a rotor that does not follow: AS of a Hybrid is not 0.
    pub(in crate::mdrive) keeps_field: bool,
    /// LM: reaction to a limit, 1 to 6.
    pub(in crate::mdrive) limit_mode: u8,
    /// Debounce time of the home switch, one of D1 to D4, in ms.
    pub(in crate::mdrive) home_debounce_ms: u8,
    /// JE: true if jog contacts turn the motor.
    pub(in crate::mdrive) jogs: bool,
    /// CM with clock inputs: limits and jog have no effect.
    pub(in crate::mdrive) follows_clock: bool,
    /// Clock ratio CR, in thousandths.
    pub(in crate::mdrive) ratio: u16,
    /// EE: true if the user's units are counts. EL: lines of the encoder.
    pub(in crate::mdrive) closed: bool,
    pub(in crate::mdrive) lines: u16,
    /// Deadband DB and stall factor SF, in counts; SM: continue after a stall; PM: position maintenance.
    pub(in crate::mdrive) deadband: u16,
    pub(in crate::mdrive) stall_factor: u16,
    pub(in crate::mdrive) goes_on_stalled: bool,
    pub(in crate::mdrive) maintains: bool,
    /// The motor and its load.
    pub(in crate::mdrive) machine: StepperParameters,
}

impl Settings {
    /// Scale of the user's units.
    pub(super) fn scale(&self) -> Scale {
        if self.closed { self.closed_scale() } else { Scale::STEPS }
    }

    /// Scale with EE = 1.
    pub(in crate::mdrive) fn closed_scale(&self) -> Scale {
        Scale::new(self.steps_per_rev(), 4 * i64::from(self.lines.max(1)))
    }

    /// Steps of the motor in a revolution.
    pub(super) fn steps_per_rev(&self) -> i64 {
        i64::from(self.machine.steps_per_rev) * i64::from(self.microsteps)
    }

    /// VI, VM, A and D, converted to steps.
    pub(super) fn rates(&self) -> Limits {
        let scale = self.scale();
        Limits {
            start_speed: scale.speed(self.start),
            max_speed: scale.speed(self.speed),
            acceleration: scale.acceleration(self.up),
            deceleration: scale.acceleration(self.down),
        }
    }

    /// Returns true if the motor follows the clock without ramps.
    pub(super) fn follows_at_once(&self) -> bool {
        self.ratio == AT_ONCE
    }

    /// Returns true if PM is in effect, which requires that the bridge is on.
    pub(super) fn keeps_position(&self) -> bool {
        self.closed && self.maintains && self.enabled
    }

    /// Returns true if the bridge is off although the circuitry is on (MC 5-50).
    pub(super) fn lacks_bridge(&self) -> bool {
        self.keeps_field && !self.enabled
    }

    /// Counts off the target that count as a stall.
    pub(super) fn stall_counts(&self) -> i32 {
        self.stall_factor.max(1).into()
    }

    /// Returns true if a limit stops the motor without a ramp.
    pub(super) fn stops_abruptly(&self) -> bool {
        self.limit_mode >= 4
    }
}
