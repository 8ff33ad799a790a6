//! Recordings: inputs and outputs of drives (traces), frames on the lines (captures), and messages with
//! their outcomes (journals, requests that are too early, effects of line faults).

pub mod capture;
pub mod early;
pub mod effects;
pub mod journal;
pub mod own_messages;
pub mod requests;
pub mod trace;
