//! A QSB-D, for a differential encoder, on the LM3S6965 board.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_lm3s6965, qsb::Qsb::d, TX_REPLIES, QSB);
