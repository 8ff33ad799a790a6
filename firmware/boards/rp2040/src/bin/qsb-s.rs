//! A QSB-S, for a single-ended encoder, on the Pico.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_rp2040, qsb::Qsb::s, TX_REPLIES, QSB);
