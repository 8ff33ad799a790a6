//! An MD400 of MDROBOT on the Pico 2.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_pico, mdrobot::Mdrobot::md400, TX_ONE_REPLY, MDROBOT);
