//! An axis whose pulses take longer than the shortest time between two steps, and reports of slipped steps to
//! the drive.
#![allow(missing_docs, reason = "a test")]

use std::cell::{Cell, RefCell};
use std::convert::Infallible;

use drivetwin_board::{Axis, AxisPins, BoardOutputs, Bus, Release, Timer, untold};
use drivetwin_firmware::device::{self, Duration, Instant, Line, Plan};
use drivetwin_firmware::motion::{PlanLoader, StepDir, StepTimer};
use drivetwin_firmware::shell::{BoardEvent, Outputs};
use embedded_hal::digital::OutputPin;
use embedded_io::{Write, WriteReady};
use embedded_storage::{ReadStorage, Storage};
use fixed::types::I24F8;

/// Time for which STEP is high, and then low, at the shortest.
const LEVEL: Duration = Duration::micros(3);

thread_local! {
    static NOW: Cell<Instant> = const { Cell::new(Instant::ZERO) };
    /// Time of the next timer interrupt.
    static DUE: Cell<Instant> = const { Cell::new(Instant::NEVER) };
    static ROSE: RefCell<Vec<Instant>> = const { RefCell::new(Vec::new()) };
}

/// A timer that itself takes no time.
struct Clock;

impl Timer for Clock {
    type Pins = Pins;

    fn start() {}

    fn now() -> Instant {
        NOW.get()
    }

    fn set(at: Instant) -> bool {
        let comes = at > NOW.get();
        DUE.set(if comes { at } else { Instant::NEVER });
        comes
    }
}

struct Pins;

impl StepDir for Pins {
    fn rise(&mut self) {
        ROSE.with_borrow_mut(|rose| rose.push(NOW.get()));
    }

    fn fall(&mut self) {
        NOW.set(NOW.get() + LEVEL + LEVEL);
    }

    fn set_direction(&mut self, _forward: bool) {}
}

fn made() -> usize {
    ROSE.with_borrow(Vec::len)
}

/// Advances the time to `until`, and calls the interrupt whenever it is due.
fn run(axis: &Axis<Clock>, until: Instant) {
    while DUE.get() <= until {
        NOW.set(DUE.replace(Instant::NEVER));
        axis.fire();
    }
    NOW.set(until);
}

#[test]
fn pulses_that_are_overdue_let_others_in_between() {
    const STEPS: i32 = 100;
    static AXIS: Axis<Clock> = Axis::new(Pins);
    NOW.set(Instant::from_ticks(1_000_000));
    // The step generator makes at most one step every 4 µs, but a pulse takes 6 µs.
    let _ = (&AXIS).with(|stepper, now| stepper.step(now, STEPS));
    assert!(made() <= 1, "{} pulses in one critical section", made());
    while DUE.get() != Instant::NEVER {
        let (before, free) = (made(), DUE.get().since(NOW.get()));
        assert!(made() == 0 || free >= Duration::micros(1), "the next pulse {} ticks later", free.ticks());
        NOW.set(DUE.replace(Instant::NEVER));
        AXIS.fire();
        assert!(made() <= before + 1, "{} pulses in one interrupt", made() - before);
    }
    assert_eq!(made(), STEPS as usize);
}

#[test]
fn slipped_steps_are_reported_to_the_drive_once() {
    static AXIS: Axis<Clock> = Axis::new(Pins);
    let mut hands = BoardOutputs::<_, Nothing, _, _, 0> {
        bus: Nothing,
        pins: [],
        memory: Nothing,
        axis: &AXIS,
        axis_pins: AxisPins::Own,
        loader: PlanLoader::new(),
        links: None,
    };
    assert_eq!(untold(), None);
    let at = |ms: u64| Instant::from_ticks(ms * 16_000);
    let mut plan = Plan::at_rest(at(0), 0);
    // Two moves at 10,000 steps/s are ordered to stop, each 10 ms late.
    for start in [0, 500] {
        let jog = plan.ramp_to(at(start), I24F8::from_num(10_000), 1_000_000);
        hands.plan(device::Axis(0), &jog);
        run(&AXIS, at(start + 500));
        plan = jog.halt(at(start + 490));
        hands.plan(device::Axis(0), &plan);
    }
    let slipped = made() as i32 - plan.position_at(Instant::NEVER);
    assert!((190..=210).contains(&slipped), "{slipped} slipped");
    assert_eq!(untold(), Some(BoardEvent::StepsCorrection(device::Axis(0), slipped)));
    assert_eq!(untold(), None);
}

/// A bus, a pin and a memory that do nothing.
struct Nothing;

impl embedded_io::ErrorType for Nothing {
    type Error = Infallible;
}

impl WriteReady for Nothing {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(true)
    }
}

impl Write for Nothing {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl Bus for Nothing {
    fn set_line(&mut self, _line: Line) {}
}

impl embedded_hal::digital::ErrorType for Nothing {
    type Error = Infallible;
}

impl OutputPin for Nothing {
    fn set_low(&mut self) -> Result<(), Infallible> {
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl Release for Nothing {
    fn release(&mut self, _released: bool) {}
}

impl AsRef<[u8]> for Nothing {
    fn as_ref(&self) -> &[u8] {
        &[]
    }
}

impl ReadStorage for Nothing {
    type Error = Infallible;

    fn read(&mut self, _offset: u32, _bytes: &mut [u8]) -> Result<(), Infallible> {
        Ok(())
    }

    fn capacity(&self) -> usize {
        0
    }
}

impl Storage for Nothing {
    fn write(&mut self, _offset: u32, _bytes: &[u8]) -> Result<(), Infallible> {
        Ok(())
    }
}
