//! Proof that an MDrivePlus² cannot panic.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::mdrive::Mdrive::plus);
