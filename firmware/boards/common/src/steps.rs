//! STEP and DIR, with levels that last as long as a step driver needs (BOARD-2).

use core::marker::PhantomData;

use drivetwin_firmware::motion::StepDir;

/// STEP and DIR of a board, with a counter that wraps at 2^32.
pub trait StepPort {
    /// Number of counts for which a level of STEP or DIR must last before STEP changes:
    /// [`HIGH`](drivetwin_firmware::motion::HIGH), and one more, because the first count may have begun
    /// already.
    const STAYS: u32;

    /// The present count.
    fn count() -> u32;

    /// Drives STEP.
    fn step(high: bool);

    /// Drives DIR.
    fn dir(high: bool);
}

/// STEP and DIR.
#[derive(Debug)]
pub struct StepPins<P> {
    /// Count at which STEP last rose.
    rose: u32,
    /// Count at which STEP last fell, or at which DIR last changed if that was later.
    ready: u32,
    port: PhantomData<P>,
}

impl<P: StepPort> StepPins<P> {
    /// STEP and DIR, both low.
    #[expect(clippy::new_without_default, reason = "a static needs a constant")]
    pub const fn new() -> Self {
        Self { rose: 0, ready: 0, port: PhantomData }
    }

    /// Waits until [`StepPort::STAYS`] counts have passed since `since`.
    #[inline]
    fn wait(since: u32) {
        while P::count().wrapping_sub(since) < P::STAYS {}
    }
}

impl<P: StepPort> StepDir for StepPins<P> {
    #[inline]
    fn rise(&mut self) {
        Self::wait(self.ready);
        P::step(true);
        self.rose = P::count();
    }

    #[inline]
    fn fall(&mut self) {
        Self::wait(self.rose);
        P::step(false);
        self.ready = P::count();
    }

    fn set_direction(&mut self, forward: bool) {
        P::dir(forward);
        self.ready = P::count();
    }
}
