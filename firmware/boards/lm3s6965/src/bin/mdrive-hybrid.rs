//! An MDrive Hybrid on the LM3S6965 board.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_lm3s6965 on network, mdrive::Mdrive::hybrid, MDRIVE);
