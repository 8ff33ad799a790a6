//! An MD400 of MDROBOT on the LM3S6965 board.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_lm3s6965, mdrobot::Mdrobot::md400, TX_ONE_REPLY, MDROBOT);
