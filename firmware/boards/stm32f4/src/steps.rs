//! The step timer, which is a channel of TIM2, with STEP and DIR.

use drivetwin_board::{Axis, StepPins, StepPort, Timer};
use drivetwin_firmware::device::Instant;
use drivetwin_firmware::motion::HIGH;

use crate::timer::{self, Alarm};
use crate::wires::{DIR, STEP};

/// The axis of the board.
pub(crate) static AXIS: Axis<Steps> = Axis::new(StepPins::new());

static ALARM: Alarm = Alarm::new(1);

/// Handles the timer's interrupt.
#[inline]
pub(crate) fn look() {
    if ALARM.has_come() {
        AXIS.fire();
    }
}

/// The step timer.
pub(crate) struct Steps;

impl Timer for Steps {
    type Pins = StepPins<Self>;

    fn start() {
        STEP.drive_low();
        DIR.drive_low();
    }

    fn now() -> Instant {
        timer::now()
    }

    #[inline]
    fn set(at: Instant) -> bool {
        ALARM.set(at)
    }
}

impl StepPort for Steps {
    const STAYS: u32 = HIGH.ticks() as u32 + 1;

    #[inline]
    fn count() -> u32 {
        timer::ticks_low()
    }

    #[inline]
    fn step(high: bool) {
        STEP.write(high);
    }

    fn dir(high: bool) {
        DIR.write(high);
    }
}
