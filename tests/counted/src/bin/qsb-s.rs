//! Counts the instructions that a QSB-S takes for a byte and for a command.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::qsb::Qsb::s);
