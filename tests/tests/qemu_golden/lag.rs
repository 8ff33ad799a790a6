//! Position of the motor if the board makes its plans a little late.

use drivetwin_firmware::device::{Duration, Instant};

use crate::expected::Expected;
use crate::patience::{PLANNING, earlier};

/// Delay with which the board makes a plan. It makes a plan from standstill later as a whole, so that all
/// steps are late by the same span. A plan that replaces another one joins in at the present position. There
/// an input that was received a little late also shifts the remaining path by a part of a step, and close to
/// standstill a part of a step takes long. So one step more or less is allowed for each plan that joined in,
/// even after the motor is at rest.
#[derive(Default)]
pub(crate) struct Lag {
    /// Last order to the motor, and true if the motor was at rest at that time.
    told: Option<(Instant, bool)>,
    /// Delays in microseconds that explain all steps since the last order.
    possible: Vec<u64>,
    /// Number of steps made until the last check.
    made: i32,
    /// Number of these steps that are allowed although the trace does not have them.
    aside: i32,
    /// Number of plans that joined in since the motor was at rest.
    joined: i32,
}

impl Lag {
    /// Returns true if one delay explains `made` and all earlier counts of the plan. `made` is the number of
    /// steps at an instant after `since` and before `now`.
    pub(crate) fn explains(&mut self, expected: &Expected, made: i32, since: Instant, now: Instant) -> bool {
        let before = std::mem::replace(&mut self.made, made);
        let told = expected.told(now);
        if told != self.told {
            match told {
                Some((at, true)) if self.joined > 0 => {
                    self.aside = before - expected.steps(at);
                    self.joined = 0;
                }
                Some((_, false)) => self.joined += 1,
                _ => {}
            }
            self.told = told;
            self.possible = (0..=PLANNING.ticks() / Duration::micros(1).ticks()).collect();
        }
        let made = made - self.aside;
        let far = earlier(since, PLANNING);
        let (told, stood) = told.unwrap_or((Instant::ZERO, true));
        if earlier(now, PLANNING) <= told || !stood {
            let turns = expected.turns(far, now);
            let positions = [far, now].into_iter().chain(turns).map(|at| expected.steps(at));
            let (low, high) =
                positions.fold((i32::MAX, i32::MIN), |(low, high), at| (low.min(at), high.max(at)));
            return (low - self.joined..=high + self.joined).contains(&made);
        }
        if expected.steps(far) == made && expected.steps(now) == made {
            return true;
        }
        self.possible.retain(|lag| {
            let lag = Duration::micros(*lag);
            let [from, to] = [since, now].map(|at| expected.steps(earlier(at, lag)));
            (from.min(to)..=from.max(to)).contains(&made)
        });
        !self.possible.is_empty()
    }
}
