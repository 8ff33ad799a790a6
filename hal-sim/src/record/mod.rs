//! Recordings: what happened on a bench, and what was on its lines.

pub mod capture;
pub mod trace;
