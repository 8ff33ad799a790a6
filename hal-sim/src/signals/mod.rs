//! Signals at pins: step pulses from motion plans, and the outputs of a drive at a pin.

pub(crate) mod pin_waveform;
pub mod pulses;
