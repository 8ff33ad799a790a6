//! Input pins.

use core::cell::RefCell;

use critical_section::Mutex;
use drivetwin_board::{End, Output};
use drivetwin_firmware::device::{Instant, Spec};
use heapless::Vec;
use lm3s6965::interrupt;

use crate::gpio::{self, Gpio, Port, Wired};
use crate::wires::Wire;
use crate::{QUEUE, clock};

/// Maximum number of input pins of a board.
const MOST: usize = 16;

/// The inputs.
static INPUTS: Mutex<RefCell<Vec<Input, MOST>>> = Mutex::new(RefCell::new(Vec::new()));

struct Input {
    gpio: Gpio,
    end: End,
    /// Level last reported to the drive.
    high: bool,
    /// True if the level has changed since, but could not be reported because the queue was full.
    missed: bool,
}

impl Input {
    /// Reports a change to the drive. For a pulse that is over already, it reports both edges.
    fn changed(&mut self, at: Instant) {
        let high = self.gpio.settle();
        if high == self.high {
            self.tell(at, !high);
        }
        self.tell(at, high);
    }

    /// Reports a new level to the drive. If the queue is full, the level stays unreported.
    fn tell(&mut self, at: Instant, high: bool) {
        self.missed = high != self.high && !QUEUE.push((at, self.end.edge(high)));
        if !self.missed {
            self.high = high;
        }
    }
}

/// Wires pins as [`Board::wire`](drivetwin_board::Board::wire) does.
pub(crate) fn start<const N: usize>(spec: &Spec, wires: &[Wire; N]) -> [(Option<End>, Output<Wired>); N] {
    let wired = wires.map(|(name, gpio)| {
        let end = End::of(spec, name);
        let input = end.filter(|end| end.is_input(spec));
        let rests_high = input.map(|end| end.rests_high(spec));
        if let Some(end) = end {
            if let Some(rests_high) = rests_high {
                gpio.resting(rests_high);
                add(gpio, end, rests_high);
            } else if end.is_open_drain(spec) {
                gpio.open_drain();
            } else {
                gpio.push_pull();
            }
        }
        (end, Output::new(Wired { gpio, rests_high }))
    });
    begin();
    wired
}

/// Adds an input with its idle level.
fn add(gpio: Gpio, end: End, rests_high: bool) {
    with(|inputs| {
        let _ = inputs.push(Input { gpio, end, high: rests_high, missed: false });
    });
}

/// Reports inputs that do not have their idle level, with the time of power-on, and enables the edges of all
/// inputs.
fn begin() {
    with(|inputs| {
        for input in inputs {
            input.gpio.listen(true);
            let high = input.gpio.settle();
            if matches!(input.end, End::Dtr(_)) {
                // A host that is present at the start is not reported as having just connected.
                input.high = high;
            }
            input.tell(Instant::ZERO, high);
        }
    });
}

/// Makes an output an input again, with this idle level.
pub(crate) fn let_go(gpio: Gpio, rests_high: bool) {
    with(|inputs| {
        gpio.release(rests_high);
        gpio.listen(true);
        if let Some(input) = inputs.iter_mut().find(|input| input.gpio == gpio) {
            let high = gpio.settle();
            input.tell(clock::now(), high);
        }
    });
}

/// Makes an input an output.
pub(crate) fn take(gpio: Gpio) {
    with(|inputs| {
        gpio.listen(false);
        gpio.take();
        if let Some(input) = inputs.iter_mut().find(|input| input.gpio == gpio) {
            input.missed = false;
        }
    });
}

/// Reports the present levels of the inputs that could not be reported because the queue was full.
pub(crate) fn tell_missed() {
    with(|inputs| {
        for input in inputs.iter_mut().filter(|input| input.missed) {
            let high = input.gpio.settle();
            input.tell(clock::now(), high);
        }
    });
}

fn edges(port: Port) {
    let at = clock::now();
    let pins = port.changed();
    with(|inputs| {
        for input in inputs.iter_mut().filter(|input| input.gpio.is_in(port, pins)) {
            input.changed(at);
        }
    });
}

/// Calls `act` with the inputs. In a critical section there is no other borrow.
fn with(act: impl FnOnce(&mut Vec<Input, MOST>)) {
    critical_section::with(|cs| {
        if let Ok(mut inputs) = INPUTS.borrow(cs).try_borrow_mut() {
            act(&mut inputs);
        }
    });
}

#[interrupt]
fn GPIOA() {
    edges(gpio::A);
}

#[interrupt]
fn GPIOB() {
    edges(gpio::B);
}

#[interrupt]
fn GPIOC() {
    edges(gpio::C);
}

#[interrupt]
fn GPIOD() {
    edges(gpio::D);
}

#[interrupt]
fn GPIOE() {
    edges(gpio::E);
}

#[interrupt]
fn GPIOF() {
    edges(gpio::F);
}

#[interrupt]
fn GPIOG() {
    edges(gpio::G);
}
