//! Counts the instructions that an MDROBOT takes for a byte and for a request.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::mdrobot::Mdrobot::md400);
