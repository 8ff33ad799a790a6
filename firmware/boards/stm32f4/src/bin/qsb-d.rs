//! A QSB-D, for a differential encoder, on the STM32F411.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_stm32f4, qsb::Qsb::d, TX_REPLIES, QSB);
