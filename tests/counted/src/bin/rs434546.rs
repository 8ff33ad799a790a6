//! Counts the instructions that an RS 434546 takes for a byte and for a request.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::rs434::Rs434::rs434546);
