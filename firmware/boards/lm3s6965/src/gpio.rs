//! Output pins (8.5 of the datasheet).

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, OutputPin};

use crate::registers::Register;

/// GPIO port A.
pub(crate) const PORT_A: usize = 0x4000_4000;
/// GPIO port B.
pub(crate) const PORT_B: usize = 0x4000_5000;
/// GPIO port D.
pub(crate) const PORT_D: usize = 0x4000_7000;
/// GPIO port F.
pub(crate) const PORT_F: usize = 0x4002_5000;

const DIR: usize = 0x400;
const AFSEL: usize = 0x420;
const ODR: usize = 0x50C;
const DEN: usize = 0x51C;

/// An output pin.
pub(crate) struct Output {
    /// The port's data register as its address masks it: this pin alone.
    data: Register,
    bit: u32,
}

impl Output {
    /// A pin that is driven both ways, low at first.
    pub(crate) fn push_pull(port: usize, pin: u32) -> Self {
        let bit = 1 << pin;
        let data = Register::at(port, (bit << 2) as usize);
        data.write(0);
        Register::at(port, DIR).set(bit);
        Register::at(port, DEN).set(bit);
        Self { data, bit }
    }

    /// A pin that is pulled low or let go, let go at first.
    pub(crate) fn open_drain(port: usize, pin: u32) -> Self {
        Register::at(port, ODR).set(1 << pin);
        let output = Self::push_pull(port, pin);
        output.data.write(output.bit);
        output
    }
}

/// Hands pins to the peripheral behind them.
pub(crate) fn give(port: usize, pins: u32) {
    Register::at(port, AFSEL).set(pins);
    Register::at(port, DEN).set(pins);
}

impl ErrorType for Output {
    type Error = Infallible;
}

impl OutputPin for Output {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.data.write(0);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.data.write(self.bit);
        Ok(())
    }
}
