//! Pins: levels that the drive outputs, and edges that it receives.

use core::cell::Cell;

use critical_section::Mutex;
use drivetwin_board::{End, Gpio, Output};
use drivetwin_firmware::device::{Instant, Spec};

use crate::chip::{DRIVEN_CLEAR, DRIVEN_SET, ENABLED, FUNCTION, IN, OUT_CLEAR, OUT_SET, PAD, RAISED, STATUS};
use crate::{QUEUE, interrupt, timer};

/// Number of pins of the chip.
const GPIOS: u32 = 30;

/// A wire: the name of a drive's pin or fault, and the pins of the board, one bit each. Several pins show the
/// same output.
pub type Wire = (&'static str, u32);

/// The bit of pin `GPn`.
pub(crate) const fn gp(n: u32) -> u32 {
    1 << n
}

/// Events of a pin. Each register of interrupts has eight pins, with four bits per pin.
const FELL: u32 = 0b0100;
const ROSE: u32 = 0b1000;

/// Functions of a pin (2.19.2).
const FUNCTION_UART: u32 = 2;
const FUNCTION_SIO: u32 = 5;

/// For each pin, the drive's end of its wire, if the drive reads it.
static ENDS: [Mutex<Cell<Option<End>>>; GPIOS as usize] =
    [const { Mutex::new(Cell::new(None)) }; GPIOS as usize];
/// Levels last reported to the drive, one bit per pin.
static TOLD: Mutex<Cell<u32>> = Mutex::new(Cell::new(0));
/// True if a level was not reported because the queue was full.
static MISSED: Mutex<Cell<bool>> = Mutex::new(Cell::new(false));

/// Drives pins high or low.
#[inline]
pub(crate) fn write(pins: u32, high: bool) {
    if high { OUT_SET.write(pins) } else { OUT_CLEAR.write(pins) }
}

/// Makes pins outputs, low at first.
pub(crate) fn drive_low(pins: u32) {
    OUT_CLEAR.write(pins);
    DRIVEN_SET.write(pins);
    each(pins, |gpio| use_as(gpio, FUNCTION_SIO, false));
}

/// Assigns pins to their UART, with pull-ups.
pub(crate) fn give_to_uart(pins: u32) {
    each(pins, |gpio| use_as(gpio, FUNCTION_UART, true));
}

/// Returns whether a jumper ties a pin to ground.
pub(crate) fn is_tied(pin: u32) -> bool {
    each(pin, |gpio| use_as(gpio, FUNCTION_SIO, true));
    settle();
    IN.read() & pin == 0
}

/// Wires pins as [`Board::wire`](drivetwin_board::Board::wire) does.
pub(crate) fn start<const N: usize>(spec: &Spec, wires: &[Wire; N]) -> [(Option<End>, Output<Pins>); N] {
    let wired = wires.map(|(name, gpios)| (End::of(spec, name), Pins(gpios)));
    for (end, pins) in &wired {
        let Some(end) = *end else { continue };
        let high = end.rests_high(spec);
        each(pins.0, |gpio| use_as(gpio, FUNCTION_SIO, high));
        if end.is_input(spec) {
            critical_section::with(|cs| {
                each(pins.0, |gpio| {
                    if let Some(place) = ENDS.get(gpio as usize) {
                        place.borrow(cs).set(Some(end));
                    }
                });
                let told = TOLD.borrow(cs);
                told.set(if high { told.get() | pins.0 } else { told.get() & !pins.0 });
            });
        }
    }
    settle();
    for (end, pins) in &wired {
        if matches!(end, Some(End::Dtr(_))) {
            // A host that is present at the start is not reported as having just connected.
            critical_section::with(|cs| {
                let told = TOLD.borrow(cs);
                told.set(told.get() & !pins.0 | IN.read() & pins.0);
            });
        }
        pins.listen(Instant::ZERO, true);
    }
    wired.map(|(end, pins)| (end, Output::new(pins)))
}

fn each(pins: u32, act: impl FnMut(u32)) {
    (0..GPIOS).filter(|gpio| pins & gp(*gpio) != 0).for_each(act);
}

fn use_as(gpio: u32, function: u32, pulled_up: bool) {
    const INPUT: u32 = 1 << 6;
    const SCHMITT: u32 = 1 << 1;
    const PULL_UP: u32 = 1 << 3;
    const PULL_DOWN: u32 = 1 << 2;
    let pull = if pulled_up { PULL_UP } else { PULL_DOWN };
    PAD.plus(4 * gpio as usize).write(INPUT | SCHMITT | pull);
    FUNCTION.plus(8 * gpio as usize).write(function);
}

/// Waits until the pull resistors have charged the wires.
fn settle() {
    const MICROS: u32 = 100;
    let since = timer::micros_low();
    while timer::micros_low().wrapping_sub(since) < MICROS {}
}

/// The board's pins on a wire, one bit each.
#[derive(Clone, Copy)]
pub(crate) struct Pins(u32);

impl Pins {
    /// Enables edges from `at` on, or disables them. When enabled, a change of level before `at` is reported.
    fn listen(&self, at: Instant, on: bool) {
        each(self.0, |gpio| {
            let (bank, shift) = (gpio as usize / 8 * 4, gpio % 8 * 4);
            let enabled = ENABLED.plus(bank);
            critical_section::with(|cs| {
                if ENDS.get(gpio as usize).is_none_or(|end| end.borrow(cs).get().is_none()) {
                    return;
                }
                if on {
                    RAISED.plus(bank).write((FELL | ROSE) << shift);
                    enabled.set((FELL | ROSE) << shift);
                    tell(at, gpio, 0);
                } else {
                    enabled.clear((FELL | ROSE) << shift);
                }
            });
        });
    }
}

impl Gpio for Pins {
    fn set(&self, high: bool, released: bool) {
        write(self.0, high);
        if !released {
            DRIVEN_SET.write(self.0);
        }
    }

    fn release(&self, released: bool) {
        if released {
            DRIVEN_CLEAR.write(self.0);
        }
        self.listen(timer::now(), released);
    }
}

#[interrupt]
fn IO_IRQ_BANK0() {
    let at = timer::now();
    for bank in 0..GPIOS.div_ceil(8) {
        let flags = STATUS.plus(4 * bank as usize).read();
        if flags == 0 {
            continue;
        }
        RAISED.plus(4 * bank as usize).write(flags);
        for place in (0..8).filter(|place| flags >> (4 * place) & (FELL | ROSE) != 0) {
            tell(at, 8 * bank + place, flags >> (4 * place));
        }
    }
}

/// Reports to the drive the edges of a pin between the level last reported and the present level. `flags` are
/// the edges that the chip had detected before this function reads the present level.
fn tell(at: Instant, gpio: u32, flags: u32) {
    critical_section::with(|cs| {
        let Some(end) = ENDS.get(gpio as usize).and_then(|end| end.borrow(cs).get()) else { return };
        let told = TOLD.borrow(cs);
        let is_told_high = || told.get() & gp(gpio) != 0;
        let high = IN.read() & gp(gpio) != 0;
        let first = match flags & (FELL | ROSE) {
            FELL => false,
            ROSE => true,
            0 => high,
            _ => !is_told_high(),
        };
        for high in [first, high] {
            if high == is_told_high() {
                continue;
            }
            if QUEUE.push((at, end.edge(high))) {
                told.set(told.get() ^ gp(gpio));
            } else {
                MISSED.borrow(cs).set(true);
                crate::lose();
            }
        }
    });
}

/// Reports levels that were not reported because the queue was full. The edges in between are lost.
pub(crate) fn tell_missed() {
    if critical_section::with(|cs| MISSED.borrow(cs).replace(false)) {
        for gpio in 0..GPIOS {
            critical_section::with(|_| {
                if is_heard(gpio) {
                    tell(timer::now(), gpio, 0);
                }
            });
        }
    }
}

/// Returns whether the edges of a pin are enabled.
fn is_heard(gpio: u32) -> bool {
    ENABLED.plus(gpio as usize / 8 * 4).read() >> (gpio % 8 * 4) & (FELL | ROSE) != 0
}
