//! Files for other programs, from recordings: waveforms and frames.

pub mod pcapng;
pub mod vcd;
