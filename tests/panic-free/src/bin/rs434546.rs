//! Proof that an RS 434546 cannot panic.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::rs434::Rs434::rs434546);
