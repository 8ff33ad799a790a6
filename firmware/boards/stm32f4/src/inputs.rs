//! Edges that the drive receives (10.2).
//!
//! An EXTI line belongs to all pins with the same number, one per port. Therefore no two inputs may have the
//! same number (`wires`).

use core::cell::Cell;
use core::sync::atomic::{AtomicBool, Ordering};

use critical_section::Mutex;
use drivetwin_board::{End, Output};
use drivetwin_firmware::device::{Instant, Spec};

use crate::gpio::Gpio;
use crate::registers::Register;
use crate::vectors::interrupt;
use crate::wires::Wire;
use crate::{QUEUE, timer};

/// Registers of EXTI (10.3), with one bit per line.
const EXTI: usize = 0x4001_3C00;
const HEARD: Register = Register::at(EXTI, 0x00);
const RISING: Register = Register::at(EXTI, 0x08);
const FALLING: Register = Register::at(EXTI, 0x0C);
const PENDING: Register = Register::at(EXTI, 0x14);
/// Registers that select the port of each line: four registers, with four bits per line (7.2.3).
const PORTS: usize = 0x4001_3808;

/// Number of lines that belong to pins.
const LINES: usize = 16;

/// The input of each line.
static INPUTS: [Mutex<Cell<Option<Input>>>; LINES] = [const { Mutex::new(Cell::new(None)) }; LINES];
/// True if a level was not reported because the queue was full.
static MISSED: AtomicBool = AtomicBool::new(false);

#[derive(Clone, Copy)]
struct Input {
    gpio: Gpio,
    end: End,
    /// Level last reported to the drive.
    high: bool,
}

impl Input {
    /// Clears a pending edge and returns the level of the pin after it.
    fn settle(&self) -> bool {
        let line = 1 << self.gpio.n();
        loop {
            PENDING.write(line);
            let high = self.gpio.is_high();
            if PENDING.read() & line == 0 {
                return high;
            }
        }
    }

    /// Reports a new level to the drive. If the queue is full, the level stays unreported.
    fn tell(&mut self, at: Instant, high: bool) {
        if high == self.high {
        } else if QUEUE.push((at, self.end.edge(high))) {
            self.high = high;
        } else {
            MISSED.store(true, Ordering::Relaxed);
            crate::lose();
        }
    }
}

/// Wires pins as [`Board::wire`](drivetwin_board::Board::wire) does.
pub(crate) fn start<const N: usize>(spec: &Spec, wires: &[Wire; N]) -> [(Option<End>, Output<Gpio>); N] {
    let wired = wires.map(|(name, gpio)| {
        let end = End::of(spec, name);
        if let Some(end) = end {
            let high = end.rests_high(spec);
            gpio.pulled(high);
            if end.is_input(spec) {
                add(Input { gpio, end, high });
            }
        }
        (end, Output::new(gpio))
    });
    settle();
    for line in 0..LINES {
        with(line, |input| {
            let high = input.settle();
            if matches!(input.end, End::Dtr(_)) {
                // A host that is present at the start is not reported as having just connected.
                input.high = high;
            }
            HEARD.set(1 << line);
            input.tell(Instant::ZERO, high);
        });
    }
    wired
}

fn add(input: Input) {
    let line = input.gpio.n();
    let shift = 4 * (line % 4);
    Register::at(PORTS, 4 * (line / 4)).replace(0xF << shift, input.gpio.port().number() << shift);
    RISING.set(1 << line);
    FALLING.set(1 << line);
    if let Some(place) = INPUTS.get(line) {
        critical_section::with(|cs| place.borrow(cs).set(Some(input)));
    }
}

/// Waits until the pull resistors have charged the wires.
pub(crate) fn settle() {
    const MICROS: u32 = 100;
    let since = timer::ticks_low();
    while timer::ticks_low().wrapping_sub(since) < 16 * MICROS {}
}

/// Enables the edges of a pin, or disables them. When enabled, an earlier change of level is reported.
pub(crate) fn listen(gpio: Gpio, on: bool) {
    let line = gpio.n();
    with(line, |input| {
        if input.gpio != gpio {
        } else if on {
            let high = input.settle();
            HEARD.set(1 << line);
            input.tell(timer::now(), high);
        } else {
            HEARD.clear(1 << line);
        }
    });
}

/// Reports levels that were not reported because the queue was full. The edges in between are lost.
pub(crate) fn tell_missed() {
    if MISSED.swap(false, Ordering::Relaxed) {
        let heard = HEARD.read();
        for line in (0..LINES).filter(|line| heard & 1 << line != 0) {
            with(line, |input| {
                let high = input.settle();
                input.tell(timer::now(), high);
            });
        }
    }
}

/// Reports every line with an edge to the drive. For a pulse that is over already, it reports both edges.
fn edges() {
    let at = timer::now();
    let pending = PENDING.read() & HEARD.read();
    for line in (0..LINES).filter(|line| pending & 1 << line != 0) {
        with(line, |input| {
            let high = input.settle();
            if high == input.high {
                input.tell(at, !high);
            }
            input.tell(at, high);
        });
    }
}

/// Calls `act` with the input of a line, if there is one.
fn with(line: usize, act: impl FnOnce(&mut Input)) {
    let Some(place) = INPUTS.get(line) else { return };
    critical_section::with(|cs| {
        let place = place.borrow(cs);
        if let Some(mut input) = place.get() {
            act(&mut input);
            place.set(Some(input));
        }
    });
}

#[interrupt]
fn EXTI0() {
    edges();
}

#[interrupt]
fn EXTI1() {
    edges();
}

#[interrupt]
fn EXTI2() {
    edges();
}

#[interrupt]
fn EXTI3() {
    edges();
}

#[interrupt]
fn EXTI4() {
    edges();
}

#[interrupt]
fn EXTI9_5() {
    edges();
}

#[interrupt]
fn EXTI15_10() {
    edges();
}
