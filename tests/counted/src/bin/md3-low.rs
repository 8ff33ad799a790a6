//! Counts the instructions that an MD3 of the low current version takes for a byte and for a request.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::md3::Md3::low);
