//! An MD3 of 1.8 A on the STM32F411.
#![no_std]
#![no_main]

drivetwin_board::image!(drivetwin_stm32f4, md3::Md3::low, TX_ONE_REPLY, MD3);
