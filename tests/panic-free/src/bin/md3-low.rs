//! Proof that an MD3 of the low current version cannot panic.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::md3::Md3::low);
