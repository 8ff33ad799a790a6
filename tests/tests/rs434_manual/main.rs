//! The manual of the RS 434544 and 434546 as a test: its tables, and each section of chapter 6 with its
//! examples, over the bus and the pins, as a master sees them. Values and times are typed from the manual or
//! computed in the comments. The instructions of 6.9 are tested in `rs434_program`.
//!
//! Where the manual is silent or contradicts itself, docs/decisions has the project's decision
//! (`RS434-5`). Numbers like 6.5 are sections of the manual.
#![allow(missing_docs, reason = "a test")]

mod bus;
mod errors;
mod inputs;
mod line;
mod motion;
mod moves;
mod power;
mod registers;
