//! Proof that an MDROBOT cannot panic.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::mdrobot::Mdrobot::md400);
