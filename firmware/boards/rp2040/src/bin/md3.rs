//! An MD3 of 7 A on the Pico.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_pico, md3::Md3::new, TX_ONE_REPLY, MD3);
