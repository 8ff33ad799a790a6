//! An RS 434546 of 40 A on the LM3S6965 board.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_lm3s6965, rs434::Rs434::rs434546, TX_ONE_REPLY, RS434);
