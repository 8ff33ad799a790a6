//! The loop of the speed: P_GAIN and I_GAIN (p. 15; MDROBOT-30).

use fixed::types::I40F24;

use super::FULL_DUTY;
use crate::motor::ratio;

/// The whole supply, as a duty.
pub(super) const FULL: I40F24 = I40F24::const_from_int(FULL_DUTY as i64);

/// Proportional gain of one of P_GAIN: duty for a speed error, in parts of the duty that makes as much back-EMF; 2 for
/// the 6,000 of the factory.
const P: I40F24 = I40F24::lit("0.000333333");
/// Integral gain of one of I_GAIN, a ms: 70 a second for the 6,000 of the factory.
const I: I40F24 = I40F24::lit("0.0000116667");

/// The part of a limit of the current by which the loop asks for more: so the limit, and no rounding, holds it.
const BEYOND: i64 = 64;

/// The loop of the speed. All of it is in duties: a speed is the duty that makes as much back-EMF.
#[derive(Clone, Debug)]
pub(super) struct Pi {
    integral: I40F24,
}

impl Pi {
    /// With nothing gathered.
    pub(super) const NEW: Self = Self { integral: I40F24::ZERO };

    /// Continues from that output.
    pub(super) fn begin(&mut self, output: I40F24) {
        self.integral = output.clamp(-FULL, FULL);
    }

    /// The output for the next ms, and what the motor gets of it, which has a back-EMF of `emf` and gets no more than
    /// `spare` beyond it.
    ///
    /// `gain` is the part of the way to its final speed that the motor makes in a ms. A loop without a clock would
    /// answer what is left of the mistake while it shrinks; so does this one, and the fastest motor does not swing.
    ///
    /// While that holds it back it gathers no more than what is got, or it would overshoot; unless the motor stands,
    /// which is pushed until it breaks loose or something is wrong.
    pub(super) fn step(
        &mut self,
        mistake: I40F24,
        emf: I40F24,
        spare: I40F24,
        gain: I40F24,
        p_gain: u16,
        i_gain: u16,
    ) -> (I40F24, I40F24) {
        let spare = spare + spare / BEYOND;
        let got = |output: I40F24| output.min(emf + spare).max(emf - spare).clamp(-FULL, FULL);
        if emf != 0 {
            self.integral = got(self.integral);
        }
        let p = P * I40F24::from_num(p_gain);
        let p = ratio(p.to_bits(), (I40F24::ONE + p * gain).to_bits());
        let push = mistake.saturating_mul(p);
        let before = self.integral;
        let step = mistake.saturating_mul(I * I40F24::from_num(i_gain));
        let gathered = before.saturating_add(step).clamp(-FULL, FULL);
        let output = push.saturating_add(gathered);
        let duty = got(output);
        self.integral = if i_gain == 0 {
            I40F24::ZERO
        } else if output == duty || emf == 0 {
            gathered
        } else {
            (duty - push).min(before.max(gathered)).max(before.min(gathered))
        };
        let output = push.saturating_add(self.integral);
        (output.clamp(-FULL, FULL), got(output))
    }
}
