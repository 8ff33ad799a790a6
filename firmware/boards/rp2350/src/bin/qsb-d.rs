//! A QSB-D, for a differential encoder, on the Pico 2.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_pico, qsb::Qsb::d, TX_REPLIES, QSB);
