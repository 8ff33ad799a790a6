//! An RS 434544 of 20 A on the Pico.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_pico, rs434::Rs434::rs434544, TX_ONE_REPLY, RS434);
