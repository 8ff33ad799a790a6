//! Recordings: inputs and outputs of drives (traces), and frames on the lines (captures).

pub mod capture;
pub mod trace;
