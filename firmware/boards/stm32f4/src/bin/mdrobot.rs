//! An MD400 of MDROBOT on the STM32F411.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::mdrobot::{MEMORY, mdrobot};
use drivetwin_firmware::shell::ONE_ANSWER;
use drivetwin_stm32f4::{run, wires};

#[entry]
fn main() -> ! {
    run::<_, MEMORY, ONE_ANSWER, _>(mdrobot, &wires::MDROBOT)
}
