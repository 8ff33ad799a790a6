//! The loop of the speed: P_GAIN and I_GAIN (p. 15).

use fixed::types::I40F24;

/// The whole supply, as a duty.
pub(super) const FULL_DUTY: i32 = 1 << 16;
pub(super) const FULL: I40F24 = I40F24::const_from_int(FULL_DUTY as i64);

/// What one of P_GAIN gives for a mistake of the speed, in parts of the duty that makes as much back-EMF: 2 for
/// the 6,000 of the factory.
const P: I40F24 = I40F24::lit("0.000333333");
/// What one of I_GAIN adds to it in a ms: 70 a second for the 6,000 of the factory.
const I: I40F24 = I40F24::lit("0.0000116667");

/// What stops a motor that is held at standstill and still creeps: it turns too slowly for its current to tell, and
/// the loop has just taken its friction away. A creep makes no more than `STILL_DUTY` of back-EMF; some times that
/// is 25 mA, which no load notices.
const NUDGE: I40F24 = I40F24::lit("20");

/// The loop of the speed. All of it is in duties: a speed is the duty that makes as much back-EMF.
#[derive(Clone, Debug)]
pub(super) struct Pi {
    integral: I40F24,
    /// Which way the motor turned; 0 since it was brought to rest.
    turned: i64,
}

impl Pi {
    /// With nothing gathered.
    pub(super) const NEW: Self = Self { integral: I40F24::ZERO, turned: 0 };

    /// It goes on from that output.
    pub(super) fn begin(&mut self, output: I40F24) {
        self.integral = output.clamp(-FULL, FULL);
    }

    /// The output for the next ms, and what the motor gets of it, which has a back-EMF of `emf` and is not to get more
    /// than `spare` beyond it.
    ///
    /// While that holds it back it gathers no more than what is got, or it would overshoot; unless the motor stands,
    /// which is pushed until it breaks loose or something is wrong.
    pub(super) fn step(
        &mut self,
        mistake: I40F24,
        emf: I40F24,
        spare: I40F24,
        p_gain: u16,
        i_gain: u16,
    ) -> (I40F24, I40F24) {
        let got = |output: I40F24| output.min(emf + spare).max(emf - spare).clamp(-FULL, FULL);
        if emf != 0 {
            self.turned = emf.to_bits().signum();
            self.integral = got(self.integral);
        } else if mistake == 0 && i_gain > 0 {
            self.integral -= NUDGE * core::mem::take(&mut self.turned);
        }
        let push = mistake.saturating_mul(P * I40F24::from_num(p_gain));
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
