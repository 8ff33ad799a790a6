//! The MDrive's manuals as tests: *MODBUS/TCP Fieldbus Manual* R040611 (FB) and *MCode Programming and
//! Software Reference* R062812 (MC). The tests use both ports and the pins, as a master, a program and a
//! machine do. Values are typed from the manuals, or follow from the arithmetic in the comments. "FB 4.2" is
//! a section, "MC 5-31" a page.
//!
//! Where the manuals are silent or contradict each other, a decision of the project applies (docs/decisions:
//! `MDRIVE-5`).
#![allow(missing_docs, reason = "a test")]

mod connections;
mod console;
mod effects;
mod encoder;
mod errors;
mod functions;
mod hybrid;
mod identification;
mod inputs;
mod manufacturer;
mod motion;
mod outputs;
mod programs;
mod registers;
mod rig;
mod table;
mod trips;
mod variables;
