//! STEP and DIR, and the timer that makes them.

use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::{NVIC, SYST};
use drivetwin_board::{Axis, Timer};
use drivetwin_firmware::device::Instant;
use drivetwin_firmware::motion::{HIGH, StepDir, StepTimer};
use lm3s6965::{Interrupt, interrupt};

use crate::clock;
use crate::gpio::{self, Gpio};
use crate::timer::{OneShot, STEP as TIMER};

pub(crate) const STEP: Gpio = gpio::B.pin(3);
pub(crate) const DIR: Gpio = gpio::B.pin(4);

/// The axis.
pub(crate) static AXIS: Axis<Steps> = Axis::new(Pins { rose: 0 });

/// True if the next pulse is later than the timer can count.
static FAR: AtomicBool = AtomicBool::new(false);

#[interrupt]
fn TIMER_1A() {
    TIMER.acknowledge();
    if FAR.load(Ordering::Relaxed) {
        let _ = (&AXIS).with(|_, _| ());
    } else {
        AXIS.fire();
    }
}

/// The step timer.
pub(crate) struct Steps;

impl Timer for Steps {
    type Pins = Pins;

    fn start() {
        STEP.push_pull();
        DIR.push_pull();
    }

    fn now() -> Instant {
        clock::now()
    }

    fn set(at: Instant) -> bool {
        TIMER.stop();
        // An interrupt that became pending during the loop's critical section is for the earlier time, so it
        // is dropped.
        NVIC::unpend(Interrupt::TIMER_1A);
        if at == Instant::NEVER {
            return true;
        }
        let now = clock::now();
        if at <= now {
            return false;
        }
        let ahead = at.since(now);
        FAR.store(ahead > OneShot::LONGEST, Ordering::Relaxed);
        TIMER.start(ahead);
        true
    }
}

/// The pins of the axis.
pub(crate) struct Pins {
    /// Value of SysTick when STEP last rose.
    rose: u32,
}

impl StepDir for Pins {
    fn rise(&mut self) {
        STEP.write(true);
        self.rose = SYST::get_current();
    }

    fn fall(&mut self) {
        // 25 cycles are 8 ticks.
        const CYCLES: u32 = HIGH.ticks() as u32 * 25 / 8;
        while clock::cycles_since(self.rose) < CYCLES {}
        STEP.write(false);
    }

    fn set_direction(&mut self, forward: bool) {
        DIR.write(forward);
    }
}
