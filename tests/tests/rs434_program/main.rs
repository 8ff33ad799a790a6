//! The user program of the RS 434544 and 434546 (6.6, 6.9): every instruction and operand form from a table
//! typed from the manual, and random programs beside an interpreter of the manual's words.
//!
//! In comments "decision 5" is the fifth under "RS 434544 / 434546" in docs/decisions.md; numbers like 6.9 are
//! the manual's sections.
#![allow(missing_docs, reason = "a test")]

mod flow;
mod oracle;
mod random;
mod table;
