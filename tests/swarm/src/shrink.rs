//! Shrinks a plan that fails to a smaller plan that fails in the same way.

use drivetwin_firmware::device::Duration;

use crate::plan::{Plan, Step};

/// Most plans that are tried.
const MOST_TRIED: u32 = 1_500;

/// Returns a smaller plan for which `fails` is true. No single part, step or half of a wait can be removed
/// from it without losing the failure, unless the limit of tried plans was reached first.
pub(crate) fn shrink(plan: Plan, fails: impl Fn(&Plan) -> bool) -> Plan {
    let mut shrinking = Shrinking { plan, fails, tried: 0 };
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

struct Shrinking<F> {
    plan: Plan,
    fails: F,
    tried: u32,
}

impl<F: Fn(&Plan) -> bool> Shrinking<F> {
    /// Keeps a plan if it fails. Returns true if it does.
    fn try_plan(&mut self, plan: Plan) -> bool {
        self.tried += 1;
        let fails = self.tried <= MOST_TRIED && (self.fails)(&plan);
        if fails {
            self.plan = plan;
        }
        fails
    }

    /// Removes runs of consecutive items from a list, long runs first.
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

    /// Makes each step simpler on its own.
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

/// Simpler forms of a step.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Who;

    #[test]
    fn shrinking_keeps_the_cause_of_a_failure() {
        let who = Who { drive: "a", port: 0, number: 0 };
        let wait = Step::Wait(Duration::from_ticks(1_000));
        let mut steps = vec![wait.clone(); 20];
        steps[7] = Step::Say(who, vec![1, 2, 3, 4, 5]);
        let plan = Plan { seed: 1, fast: false, parts: vec![String::new(); 5], steps };
        let says = |step: &Step| matches!(step, Step::Say(_, bytes) if bytes.contains(&4));
        let small = shrink(plan, |plan| plan.steps.iter().any(says) && plan.steps.last() == Some(&wait));
        assert_eq!((small.parts, small.steps), (Vec::new(), vec![Step::Say(who, vec![4]), wait]));
    }
}
