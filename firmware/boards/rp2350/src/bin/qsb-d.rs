//! A QSB-D, for a differential encoder, on the Pico 2.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_rp2350, qsb::Qsb::d, TX_REPLIES, QSB);
