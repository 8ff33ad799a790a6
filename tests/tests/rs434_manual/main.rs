//! The manual of the RS 434544 and 434546 as a test: its tables, and each section of chapter 6 with what it
//! prints, over the bus and the pins, as a master meets them. Values and times are typed from the manual or
//! come from the arithmetic in the comments. The instructions of 6.9 have a test of their own.
//!
//! Where the manual is silent or contradicts itself the project has decided. In comments "decision 5" is the
//! fifth under "RS 434544 / 434546" in docs/decisions.md; numbers like 6.5 are the manual's sections.
#![allow(missing_docs, reason = "a test")]

mod bus;
mod errors;
mod inputs;
mod line;
mod motion;
mod moves;
mod power;
mod registers;
