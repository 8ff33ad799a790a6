//! The way from the reset to a program in RAM (2.4): the processor takes the stack pointer and the start
//! address from the beginning of the flash.

drivetwin_board::run_from_ram!();
