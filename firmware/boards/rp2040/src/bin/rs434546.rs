//! An RS 434546 of 40 A on the Pico.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_pico, rs434::Rs434::rs434546, TX_ONE_REPLY, RS434);
