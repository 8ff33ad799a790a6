//! An MD3 of the low current version on the LM3S6965 board.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_lm3s6965, md3::Md3::low, TX_ONE_REPLY, MD3);
