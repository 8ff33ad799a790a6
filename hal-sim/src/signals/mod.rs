//! Signals at pins: step pulses from plans of motion, and what a device does with a pin.

pub(crate) mod pin_waveform;
pub mod pulses;
