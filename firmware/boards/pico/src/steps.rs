//! The step timer, which is the first alarm of TIMER, with STEP and DIR.

use drivetwin_board::{Axis, StepPins, StepPort, Timer};
use drivetwin_firmware::device::Instant;
use drivetwin_firmware::motion::{Counted, HIGH};

use crate::timer::{self, Alarm, TICKS};
use crate::wires::{DIR, STEP};
use crate::{interrupt, pins};

/// The axis of the board.
pub(crate) static AXIS: Axis<Steps> = Axis::new(Counted::new(StepPins::new()));

static ALARM: Alarm = Alarm::new(0);

#[interrupt]
fn TIMER_IRQ_0() {
    if ALARM.has_come() {
        AXIS.fire();
    }
}

/// The step timer.
pub(crate) struct Steps;

impl Timer for Steps {
    type Pins = Counted<StepPins<Self>>;

    fn start() {
        pins::drive_low(STEP | DIR);
    }

    fn now() -> Instant {
        timer::now()
    }

    #[inline]
    fn set(at: Instant) -> bool {
        ALARM.set(timer::nearest(at))
    }
}

impl StepPort for Steps {
    const STAYS: u32 = (HIGH.ticks() / TICKS) as u32 + 1;

    #[inline]
    fn count() -> u32 {
        timer::micros_low()
    }

    #[inline]
    fn step(high: bool) {
        pins::write(STEP, high);
    }

    fn dir(high: bool) {
        pins::write(DIR, high);
    }
}
