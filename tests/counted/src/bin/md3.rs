//! An MD3 of the high current version.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::md3::Md3::new);
