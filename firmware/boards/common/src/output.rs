//! Output pins of a drive.

use core::convert::Infallible;

use embedded_hal::digital::{ErrorType, OutputPin};

use crate::board_outputs::Release;

/// The board's end of a wire: one pin, or several.
pub trait Gpio {
    /// Drives a level, unless the pin is released. When the release ends, the pin is driven only from the
    /// next `set` on, so that it never drives the level from before.
    fn set(&self, high: bool, released: bool);

    /// If `released`, makes the pin an input and reads it; otherwise stops reading it.
    fn release(&self, released: bool);
}

/// An output pin of a drive.
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
