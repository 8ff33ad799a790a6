//! The user program of the RS 434544 and 434546 (6.6, 6.9): every instruction and operand form from a table
//! typed from the manual, and random programs beside an interpreter of the manual's words.
//!
//! Ids like `RS434-5` are decisions (docs/decisions); numbers like 6.9 are the manual's sections.
#![allow(missing_docs, reason = "a test")]

mod flow;
mod oracle;
mod random;
mod table;
