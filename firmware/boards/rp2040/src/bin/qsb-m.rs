//! A QSB-M, with the motor drive, on the Pico.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_pico, qsb::Qsb::m, TX_REPLIES, QSB);
