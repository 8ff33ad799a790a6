//! The step timer: TIMER's first alarm, with STEP and DIR.

use drivetwin_board::{Axis, Timer};
use drivetwin_firmware::device::Instant;
use drivetwin_firmware::motion::{HIGH, StepDir};
use rp2040_pac::interrupt;

use crate::pins;
use crate::timer::{self, Alarm, TICKS};
use crate::wires::{DIR, STEP};

/// The axis of the board.
pub(crate) static AXIS: Axis<Steps> = Axis::new(StepPins { rose: 0, ready: 0 });

static ALARM: Alarm = Alarm::new(0);

/// What a level of STEP or DIR lasts before STEP changes, in µs: [`HIGH`], and one that has begun already.
const STAYS: u32 = (HIGH.ticks() / TICKS) as u32 + 1;

/// Drives STEP and DIR low.
pub(crate) fn start() {
    pins::drive_low(STEP | DIR);
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
        ALARM.set(timer::nearest(at))
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
        self.rose = timer::micros_low();
    }

    #[inline]
    fn fall(&mut self) {
        wait(self.rose);
        pins::set_low(STEP);
        self.ready = timer::micros_low();
    }

    fn turn(&mut self, forward: bool) {
        if forward {
            pins::set_high(DIR)
        } else {
            pins::set_low(DIR)
        }
        self.ready = timer::micros_low();
    }
}

/// Waits for what is left of [`STAYS`].
#[inline]
fn wait(since: u32) {
    while timer::micros_low().wrapping_sub(since) < STAYS {}
}
