//! An RS 434544 of 20 A on the STM32F411.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use standin_firmware::rs434::{MEMORY, rs434544};
use standin_firmware::shell::ONE_ANSWER;
use standin_stm32f4::{run, wires};

#[entry]
fn main() -> ! {
    run::<_, MEMORY, ONE_ANSWER, _>(rs434544, &wires::RS434)
}
