//! The user program of the RS 434544 and 434546 (6.6, 6.9). Every instruction and operand form is checked
//! with a table typed from the manual. Random programs are compared with an interpreter written from the
//! manual.
//!
//! Ids like `RS434-5` are decisions (docs/decisions). Numbers like 6.9 are sections of the manual.
#![allow(missing_docs, reason = "a test")]

mod flow;
mod oracle;
mod random;
mod table;
