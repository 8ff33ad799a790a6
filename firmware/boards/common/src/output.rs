//! Pins as a drive drives them.

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, OutputPin};

use crate::board_outputs::Release;

/// The end of a wire: a pin of a board, or several.
pub trait Gpio {
    /// Drives a level, unless released. It is driven from then on, and not as soon as it is no longer released, so that
    /// it never drives the level of before.
    fn set(&self, high: bool, released: bool);

    /// Releases the pin and reads it as an input, or ends that.
    fn release(&self, released: bool);
}

/// A pin as the drive drives it.
#[derive(Debug)]
pub struct Output<G> {
    gpio: G,
    released: bool,
}

impl<G: Gpio> Output<G> {
    /// A released pin.
    pub const fn new(gpio: G) -> Self {
        Self { gpio, released: true }
    }
}

impl<G> ErrorType for Output<G> {
    type Error = Infallible;
}

impl<G: Gpio> OutputPin for Output<G> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.gpio.set(false, self.released);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.gpio.set(true, self.released);
        Ok(())
    }
}

impl<G: Gpio> Release for Output<G> {
    fn release(&mut self, released: bool) {
        if released != self.released {
            self.released = released;
            self.gpio.release(released);
        }
    }
}
