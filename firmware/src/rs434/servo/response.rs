//! How the motor answers when it is pushed harder: by how much more it gets faster in a look.

use fixed::types::I40F24;

/// What was pushed in a look, and how much faster the motor got by that; or the differences of two looks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answer {
    /// Voltage beyond the back-EMF, as a speed.
    pub(super) push: I40F24,
    /// Speed after the look less that before it.
    pub(super) change: I40F24,
    /// It turned round meanwhile, so that its friction did, too.
    pub(super) turned: bool,
}

/// Compares look with look: load and friction are in both of them, and so in neither of the differences.
#[derive(Clone, Copy, Debug)]
pub(super) struct Response {
    /// Speed and push at the last look.
    pushed: Option<(I40F24, I40F24)>,
    /// Of the look before that.
    answer: Option<Answer>,
}

impl Response {
    /// Nothing compared so far.
    pub(super) const NEW: Self = Self { pushed: None, answer: None };

    /// At the last look it turned at `speed` and got a `push` for a whole look, if it `tells`. What is different from
    /// the look before.
    pub(super) fn looked(&mut self, speed: I40F24, push: I40F24, tells: bool) -> Option<Answer> {
        let pushed = core::mem::replace(&mut self.pushed, tells.then_some((speed, push)));
        let answer = pushed.filter(|_| tells).map(|(before, push)| Answer {
            push,
            change: speed - before,
            turned: (speed > 0) != (before > 0),
        });
        let before = core::mem::replace(&mut self.answer, answer);
        let (now, before) = (answer?, before?);
        Some(Answer {
            push: now.push - before.push,
            change: now.change - before.change,
            turned: now.turned || before.turned,
        })
    }
}
