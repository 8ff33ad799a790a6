//! The speed loop: `P_GAIN` and `I_GAIN` (p. 15; MDROBOT-30).

use fixed::types::I40F24;

use super::FULL_DUTY;
use crate::motor::ratio;

/// The whole supply, as a duty.
pub(super) const FULL: I40F24 = I40F24::const_from_int(FULL_DUTY as i64);

/// Proportional gain for a `P_GAIN` of 1: duty for a speed error, relative to the duty with a back-EMF of
/// that speed. The factory value 6,000 gives 2.
const P: I40F24 = I40F24::lit("0.000333333");
/// Integral gain per ms for an `I_GAIN` of 1. The factory value 6,000 gives 70 per second.
const I: I40F24 = I40F24::lit("0.0000116667");

/// The loop requests 1/64 more than the current limit allows, so that the limit, and not rounding, sets the
/// current.
const HEADROOM_DIVISOR: i64 = 64;

/// The speed loop. All values are duties: a speed is the duty with a back-EMF of that speed.
#[derive(Clone, Debug)]
pub(super) struct Pi {
    integral: I40F24,
}

impl Pi {
    /// State with an integral of 0.
    pub(super) const NEW: Self = Self { integral: I40F24::ZERO };

    /// Continues from the output `output`.
    pub(super) fn begin(&mut self, output: I40F24) {
        self.integral = output.clamp(-FULL, FULL);
    }

    /// Returns the output for the next ms, and the duty that the motor gets. The motor has a back-EMF of
    /// `emf`, and the current limit allows a duty up to `headroom` above and below it.
    ///
    /// In a ms the motor makes a part of the change to its final speed; `gain` is this part. So the error
    /// shrinks during the ms, and a continuous loop would react to this. This loop reduces its proportional
    /// part accordingly, so that even the fastest motor does not oscillate.
    ///
    /// While the limit is active, the integral does not grow beyond the applied duty, which prevents an
    /// overshoot. At standstill the integral continues to grow, until the motor starts to turn or a fault is
    /// raised.
    pub(super) fn step(
        &mut self,
        error: I40F24,
        emf: I40F24,
        headroom: I40F24,
        gain: I40F24,
        p_gain: u16,
        i_gain: u16,
    ) -> (I40F24, I40F24) {
        let headroom = headroom + headroom / HEADROOM_DIVISOR;
        let applied = |output: I40F24| output.min(emf + headroom).max(emf - headroom).clamp(-FULL, FULL);
        if emf != 0 {
            self.integral = applied(self.integral);
        }
        let p = P * I40F24::from_num(p_gain);
        let p = ratio(p.to_bits(), (I40F24::ONE + p * gain).to_bits());
        let proportional = error.saturating_mul(p);
        let before = self.integral;
        let step = error.saturating_mul(I * I40F24::from_num(i_gain));
        let integrated = before.saturating_add(step).clamp(-FULL, FULL);
        let output = proportional.saturating_add(integrated);
        let duty = applied(output);
        self.integral = if i_gain == 0 {
            I40F24::ZERO
        } else if output == duty || emf == 0 {
            integrated
        } else {
            (duty - proportional).min(before.max(integrated)).max(before.min(integrated))
        };
        let output = proportional.saturating_add(self.integral);
        (output.clamp(-FULL, FULL), applied(output))
    }
}
