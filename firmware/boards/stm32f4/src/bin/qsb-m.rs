//! A QSB-M, with the motor drive, on the STM32F411.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_stm32f4, qsb::Qsb::m, TX_REPLIES, QSB);
