//! A QSB-S, for a single-ended encoder, on the LM3S6965 board.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_lm3s6965, qsb::Qsb::s, TX_REPLIES, QSB);
