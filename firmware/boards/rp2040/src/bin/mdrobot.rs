//! An MD400 of MDROBOT on the Pico.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_rp2040, mdrobot::mdrobot, TX_ONE_REPLY, MDROBOT);
