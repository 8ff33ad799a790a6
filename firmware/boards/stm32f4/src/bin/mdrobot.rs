//! An MD400 of MDROBOT on the STM32F411.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_stm32f4, mdrobot::Mdrobot::md400, TX_ONE_REPLY, MDROBOT);
