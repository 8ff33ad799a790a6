//! Proof that a QSB-S cannot panic.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::qsb::Qsb::s);
