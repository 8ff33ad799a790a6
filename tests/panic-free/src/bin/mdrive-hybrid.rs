//! Proof that an MDriveHybrid cannot panic.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::mdrive::Mdrive::hybrid);
