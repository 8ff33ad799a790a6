//! An axis between the interrupt of its step timer and the loop.

use core::cell::RefCell;

use critical_section::Mutex;
use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_firmware::motion::{StepDir, StepGenerator, StepTimer};

/// Lead of the timer for a pulse that is overdue: time for other interrupts.
const BREATH: Duration = Duration::micros(2);

/// The step timer of a board.
pub trait Timer {
    /// The pins of its axis.
    type Pins: StepDir;

    /// Drives STEP and DIR low.
    fn start();

    /// The present time of the board's clock.
    fn now() -> Instant;

    /// Asks for the interrupt at the timer's tick nearest to `at`; at [`Instant::NEVER`] it does not come.
    /// `false` if that tick has gone by: then it does not come.
    fn set(at: Instant) -> bool;
}

/// An axis: a stepper that the interrupt and the loop share.
pub struct Axis<T: Timer>(Mutex<RefCell<StepGenerator<T::Pins>>>);

impl<T: Timer> Axis<T> {
    /// An axis at rest, with STEP and DIR low.
    pub const fn new(pins: T::Pins) -> Self {
        Self(Mutex::new(RefCell::new(StepGenerator::new(pins))))
    }

    /// Carries out the timer's interrupt, at the time that was [set](Timer::set): one pulse. Another one that is
    /// overdue by then waits until the interrupt comes again, so that others are served between.
    #[inline]
    pub fn fire(&self) {
        self.lend(|stepper| set::<T>(stepper.fire()));
    }

    fn lend<R>(&self, act: impl FnOnce(&mut StepGenerator<T::Pins>) -> R) -> Option<R> {
        critical_section::with(|cs| {
            self.0.borrow(cs).try_borrow_mut().ok().map(|mut stepper| act(&mut stepper))
        })
    }
}

impl<T: Timer> StepTimer for &Axis<T> {
    type Pins = T::Pins;

    fn now(&self) -> Instant {
        T::now()
    }

    fn with<R>(&mut self, act: impl FnOnce(&mut StepGenerator<T::Pins>, Instant) -> R) -> Option<R> {
        self.lend(|stepper| {
            let result = act(stepper, T::now());
            set::<T>(stepper.due());
            result
        })
    }
}

/// Sets the timer to `due`, or to as soon as it comes.
fn set<T: Timer>(due: Instant) {
    let mut at = due;
    while !T::set(at) {
        at = T::now() + BREATH;
    }
}
