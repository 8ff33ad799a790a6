//! The step timer: a channel of TIM2, with STEP and DIR.

use drivetwin_board::{Axis, Timer};
use drivetwin_firmware::device::Instant;
use drivetwin_firmware::motion::{HIGH, StepDir};

use crate::timer::{self, Alarm};
use crate::wires::{DIR, STEP};

/// The axis of the board.
pub(crate) static AXIS: Axis<Steps> = Axis::new(StepPins { rose: 0, ready: 0 });

static ALARM: Alarm = Alarm::new(1);

/// Ticks that a level of STEP or DIR lasts before STEP changes: [`HIGH`], and one that has begun already.
const STAYS: u32 = HIGH.ticks() as u32 + 1;

/// Drives STEP and DIR low.
pub(crate) fn start() {
    STEP.drive_low();
    DIR.drive_low();
}

/// What the timer's interrupt does.
#[inline]
pub(crate) fn look() {
    if ALARM.has_come() {
        AXIS.fire();
    }
}

/// The step timer.
pub(crate) struct Steps;

impl Timer for Steps {
    type Pins = StepPins;

    fn now() -> Instant {
        timer::now()
    }

    #[inline]
    fn set(at: Instant) -> bool {
        ALARM.set(at)
    }
}

/// STEP and DIR.
pub(crate) struct StepPins {
    /// When STEP rose last.
    rose: u32,
    /// When it fell or DIR changed, if that was later.
    ready: u32,
}

impl StepDir for StepPins {
    #[inline]
    fn rise(&mut self) {
        wait(self.ready);
        STEP.write(true);
        self.rose = timer::ticks_low();
    }

    #[inline]
    fn fall(&mut self) {
        wait(self.rose);
        STEP.write(false);
        self.ready = timer::ticks_low();
    }

    fn turn(&mut self, forward: bool) {
        DIR.write(forward);
        self.ready = timer::ticks_low();
    }
}

/// Waits for what is left of [`STAYS`].
#[inline]
fn wait(since: u32) {
    while timer::ticks_low().wrapping_sub(since) < STAYS {}
}
