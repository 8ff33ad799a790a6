//! Counts the instructions of a step, and of making a plan.
#![no_std]
#![no_main]

use core::cell::UnsafeCell;
use core::ffi::CStr;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m_rt::entry;
use counted::{count, done, group, opaque};
use drivetwin_firmware::device::{Instant, Plan};
use drivetwin_firmware::motion::{Limits, PlanLoader, StepDir, StepGenerator, StepIterator, StepTimer};
use fixed::types::{I24F8, U24F8};

/// State that an interrupt and the loop share on a board.
struct Shared<T>(UnsafeCell<T>);

// SAFETY: this program has no interrupts.
unsafe impl<T> Sync for Shared<T> {}

impl<T> Shared<T> {
    const fn new(value: T) -> Self {
        Self(UnsafeCell::new(value))
    }

    #[inline(always)]
    fn with<R>(&self, act: impl FnOnce(&mut T) -> R) -> R {
        // SAFETY: no code that this program runs in here calls `with` again.
        act(unsafe { &mut *self.0.get() })
    }
}

static WALKER: Shared<StepIterator> = Shared::new(StepIterator::done());
static STEPPER: Shared<StepGenerator<Pins>> = Shared::new(StepGenerator::new(Pins));

/// Stand-ins for the registers of a timer and of two pins.
static COMPARE: AtomicU32 = AtomicU32::new(0);
static STEP: AtomicBool = AtomicBool::new(false);
static DIRECTION: AtomicBool = AtomicBool::new(false);

#[entry]
fn main() -> ! {
    let fast = || towards(800_000_000);
    WALKER.with(|walker| *walker = StepIterator::new(&towards(10_000), Instant::ZERO));
    steps(c"step, one of the first 100 at 10,000 steps/s²", walk, 0, 100);
    steps(c"step in a ramp at 10,000 steps/s²", walk, 900, 10_000);
    WALKER.with(|walker| *walker = StepIterator::new(&towards(500_000), Instant::ZERO));
    steps(c"step in a ramp at 500,000 steps/s²", walk, 200, 1_000);
    WALKER.with(|walker| *walker = StepIterator::new(&fast(), Instant::ZERO));
    steps(c"step in a cruise", walk, 10, 1_000);
    WALKER.with(|walker| *walker = StepIterator::new(&profile(), Instant::ZERO));
    steps(c"step of a move of 10,000", walk, 0, 10_000);

    follow(&towards(500_000));
    steps(c"step and its pulse in a ramp at 500,000 steps/s²", fire, 200, 1_000);
    follow(&fast());
    steps(c"step and its pulse in a cruise", fire, 10, 1_000);

    group(c"plan of a move");
    count(|| plan(profile));
    group(c"plan of a jog");
    count(|| plan(|| towards(10_000)));
    group(c"plan of a reversal");
    let jog = opaque(towards(10_000));
    count(|| {
        plan(|| {
            jog.ramp_to(
                opaque(Instant::from_ticks(16_000_000)),
                opaque(I24F8::from_num(-40_000)),
                opaque(10_000),
            )
        })
    });
    done()
}

/// Makes `skipped` steps without counting, then counts `counted` steps.
fn steps(name: &CStr, step: fn(), skipped: u32, counted: u32) {
    for _ in 0..skipped {
        step();
    }
    group(name);
    for _ in 0..counted {
        count(step);
    }
}

/// Interrupt that gets the next step from the step iterator.
#[inline(never)]
fn walk() {
    if let Some(step) = WALKER.with(Iterator::next) {
        COMPARE.store(step.at.ticks() as u32, Ordering::Relaxed);
        DIRECTION.store(step.forward, Ordering::Relaxed);
    }
}

/// Interrupt that makes a pulse.
#[inline(never)]
fn fire() {
    let due = STEPPER.with(StepGenerator::fire);
    COMPARE.store(due.ticks() as u32, Ordering::Relaxed);
}

/// Makes a plan and its first step, as the loop of a board does.
#[inline(never)]
fn plan(plan: impl FnOnce() -> Plan) {
    let mut walker = StepIterator::new(&opaque(plan()), Instant::ZERO);
    opaque(walker.next());
}

/// A ramp from standstill to 40,000 steps/s.
fn towards(acceleration: u32) -> Plan {
    Plan::at_rest(Instant::ZERO, 0).ramp_to(
        Instant::ZERO,
        opaque(I24F8::from_num(40_000)),
        opaque(acceleration),
    )
}

/// The default move of a new MD3, but longer.
fn profile() -> Plan {
    let rates = Limits::even(opaque(U24F8::from_num(5_000)), opaque(10_000));
    Plan::profile(Instant::ZERO, 0, opaque(10_000), rates)
}

fn follow(plan: &Plan) {
    opaque(PlanLoader::new().load(&mut Timer, plan));
}

struct Pins;

impl StepDir for Pins {
    fn rise(&mut self) {
        STEP.store(true, Ordering::Relaxed);
    }

    fn fall(&mut self) {
        STEP.store(false, Ordering::Relaxed);
    }

    fn set_direction(&mut self, forward: bool) {
        DIRECTION.store(forward, Ordering::Relaxed);
    }
}

struct Timer;

impl StepTimer for Timer {
    type Pins = Pins;

    fn now(&self) -> Instant {
        Instant::ZERO
    }

    fn with<R>(&mut self, act: impl FnOnce(&mut StepGenerator<Pins>, Instant) -> R) -> Option<R> {
        Some(STEPPER.with(|stepper| act(stepper, Instant::ZERO)))
    }
}
