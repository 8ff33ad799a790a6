//! Signals over time: the motion of an axis, step pulses from motion plans, the outputs of a drive at a pin, and
//! all of them as waveforms.

pub mod history;
pub mod motion;
pub(crate) mod pin_waveform;
pub mod pulses;
pub mod waveforms;
