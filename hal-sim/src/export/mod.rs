//! Export of recordings as files for other programs: waveforms and frames.

pub mod pcapng;
pub mod vcd;
