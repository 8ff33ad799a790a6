//! A plan that fails becomes a smaller one that fails in the same way.

use standin_firmware::device::Duration;

use crate::oracle::{self, Failure};
use crate::plan::{Plan, Step};

/// Plans that are tried at most.
const MOST_TRIED: u32 = 1_500;

/// A plan that fails in the same way, and that is no smaller by any part, step, byte or wait that is taken away alone.
pub(crate) fn shrink(plan: Plan, failure: &Failure) -> Plan {
    let mut shrinking = Shrinking { plan, failure, tried: 0 };
    loop {
        let before = shrinking.plan.clone();
        shrinking.take_away(|plan| &mut plan.steps);
        shrinking.take_away(|plan| &mut plan.parts);
        shrinking.simplify();
        if shrinking.plan == before || shrinking.tried >= MOST_TRIED {
            return shrinking.plan;
        }
    }
}

struct Shrinking<'a> {
    plan: Plan,
    failure: &'a Failure,
    tried: u32,
}

impl Shrinking<'_> {
    /// Takes a plan if it fails in the same way; whether it does.
    fn try_plan(&mut self, plan: Plan) -> bool {
        self.tried += 1;
        let same = self.tried <= MOST_TRIED
            && oracle::judge(&plan).is_err_and(|other| other.what == self.failure.what);
        if same {
            self.plan = plan;
        }
        same
    }

    /// Takes away runs of a list, long ones first.
    fn take_away<T: Clone>(&mut self, list: impl Fn(&mut Plan) -> &mut Vec<T>) {
        let mut run = list(&mut self.plan).len();
        while run > 0 {
            let mut from = 0;
            while from < list(&mut self.plan).len() {
                let mut smaller = self.plan.clone();
                let items = list(&mut smaller);
                items.drain(from..(from + run).min(items.len()));
                if !self.try_plan(smaller) {
                    from += run;
                }
            }
            run /= 2;
        }
    }

    /// Makes steps simpler, each alone.
    fn simplify(&mut self) {
        for n in 0..self.plan.steps.len() {
            for step in simpler(&self.plan.steps[n]) {
                let mut simpler = self.plan.clone();
                simpler.steps[n] = step;
                if self.try_plan(simpler) {
                    break;
                }
            }
        }
    }
}

/// What a step may become.
fn simpler(step: &Step) -> Vec<Step> {
    match step {
        Step::Wait(time) if *time > Duration::TICK => {
            vec![Step::Wait(Duration::TICK), Step::Wait(Duration::from_ticks(time.ticks() / 2))]
        }
        Step::Say(who, bytes) if bytes.len() > 1 => {
            let half = bytes.len() / 2;
            [&bytes[..half], &bytes[half..], &bytes[..bytes.len() - 1], &bytes[1..]]
                .map(|bytes| Step::Say(*who, bytes.to_vec()))
                .to_vec()
        }
        Step::Pulse(drive, pin, count, hz) if *count > 1 => vec![Step::Pulse(drive, *pin, 1, *hz)],
        _ => Vec::new(),
    }
}
