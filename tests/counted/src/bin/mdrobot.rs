//! An MDROBOT.
#![no_std]
#![no_main]

include!("../drive.rs");

program!(drivetwin_firmware::mdrobot::mdrobot);
