//! Position of the motor, if a board makes its plans a little late.

use drivetwin_firmware::device::{Duration, Instant};

use crate::expected::Expected;
use crate::patience::{PLANNING, earlier};

/// Delay by which the board makes a plan that it began late: one from standstill as a whole, so that each step is late
/// by the same span. One that replaces another joins in where it is; there an input that was received a little late
/// also moves the way that follows by a part of a step, and close to standstill that is long: there one step more or
/// less is right for each that joined in, and it still is when the motor is at rest.
#[derive(Default)]
pub(crate) struct Lag {
    /// Last order to the motor, and whether the motor was at rest then.
    told: Option<(Instant, bool)>,
    /// The spans, in microseconds, that explain all steps since.
    possible: Vec<u64>,
    /// Steps made by the last look.
    made: i32,
    /// Steps of these that are right and not in the trace.
    aside: i32,
    /// Plans that joined in since the motor was at rest.
    joined: i32,
}

impl Lag {
    /// Returns whether one lag explains `made`, and all earlier counts of the plan: so many steps were made by an
    /// instant after `since` and before `now`.
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
