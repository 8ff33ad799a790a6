//! Export of recordings as files for other programs: waveforms, frames, pictures.

pub mod pcapng;
pub mod plot;
pub mod vcd;
