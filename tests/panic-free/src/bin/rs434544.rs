//! An RS 434544, alone.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::rs434::rs434544);
