//! The step timer: TIMER's first alarm, STEP on GP3 and DIR on GP4.

use rp2040_pac::interrupt;
use standin_board::{Axis, Timer};
use standin_firmware::device::Instant;
use standin_firmware::motion::StepDir;

use crate::clock::{self, Alarm};
use crate::pins;

/// The axis of the board.
pub(crate) static AXIS: Axis<Steps> = Axis::new(StepPins { rose: 0, ready: 0 });

static ALARM: Alarm = Alarm::new(0);

const STEP: u32 = 1 << 3;
const DIR: u32 = 1 << 4;

/// What a level of STEP or DIR lasts before STEP changes, in µs of which the first has begun: 2 to 3 µs.
const STAYS: u32 = 3;

/// Drives STEP and DIR low.
pub(crate) fn start() {
    pins::drive_low(STEP | DIR);
}

/// The step timer.
pub(crate) struct Steps;

impl Timer for Steps {
    type Pins = StepPins;

    fn now() -> Instant {
        clock::now()
    }

    #[inline]
    fn set(at: Instant) -> bool {
        ALARM.set(clock::nearest(at))
    }
}

#[interrupt]
fn TIMER_IRQ_0() {
    if ALARM.has_come() {
        AXIS.fire();
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
        pins::set_high(STEP);
        self.rose = clock::micros_low();
    }

    #[inline]
    fn fall(&mut self) {
        wait(self.rose);
        pins::set_low(STEP);
        self.ready = clock::micros_low();
    }

    fn turn(&mut self, forward: bool) {
        if forward {
            pins::set_high(DIR)
        } else {
            pins::set_low(DIR)
        }
        self.ready = clock::micros_low();
    }
}

/// Waits for what is left of [`STAYS`].
#[inline]
fn wait(since: u32) {
    while clock::micros_low().wrapping_sub(since) < STAYS {}
}
