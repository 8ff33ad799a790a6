//! A QSB-S, for a single-ended encoder, on the STM32F411.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_stm32f4, qsb::Qsb::s, TX_REPLIES, QSB);
