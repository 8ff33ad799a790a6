//! An MD400 of MDROBOT on the STM32F411.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use standin_firmware::mdrobot::{MEMORY, mdrobot};
use standin_firmware::shell::ONE_ANSWER;
use standin_stm32f4::{run, wires};

#[entry]
fn main() -> ! {
    run::<_, MEMORY, ONE_ANSWER, _>(mdrobot, &wires::MDROBOT)
}
