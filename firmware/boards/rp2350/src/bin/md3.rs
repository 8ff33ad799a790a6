//! An MD3 of 7 A on the Pico 2.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_pico, md3::Md3::new, TX_ONE_REPLY, MD3);
