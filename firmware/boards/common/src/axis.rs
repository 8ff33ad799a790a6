//! An axis that the interrupt of the step timer and the loop share.

use core::cell::RefCell;

use critical_section::Mutex;
use drivetwin_firmware::device::{Duration, Instant};
use drivetwin_firmware::motion::{StepDir, StepGenerator, StepTimer};

/// Time between now and the interrupt for an overdue pulse, so that other interrupts can run.
const BREATH: Duration = Duration::micros(2);

/// The step timer of a board.
pub trait Timer {
    /// The STEP and DIR pins of the axis.
    type Pins: StepDir;

    /// Drives STEP and DIR low.
    fn start();

    /// The present time of the board's clock.
    fn now() -> Instant;

    /// Schedules the interrupt at the timer's tick nearest to `at`; with [`Instant::NEVER`] cancels it.
    /// Returns `false` if that tick is already over; then no interrupt is scheduled.
    fn set(at: Instant) -> bool;
}

/// An axis: a step generator that the interrupt and the loop share.
pub struct Axis<T: Timer>(Mutex<RefCell<StepGenerator<T::Pins>>>);

impl<T: Timer> Axis<T> {
    /// An axis at rest, with STEP and DIR low.
    pub const fn new(pins: T::Pins) -> Self {
        Self(Mutex::new(RefCell::new(StepGenerator::new(pins))))
    }

    /// Handles the timer's interrupt at the time that was [set](Timer::set): makes one pulse. If the next
    /// pulse is overdue by then, it waits for a further interrupt, so that other interrupts can run in
    /// between.
    #[inline]
    pub fn fire(&self) {
        self.lend(|stepper| set::<T>(stepper.fire()));
    }

    /// Looks at the step generator. The timer keeps its time, so this masks interrupts for less time than
    /// [`with`](StepTimer::with).
    pub fn look<R>(&self, look: impl FnOnce(&StepGenerator<T::Pins>) -> R) -> Option<R> {
        self.lend(|stepper| look(stepper))
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

/// Sets the timer to `due`, or as early as the timer can if `due` is over.
fn set<T: Timer>(due: Instant) {
    let mut at = due;
    while !T::set(at) {
        at = T::now() + BREATH;
    }
}
