//! A QSB-D.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::qsb::Qsb::d);
