//! GPIO pins (8.4).

use crate::inputs;
use crate::registers::Register;

/// A port of 16 pins.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Port(usize);

/// Port A.
pub const A: Port = Port(0);
/// Port B.
pub const B: Port = Port(1);
/// Port C.
pub const C: Port = Port(2);

/// Register for the mode of the pins, with two bits per pin.
const MODE: usize = 0x00;
const INPUT: u32 = 0b00;
const OUTPUT: u32 = 0b01;
const ALTERNATE: u32 = 0b10;
/// Register for the speed of outputs, with two bits per pin.
const SPEED: usize = 0x08;
const FASTEST: u32 = 0b11;
/// Register for the pull resistors, with two bits per pin.
const PULL: usize = 0x0C;
const UP: u32 = 0b01;
const DOWN: u32 = 0b10;
const NONE: u32 = 0b00;
/// Register with the levels of the pins.
const IN: usize = 0x10;
/// Register that sets pins: its lower 16 bits set them high, its upper 16 bits low.
const SET: usize = 0x18;
/// Two registers for the alternate functions, with four bits per pin.
const FUNCTION: usize = 0x20;

impl Port {
    /// Pin `n` of the port.
    ///
    /// `n` is not 0 to 15. In a constant this is a compile error.
    /// `n` is not 0 to 15; in a constant that does not compile.
    #[must_use]
    pub const fn pin(self, n: usize) -> Gpio {
        assert!(n < 16, "a port has pins 0 to 15");
        Gpio { port: self, n, is_lit_low: false }
    }

    /// Number of the port; 0 for port A.
    pub(crate) const fn number(self) -> u32 {
        self.0 as u32
    }

    const fn register(self, offset: usize) -> Register {
        Register::at(0x4002_0000 + 0x400 * self.0, offset)
    }
}

/// A pin of a port.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Gpio {
    port: Port,
    n: usize,
    is_lit_low: bool,
}

impl Gpio {
    /// The same pin, with a light that is lit while the pin is low: a high output of the drive drives the pin
    /// low.
    #[must_use]
    pub const fn lit_low(self) -> Self {
        Self { is_lit_low: true, ..self }
    }

    pub(crate) const fn port(self) -> Port {
        self.port
    }

    /// Number of the pin in its port, which is also the number of its EXTI line.
    pub(crate) const fn n(self) -> usize {
        self.n
    }

    /// A bit that no other pin of the board has.
    pub(crate) const fn place(self) -> u64 {
        1 << (16 * self.port.0 + self.n)
    }

    /// Makes the pin an input that is pulled up or down.
    pub(crate) fn pulled(self, high: bool) {
        self.two_bits(PULL, if high != self.is_lit_low { UP } else { DOWN });
        self.two_bits(MODE, INPUT);
    }

    /// Makes the pin an output, low at first.
    pub(crate) fn drive_low(self) {
        self.write(false);
        self.drive(true);
    }

    /// Makes the pin an output, or an input again.
    pub(crate) fn drive(self, driven: bool) {
        self.two_bits(MODE, if driven { OUTPUT } else { INPUT });
    }

    /// Assigns the pin to a peripheral by the number of the alternate function, with a pull-up.
    pub(crate) fn give(self, function: u32) {
        let shift = 4 * (self.n % 8);
        self.port.register(FUNCTION + 4 * (self.n / 8)).replace(0xF << shift, function << shift);
        self.two_bits(PULL, UP);
        self.two_bits(MODE, ALTERNATE);
    }

    /// Assigns the pin to a peripheral, as a fast output without a pull resistor.
    pub(crate) fn give_fast(self, function: u32) {
        self.give(function);
        self.two_bits(PULL, NONE);
        self.two_bits(SPEED, FASTEST);
    }

    /// Level of the pin.
    #[inline]
    pub(crate) fn is_high(self) -> bool {
        self.port.register(IN).read() & 1 << self.n != 0
    }

    /// Sets the level of the output. If the pin is an input, the level takes effect when it becomes an
    /// output.
    #[inline]
    pub(crate) fn write(self, high: bool) {
        let shift = if high != self.is_lit_low { self.n } else { self.n + 16 };
        self.port.register(SET).write(1 << shift);
    }

    fn two_bits(self, offset: usize, bits: u32) {
        let shift = 2 * self.n;
        self.port.register(offset).replace(0b11 << shift, bits << shift);
    }
}

impl drivetwin_board::Gpio for Gpio {
    fn set(&self, high: bool, released: bool) {
        self.write(high);
        if !released {
            self.drive(true);
        }
    }

    fn release(&self, released: bool) {
        if released {
            self.drive(false);
        }
        inputs::listen(*self, released);
    }
}
