//! An MD3 of 7 A on the STM32F411.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use drivetwin_firmware::md3::{MEMORY, Md3};
use drivetwin_firmware::shell::ONE_ANSWER;
use drivetwin_stm32f4::{run, wires};

#[entry]
fn main() -> ! {
    run::<_, MEMORY, ONE_ANSWER, _>(Md3::new, &wires::MD3)
}
