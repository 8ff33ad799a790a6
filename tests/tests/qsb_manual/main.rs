//! The QSB Command List 1.28 and the QSB Application Examples 1.5 as a test: each example command, each
//! register and each limit, over the port and the pins, as a host program sees them. Counting is compared
//! with a slow model of the LS7366R's data sheet.
//!
//! Where the manuals are silent or contradict themselves, docs/decisions has the project's decision
//! (`QSB-5`). Registers are named by their numbers, in hex.
#![allow(missing_docs, reason = "a test")]

mod captures;
mod counter;
mod encoder;
mod examples;
mod figures;
mod line;
mod motor;
mod port;
mod registers;
mod replies;
mod rig;
mod saved;
mod slow;
mod streams;
