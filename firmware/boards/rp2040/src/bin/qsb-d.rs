//! A QSB-D, for a differential encoder, on the Pico.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_pico, qsb::Qsb::d, TX_REPLIES, QSB);
