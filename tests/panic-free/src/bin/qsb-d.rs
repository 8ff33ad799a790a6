//! Proof that a QSB-D cannot panic.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::qsb::Qsb::d);
