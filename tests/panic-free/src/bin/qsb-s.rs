//! A QSB-S, alone.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::qsb::Qsb::s);
