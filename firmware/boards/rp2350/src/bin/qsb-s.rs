//! A QSB-S, for a single-ended encoder, on the Pico 2.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_pico, qsb::Qsb::s, TX_REPLIES, QSB);
