//! Recordings: inputs and outputs of drives (traces), frames on the lines (captures), and messages with
//! their outcomes (journals).

pub mod capture;
pub mod journal;
pub mod trace;
