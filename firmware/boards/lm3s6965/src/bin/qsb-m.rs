//! A QSB-M, with the motor drive, on the LM3S6965 board.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_lm3s6965, qsb::Qsb::m, TX_REPLIES, QSB);
